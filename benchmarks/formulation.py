"""Tables of docs/formulation_results.md and docs/departures.md that take minutes: starts, effort by mesh, departures.

python benchmarks/formulation.py starts [NODES]      both measures of an actual start; some half a minute
python benchmarks/formulation.py effort              control effort of two tasks on several meshes; some minutes
python benchmarks/formulation.py smooth              weights on the rate of the control, limits of jerk; a minute
python benchmarks/formulation.py gradient [NODES]    windows by both gradients of solver adjoint; some two minutes
python benchmarks/formulation.py reach [NODES]       Capture by accelerations of joints and of poses; some five minutes
python benchmarks/formulation.py ablations [NODES]   and docs/figures/ablation_*.png; about half an hour
"""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from pages import ROOT, command_line, markdown

import psmpc_cli as psmpc
from psmpc_cli.paper.ablations import CHANGES, DISCRETIZATIONS, run_ablations
from psmpc_cli.paper.figures import save_ablation
from psmpc_cli.robot.motion import over_ticks
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.solvers import Outcome, Solution, Solver, build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.robots.robot import stack

STARTS = {
    "Capture, PSMPC": ("psmpc", "capture"),
    "Capture, SMPC": ("smpc", "capture"),
    "Transport, PSMPC": ("psmpc", "transport"),
    "Release, PSMPC": ("psmpc", "release"),
}
"""Controller and stage of each column."""

THRESHOLDS = {"control": [0.1], "closeness": [0.1, 0.5, 0.9]}
"""Thresholds of the actual start by what is compared with them."""

MESHES: Mapping[str, Sequence[str]] = {
    "transport": ("12", "25", "50", "100", "400", "auto"),
    "transport_grasp": ("25", "50", "100", "auto"),
}
"""Values of `controller.nodes` on which the control effort of each task is measured."""

JERK = "limits={base: {jerk: [1, 1, 1]}, arms: {jerk: [1, 1, 1]}}"
RATES = {rate: [f"skills.{skill}.weights.rate={rate}" for skill in ("move", "reach")] for rate in (0.03, 0.3)}
SMOOTHED: Mapping[str, Sequence[str]] = {
    "neither": (),
    **{f"`rate: {rate}`": changes for rate, changes in RATES.items()},
    "limits of `jerk`, 1": (JERK,),
    "both, `rate: 0.03`": (JERK, *RATES[0.03]),
}
"""Changes of the transport task whose commands `smooth` compares."""

LIGHT = ("controller.nodes=20", "skills.move.weights.control=0.03", "skills.reach.weights.control=0.03")
"""Control costs little, so that accelerations jump."""

NEAR_SWITCH = 0.5
"""How far from a switch control effort counts to it [s]."""


WINDOWS = 10
"""How many windows with one stage, and how many with two, `gradient` takes of a run."""

SAME_J = 1e-6
SAME_INSTANT = 1e-3
"""Within what part of J, and what time [s], two solutions of a window are one."""


POSED = ("[20 deg, 30 deg, 30 deg]", "[-20 deg, -30 deg, -30 deg]")
"""Joints of both arms at the end of Approach with which J_C is far from singular."""

REACH = "{space: task, input: %s, weights: {base: [100, 100, 100], arm_1: [10, 10, 1], arm_2: [10, 10, 1], control: 4}}"
"""The skill of Capture: `reach` of the task `transport`, with either input."""

REACHES: Mapping[str, tuple[bool, str, str]] = {
    "as shipped, outstretched": (False, "joint", "sqp"),
    "posed": (True, "joint", "ipopt"),
    "posed, `input: task`": (True, "task", "ipopt"),
}
"""Whether Approach poses the arms, the input of Capture, and the solver."""


WINDOWS_SCANNED = {"1 : 1 from 1 : 100": "C", "1 : 100": "B", "1 : 1": "A"}
"""The windows of the page by the label of an ablation's numbers, longer labels first."""

PLAIN = {
    r"planned t_s at T_f": "share of samples with the switch planned at the horizon's end",
    r"jumps of t_s": "jumps of the planned switch time",
    r"^end \[s\]": "run ends [s]",
    r"^error ": "error of the planned states ",
    r"^missed ": "target missed at the switch by ",
    r" nodes$": " intervals",
    r"^T0 \[s\]$": "time of the window [s]",
    r"^T0 \[s\], (.*)": r"window \1: its time T0 [s]",
    r"^earliest t_s \[s\], (.*)": r"window \1: earliest switch that can be met [s]",
    r"^minima \[s\], (.*), 1": r"window \1: J is lowest at [s]",
    r"^minima \[s\], (.*), 2": r"window \1: second minimum of J at [s]",
    r"^found \[s\], (.*), (\d)": r"window \1: switch found from guess \2 [s]",
}
"""Names of an ablation's numbers as patterns, with what the rows of the page say."""

VARIANTS = {
    "printed": "no pending cost",
    "none": "no normalization",
    "range": "by the range",
    "range and printed": "by the range, no pending cost",
    "exact": "exact step",
    "euler": "Euler's step",
}
"""Columns of the page by variant."""


SINGULAR = 1e9
"""Condition number beyond which it is that of rounding."""


def reach(nodes: str = "12") -> Iterator[str]:
    """Yield the table of the transport task with Capture in joint space and in task space."""
    return markdown(_reach(name, *how, nodes=nodes) for name, how in REACHES.items())


def _reach(name: str, posed: bool, capture_input: str, solver: str, nodes: str) -> dict[str, str]:
    """Run the transport task and return its row."""
    changes = [f"controller.nodes={nodes}", f"solver.kind={solver}", "log.shares=false", "log.plans=false"]
    changes += [f"skills.grasp={REACH % capture_input}", "stages.capture.skill=grasp"]
    if posed:
        changes += [f"stages.approach.target.arm_{i}={joints}" for i, joints in enumerate(POSED, start=1)]
    run = psmpc.simulate(psmpc.load_task("transport", changes))
    summary = run.summary()
    model = run.problem.model
    in_capture = run["window/first"] == run.stage_names.index("capture")
    condition = model.task_space_condition(run["state/Q"][in_capture])
    ends = {f"{stage.name} ends [s]": f"{stage.switch_time:.2f}" for stage in summary.stages}
    return {
        "arms at the end of Approach": name,
        "solver": solver,
        **ends,
        "mission": "succeeded" if summary.succeeded else "failed",
        "`control_effort`": f"{summary.control_effort:.2f}",
        "`squared_acceleration`": f"{summary.squared_acceleration:.2f}",
        "cond J_C in Capture, first / largest": f"{_condition(condition[0])} / {_condition(condition.max())}",
    }


def _condition(number: float) -> str:
    return f"{number:.3g}" if number < SINGULAR else "singular"


def starts(nodes: str = "100") -> Iterator[str]:
    """Yield the table of the actual starts of the transport task under both measures of a start."""
    rows = []
    for measure, thresholds in THRESHOLDS.items():
        changes = {"controller.nodes": int(nodes), "onset.kind": measure, "onset.series": thresholds}
        runs = psmpc.compare(psmpc.load_task("transport", changes), ("psmpc", "smpc"))
        for number, epsilon in enumerate(runs["psmpc"].stages["epsilon"]):
            cells = {name: _start(runs[kind], stage, number) for name, (kind, stage) in STARTS.items()}
            rows.append({"actual start [s]": f"{measure}, {epsilon:g}", **cells})
    return markdown(rows)


def _start(run: psmpc.Run, stage: str, number: int) -> str:
    """Write the actual start of a stage with a threshold [s], or that there is none before its switch."""
    index = run.stage_names.index(stage)
    start, switch = run.stages["actual_start_by_epsilon"][index, number], run.stages["switch_time"][index - 1]
    return f"{start:.1f}" if start < switch else f"{switch:.2f}, its switch"


def effort() -> Iterator[str]:
    """Yield the table of both measures of control effort by mesh, and of where in time the first one arises."""
    return markdown(_effort(task, nodes) for task, meshes in MESHES.items() for nodes in meshes)


def _effort(task: str, nodes: str) -> dict[str, str]:
    """Run a task with PSMPC on a mesh and return its row of the table of efforts."""
    changes = ["controller.kind=psmpc", f"controller.nodes={nodes}", "log.shares=false", "log.plans=false"]
    run = psmpc.simulate(psmpc.load_task(task, changes))
    summary = run.summary()
    effort_by_sample = run["effort/control"]
    times = run.time[: len(effort_by_sample)]
    places = {"start": 0.0, **{f"end of {stage.name}": stage.switch_time for stage in summary.stages[:-1]}}
    near = {name: float(effort_by_sample[np.abs(times - at) <= NEAR_SWITCH].sum()) for name, at in places.items()}
    return {
        "task": f"`{task}`",
        "N_s": nodes,
        "`squared_acceleration`": f"{summary.squared_acceleration:.2f}",
        "`control_effort`": f"{summary.control_effort:.2f}",
        **{f"{name}, within {NEAR_SWITCH:g} s": f"{value:.2f}" for name, value in near.items()},
        "at all other times": f"{summary.control_effort - sum(near.values()):.2f}",
    }


def smooth() -> Iterator[str]:
    """Yield the table of the transport task with light control weights, with and without what smooths its commands."""
    return markdown(_smooth(name, changes) for name, changes in SMOOTHED.items())


def _smooth(name: str, changes: Sequence[str]) -> dict[str, str]:
    """Step the controller through the transport task on a robot that follows exactly, and return its row."""
    task = psmpc.load_task("transport", [*LIGHT, *changes])
    controller = psmpc.Controller(task)
    space = controller.problem.model.space
    state = psmpc.State(stack(task.spec.initial, task.robot, "joint"), np.zeros(space.n))
    commanded = list[np.ndarray]()
    while not controller.done:
        command = controller.step(len(commanded) * task.spec.controller.sample_time, state)
        commanded.append(command.u)
        Q, v = over_ticks(space, state.Q, state.v, command.u, command.tick)
        state = psmpc.State(Q[-1], v[-1])
    u = np.array(commanded)
    jumps = np.diff(u.reshape(-1, space.n), axis=0, prepend=0.0)
    return {
        "smoothed by": name,
        "mission [s]": f"{len(u) * task.spec.controller.sample_time:.1f}",
        "total variation [m/s^2, rad/s^2]": f"{np.abs(np.diff(u[:, 0], axis=0)).sum():.1f}",
        "largest change a tick over its length [m/s^3, rad/s^3]": f"{np.abs(jumps).max() / command.tick:.3g}",
    }


def gradient(nodes: str = "12") -> Iterator[str]:
    """Yield the table of where windows of `approach_capture` end by the exact gradient and by that as printed."""
    changes = [f"controller.nodes={nodes}", "solver=fatrop", "log.shares=false"]
    run = psmpc.simulate(psmpc.load_task("approach_capture", changes))
    by_count = {count: np.flatnonzero(run["window/count"] == count) for count in (1, 2)}
    chosen = {count: found[np.linspace(0, len(found) - 1, WINDOWS).astype(int)] for count, found in by_count.items()}
    one, two = ([logged_solve(run, int(sample)) for sample in chosen[count]] for count in (1, 2))
    free = [replace(solve, window=replace(solve.window, pending_cost=0.0)) for solve in two]
    windows = {"one stage": one, "two stages": two, "two stages, pending cost 0": free}
    fatrop = build_solver(run.problem, SolverSpec(kind="fatrop"))
    by_gradient = {
        kind: build_solver(run.problem, SolverSpec.model_validate({"kind": "adjoint", "gradient": kind}))
        for kind in ("exact", "printed")
    }
    rows = []
    for name, solves in windows.items():
        solved = [fatrop.solve(solve.window, solve.guess) for solve in solves]
        optima = [each for each in solved if each.outcome is Outcome.OPTIMAL]
        for kind, solver in by_gradient.items():
            rows.append({"windows": name, "gradient": kind, **_against(optima, solver)})
    return markdown(rows)


def _against(optima: Sequence[Solution], solver: Solver) -> dict[str, str]:
    """Solve windows again and return the row of how that compares with their optima."""
    found = [solver.solve(optimum.window, optimum.guess) for optimum in optima]
    pairs = [(one, other) for one, other in zip(found, optima, strict=True) if one.outcome is Outcome.OPTIMAL]
    J = np.array([one.objective / other.objective - 1 for one, other in pairs])
    t = np.array([np.abs(one.plan.switch_times - other.plan.switch_times).max(initial=0.0) for one, other in pairs])
    iterations = [one.iterations for one, _ in pairs]
    return {
        "solved": f"{len(pairs)} of {len(optima)}",
        "as fatrop": str(int(((np.abs(J) <= SAME_J) & (t <= SAME_INSTANT)).sum())),
        "J above fatrop's, at most": f"{J.max(initial=0.0):.1g}" if pairs else "-",
        "switch times off, at most [s]": f"{t.max():.1g}" if pairs else "-",
        "iterations, median": f"{np.median(iterations):.0f}" if pairs else "-",
    }


def ablations(*nodes: str) -> Iterator[str]:
    """Draw the figures and yield the tables of each departure taken back, by default on the task's own mesh."""
    task = psmpc.load_task("transport", [f"controller.nodes={count}" for count in nodes])
    for ablation in run_ablations(task, watch=lambda name: print(name, file=sys.stderr, flush=True)):
        save_ablation(ablation, ROOT / "docs" / "figures")
        yield f"\nWithout our {ablation.name.replace('_', ' ')}:\n"
        yield from _by_variant(ablation.numbers)


def _by_variant(numbers: Mapping[str, float]) -> Iterator[str]:
    """Yield a table with a row for each quantity and a column for each variant, which the names of numbers contain."""
    columns = [each for each in (*CHANGES, *DISCRETIZATIONS) if any(f", {each}" in name for name in numbers)]
    rows: dict[str, dict[str, str]] = {}
    for name, value in numbers.items():
        of = next((each for each in sorted(columns, key=len, reverse=True) if f", {each}" in name), None)
        quantity = name.replace(f", {of}", "")
        row = rows.setdefault(
            quantity, {"": _in_words(quantity), **{VARIANTS.get(each, each): "-" for each in columns}}
        )
        row |= {VARIANTS.get(each, each): f"{value:.4g}" for each in ([of] if of else columns)}
    return markdown(rows.values())


def _in_words(quantity: str) -> str:
    """Return what the page says for the name of a number."""
    for label, letter in WINDOWS_SCANNED.items():
        quantity = quantity.replace(f", {label}", f", {letter}")
    for pattern, words in PLAIN.items():
        quantity = re.sub(pattern, words, quantity)
    return quantity


if __name__ == "__main__":
    command_line(starts, effort, smooth, gradient, reach, ablations)
