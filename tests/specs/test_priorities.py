from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.specs.load import Task, load_task, parse_task
from psmpc_cli.specs.priorities import Weighing, weigh
from psmpc_cli.specs.task import TaskSpec

RANDOM_INDEX = {3: 0.525, 4: 0.882, 5: 1.115, 6: 1.252}
"""Saaty's random index, from simulations with his scale 1/9 .. 9."""

few = settings(max_examples=40)
ratios = st.floats(1e-3, 1e3)


def names(count: int) -> list[str]:
    return [str(index) for index in range(count)]


def weighed(count: int, pairs: list[tuple[int, int]], values: list[float]) -> Weighing:
    return weigh([(str(a), str(b), ratio) for (a, b), ratio in zip(pairs, values, strict=True)], names(count))


def matrix_of(count: int, pairs: list[tuple[int, int]], values: list[float]) -> np.ndarray:
    matrix = np.ones((count, count))
    for (a, b), ratio in zip(pairs, values, strict=True):
        matrix[a, b], matrix[b, a] = ratio, 1 / ratio
    return matrix


@few
@given(st.integers(2, 6), st.data())
def test_complete_sets_weigh_by_the_geometric_means_of_their_rows(count: int, data: st.DataObject) -> None:
    pairs = list(combinations(range(count), 2))
    values = [data.draw(ratios) for _ in pairs]
    means = np.exp(np.log(matrix_of(count, pairs, values)).mean(axis=1))
    np.testing.assert_allclose(np.exp(weighed(count, pairs, values).logarithms), means / means[0], rtol=1e-9)


@few
@given(st.integers(2, 6), st.data())
def test_consistent_sets_are_met_exactly(count: int, data: st.DataObject) -> None:
    tree = [(data.draw(st.integers(0, i - 1)), i) for i in range(1, count)]
    pairs = [*tree, *data.draw(st.lists(st.sampled_from([(b, a) for a, b in combinations(range(count), 2)])))]
    weights = np.array([1.0, *(data.draw(ratios) for _ in range(count - 1))])
    found = weighed(count, pairs, [weights[a] / weights[b] for a, b in pairs])
    np.testing.assert_allclose(np.exp(found.logarithms), weights, rtol=1e-9)
    assert found.ratio < 1e-12


@pytest.mark.parametrize("count", [3, 4, 5])
def test_the_ratio_is_saatys_where_comparisons_nearly_agree(count: int) -> None:
    """For complete sets and small disagreement CI = (lambda_max - n) / (n - 1) over his random index."""
    random = np.random.default_rng(count)
    pairs = list(combinations(range(count), 2))
    for _ in range(10):
        weights, noise = np.exp(random.standard_normal(count)), np.exp(0.1 * random.standard_normal(len(pairs)))
        values = [weights[a] / weights[b] * error for (a, b), error in zip(pairs, noise, strict=True)]
        index = (np.linalg.eigvals(matrix_of(count, pairs, values)).real.max() - count) / (count - 1)
        assert weighed(count, pairs, values).ratio == pytest.approx(index / RANDOM_INDEX[count], rel=0.05)


ROBOT = load_task("transport").robot_yaml
NUMBERS, _, _ = load_task("transport").task_yaml.partition("by_controller:")
UNRATED = "\n".join(line for line in NUMBERS.splitlines() if not line.startswith("    priority:")) + "\n"
PAPER = ("[capture, approach, 100]", "[transport, approach, 1]", "[transport, release, 100]")


def compared(*comparisons: str) -> Task:
    text = UNRATED + f"priorities: {{compare: [{', '.join(comparisons)}]}}\n"
    return parse_task(text, ROBOT, "transport")


def omegas(spec: TaskSpec) -> list[float]:
    return [stage.priority for stage in spec.stages]


def test_comparisons_become_the_stages_priorities() -> None:
    task = compared(*PAPER)
    assert omegas(task.spec) == [1, 100, 1, 0.01]
    assert task.spec.model_copy(update={"priorities": None}) == load_task("transport", {"by_controller": {}}).spec
    again = parse_task(task.task_yaml, task.robot_yaml, task.spec.name)
    assert (again.spec, again.digest) == (task.spec, task.digest)
    assert TaskSpec.model_validate_json(task.spec.model_dump_json()) == task.spec


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (["priorities.compare[1]=[unfold, stow, 4]"], [1, 100, 0.25]),
        (["priorities=", "stages.trace.priority=7"], [1, 7, 1]),
    ],
)
def test_overrides_change_comparisons_or_replace_them_and_the_effective_text_has_them(
    changes: list[str], expected: list[float]
) -> None:
    task = load_task("tracking", changes)
    assert omegas(task.spec) == expected
    assert parse_task(task.task_yaml, task.robot_yaml, task.spec.name).spec == task.spec
