"""A bench of the task there and back, on coarse meshes."""

from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.specs.load import Task, load_robot, parse_task
from psmpc_cli.studies.bench import pose
from psmpc_cli.studies.bench_problems import Problem
from psmpc_cli.studies.bench_windows import RECORDED, Recorded, record_windows

from ..there_and_back import TASK

FARTHER = "stages[0].target.base=[0.3, 0, 0]"
"""So far that the second stage enters the window after some samples, not at once."""


def small_task(*changes: str) -> Task:
    """The task, run as a bench runs it."""
    return parse_task(TASK, load_robot("planar_dual_arm").robot_yaml, "small", [*RECORDED, FARTHER, *changes])


def recorded_run(*changes: str) -> tuple[Experiment, list[Recorded]]:
    """The windows around the append of its run."""
    return record_windows(small_task(*changes))


def posed(experiment: Experiment, windows: list[Recorded], *changes: str) -> list[Problem]:
    """The windows on the mesh of a changed task."""
    return pose(windows, small_task(*changes).spec, experiment, lambda: None)
