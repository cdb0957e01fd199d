"""Paired comparisons of stages: of known ones, every pair once, connecting all, and agreeing with each other."""

from collections.abc import Iterator

import numpy as np

from psmpc_cli.specs.checks.names import stage_names
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.fields import LARGEST
from psmpc_cli.specs.messages import Fault, choice, dotted, quoted, shortened
from psmpc_cli.specs.priorities import ACCEPTABLE, Weighing, groups, weigh_stages
from psmpc_cli.specs.task import PrioritiesSpec

WIDEST = float(np.log(LARGEST))
"""Largest logarithm of a priority."""


def check_priorities(task: Cursor) -> Iterator[Fault]:
    """Give what is wrong with the comparisons of a task's stages."""
    if not task["priorities"].exists:
        return
    for stage in task["stages"].entries():
        if stage["priority"].exists:
            found = 'found "priority" at a stage and "priorities" in the task, expected one or the other'
            yield stage["priority"].problem(found, at_key=True)
    stages, comparisons = stage_names(task), task["priorities"]["compare"]
    problems = [*_unknown(comparisons, stages), *_repeated(comparisons)]
    yield from problems
    valid = task["priorities"].valid(PrioritiesSpec)
    known = len(stages) == len(set(stages)) == task["stages"].length
    if not problems and known and valid is not None:
        yield from _disagreeing(comparisons, valid, stages)


def _unknown(comparisons: Cursor, stages: list[str]) -> Iterator[Fault]:
    """Give the names of stages that are not there."""
    for comparison in comparisons.entries():
        for place in (comparison[0], comparison[1]):
            if place.text is not None and place.text not in stages and stages:
                yield place.problem(f"found no such stage{choice(place.text, stages)}")


def _repeated(comparisons: Cursor) -> Iterator[Fault]:
    """Give the comparisons of a stage with itself, and of two stages that are compared before."""
    first: dict[frozenset[str], Cursor] = {}
    for comparison in comparisons.entries():
        a, b = comparison[0].text, comparison[1].text
        if a is None or b is None:
            continue
        pair = frozenset((a, b))
        if a == b:
            yield comparison.problem(f"found {quoted(a)} compared with itself, expected two different stages")
        elif pair in first:
            earlier = dotted(first[pair].path)
            yield comparison.problem(
                f"found {quoted(a)} and {quoted(b)} compared again (first at {earlier}), expected every pair once"
            )
        first.setdefault(pair, comparison)


def _disagreeing(comparisons: Cursor, valid: PrioritiesSpec, stages: list[str]) -> Iterator[Fault]:
    """Give comparisons that leave stages unconnected, contradict each other, or lead beyond all numbers."""
    pairs = [(stages.index(a), stages.index(b)) for a, b, _ in valid.compare]
    islands = [", ".join(shortened(stages[i]) for i in group) for group in groups(len(stages), pairs)]
    if len(islands) > 1:
        message = f"found nothing that compares {' with '.join(islands)}, expected comparisons that connect all stages"
        yield comparisons.problem(message, at_key=True)
        return
    weighing = weigh_stages(valid, stages)
    if weighing.worst is not None and weighing.ratio > ACCEPTABLE:
        yield comparisons[weighing.worst][2].problem(_contradiction(valid, weighing, weighing.worst))
    elif np.abs(weighing.logarithms).max() > WIDEST:
        extreme = int(np.abs(weighing.logarithms).argmax())
        power = weighing.logarithms[extreme] / np.log(10)
        message = f"found comparisons that make {quoted(stages[extreme])} 1e{power:+.0f} times as important as "
        message += f"{quoted(stages[0])}, expected a ratio from {1 / LARGEST:g} to {LARGEST:g}"
        yield comparisons.problem(message, at_key=True)


def _contradiction(valid: PrioritiesSpec, weighing: Weighing, worst: int) -> str:
    """Say what the worst comparison says and what the others say instead."""
    a, b, ratio = valid.compare[worst]
    implied = weighing.implied[worst] / np.log(10)
    wanted = f"{10**implied:.3g}" if abs(implied) < 300 else f"1e{implied:+.0f}"
    return (
        f"found {quoted(a)} to be {ratio:g} times as important as {quoted(b)}, expected about {wanted}, "
        f"which the other comparisons imply (consistency ratio {weighing.ratio:.3g}, acceptable up to {ACCEPTABLE:g})"
    )
