"""Windows of missions with the guesses their solves began with, read from `recorded.npz`.

The file is made again by `python -m tests.solvers.record`, which runs the missions.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.window import Window, on_mesh
from psmpc_cli.ocp.window_record import WindowFrame, read_window, record_of
from psmpc_cli.specs.load import Task, load_task, parse_task

from ..free_flyer import reaching

FILE = Path(__file__).with_suffix(".npz")

RESPONSIVE = (
    "controller.nodes=20",
    "controller.zeta=1e-3",
    "onset={kind: control}",
    "skills.move.weights.control=0.03",
    "skills.reach.weights.control=0.03",
    "stages.capture.ends_when.tolerance=2e-3",
    "stages.release.ends_when.tolerance=0.05",
)
"""Keys of the transport task with which its windows hold up to three stages on coarse meshes."""

CURVED_END = """\
robot: planar_dual_arm
initial: {base: [-0.1782, -0.5503, -0.0252], arm_1: [0.7556, -0.8237, 0.1881], arm_2: [0.3979, 0.2407, -0.2723]}
controller: {nodes: 20}
solver: sqp
plant: ideal
skills:
  move:  {space: joint, weights: {base: [100, 100, 10], arms: [100, 100, 10], control: 0.03}}
  reach: {space: task, weights: {base: [100, 100, 100], arms: [10, 10, 1], control: 0.03}}
stages:
  - name: reach
    skill: reach
    priority: 2.93
    target: {base: [0.0274, 0.0256, -0.445], arm_1: [1.0229, -0.6876, -1.6485], arm_2: [-1.2303, 0.8117, -0.9274]}
    ends_when: {coordinates: [arms], tolerance: 4e-3}
  - name: leave
    skill: move
    priority: 66.7
    target: {base: [-0.3603, -0.4868, -0.6498], arm_1: [-0.0964, -1.3829, -0.6488], arm_2: [0.2388, 0.6594, -1.1601]}
    ends_when: {coordinates: [base], tolerance: 1e-2}
"""
"""Arms are at their poses long before a base that is free to be anywhere, and what waits is urgent."""


def responsive_transport() -> Task:
    """Return the transport task whose windows hold up to three stages."""
    return load_task("transport", RESPONSIVE)


def curved_end() -> Task:
    """Return a task whose first stage ends at poses, which are curved functions of the coordinates."""
    return parse_task(CURVED_END, load_task("transport").robot_yaml, "reach")


MISSIONS: Mapping[str, Callable[[], Task]] = {
    "transport": responsive_transport,
    "curved end": curved_end,
    "free flyer": reaching,
}
"""The task of each mission."""


@dataclass(frozen=True, eq=False)
class RecordedSolve:
    """A window and what its solve began with.

    Attributes:
        mission: Its name in `MISSIONS`.
        sample: Of the mission.
        window: The window.
        guess: The plan the solve began with, on the window's mesh.
        duals: Multipliers it began with, those of `sqp`; (0,) without.
        warm: Whether plan and multipliers are those of the sample before.
    """

    mission: str
    sample: int
    window: Window
    guess: Plan
    duals: np.ndarray
    warm: bool

    def save(self) -> dict[str, np.ndarray]:
        """Return the arrays of the solve in the file; the guess is kept in single precision."""
        chart = self.window.chart
        Q, v = chart.from_chart(self.window.x0[None])
        arrays = {
            "first": np.array(self.window.stages[0].index),
            "nodes": np.array(self.window.nodes),
            "start": np.array(self.window.start),
            "Q": Q[0],
            "v": v[0],
            "record": record_of(self.window),
            "guess": self.guess.flat.astype(np.float32),
            "duals": self.duals,
            "warm": np.array(self.warm),
        }
        return {f"{self.mission}/{self.sample}/{name}": array for name, array in arrays.items()}


@cache
def recorded(mission: str) -> Mapping[int, RecordedSolve]:
    """Return the recorded solves of a mission by their sample."""
    problem = build_problem(MISSIONS[mission]())
    with np.load(FILE) as file:
        samples = sorted(
            int(name.split("/")[1]) for name in file if name.startswith(f"{mission}/") and "record" in name
        )
        arrays = {sample: _arrays(file, f"{mission}/{sample}/") for sample in samples}
    solves = dict[int, RecordedSolve]()
    for sample, found in arrays.items():
        frame = WindowFrame(
            segments=tuple(int(found["first"]) + place for place in range(len(found["nodes"]))),
            nodes=tuple(int(each) for each in found["nodes"]),
            start=float(found["start"]),
            Q=found["Q"],
            v=found["v"],
        )
        window = read_window(problem, frame, found["record"])
        guess = on_mesh(window.plan_of(found["guess"].astype(float)), window)
        solves[sample] = RecordedSolve(mission, sample, window, guess, found["duals"], bool(found["warm"]))
    return solves


def _arrays(file: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): file[name] for name in file if name.startswith(prefix)}


def windows_over(count: int) -> list[RecordedSolve]:
    """Return the solves of the transport mission whose windows hold so many stages, in the order of their samples.

    The first one follows an append, or begins the mission; the last one comes before a switch or an append.
    """
    return [each for each in recorded("transport").values() if len(each.window.stages) == count]
