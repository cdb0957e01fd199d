"""Every figure of the registry, of ordinary and of odd subjects: what a referee would ask of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.figures.registry import figures_of
from psmpc_cli.logs.run import Run
from psmpc_cli.specs.load import Task, load_robot
from psmpc_cli.specs.robots.robot import SpatialRobot
from psmpc_cli.studies.monte_carlo import MonteCarloRuns
from psmpc_cli.studies.sweep import SweepCells

from ..synthetic_monte_carlo import synthetic_monte_carlo
from ..synthetic_sweep import synthetic_sweep
from .figure_contents import check_figure
from .made_fronts import made_up, unsolved


@dataclass(frozen=True)
class Subjects:
    """What makes the subjects of the cases below."""

    load: Callable[..., Run]
    runs: Mapping[str, Run]
    many_stages: Mapping[str, Any]
    one_arm: Mapping[str, Any]
    keeping_clear: Mapping[str, Any]
    task: Task
    path: Path

    def sweep(self, sampling: str, **given: Any) -> Any:
        """Cells of a made-up sweep."""
        return SweepCells(synthetic_sweep(self.path, sampling, **given))

    def monte_carlo(self, **given: Any) -> MonteCarloRuns:
        """Runs of a made-up study."""
        return synthetic_monte_carlo(self.path, **given)


ROBOTS = ("planar_dual_arm", "dual_arm_servicer")

CASES: Mapping[str, tuple[str, Callable[[Subjects], Any]]] = {
    "run": ("run", lambda s: s.load()),
    "run with three stages at once": ("run", lambda s: s.load(early={1: 4.0, 2: 7.0, 3: 19.0})),
    "killed run": ("run", lambda s: s.load(last=8.0)),
    "noisy run": ("run", lambda s: s.load(blur=0.1)),
    "run of many stages": ("run", lambda s: s.load(**s.many_stages)),
    "run of one arm": ("run", lambda s: s.load(**s.one_arm)),
    "run that keeps clear": ("run", lambda s: s.load(**s.keeping_clear)),
    "run that begins to keep clear": ("run", lambda s: s.load(last=0.2, **s.keeping_clear)),
    "comparison": ("comparison", lambda s: s.runs),
    "sweep": ("sweep", lambda s: s.sweep("7x7")),
    "sweep with holes": ("sweep", lambda s: s.sweep("7x7", waiting=(5, 6, 13), failed=(0, 24, 30))),
    "sweep that has begun": ("sweep", lambda s: s.sweep("3x3", waiting=tuple(range(1, 9)))),
    "sweep that failed": ("sweep", lambda s: s.sweep("3x3", failed=tuple(range(9)))),
    "sweep that is not square": ("sweep", lambda s: s.sweep("2x9")),
    "ratios": ("sweep", lambda s: s.sweep("13", waiting=(1,), failed=(6,))),
    "draws": ("sweep", lambda s: s.sweep("random:20", waiting=(1, 3), failed=(6,))),
    "fronts": ("pareto", lambda s: made_up()),
    "narrow fronts": ("pareto", lambda s: made_up(narrow=True, method="weighted")),
    "fronts with gaps": ("pareto", lambda s: unsolved(made_up(method="constrained"), 4)),
    "fronts in space": ("pareto", lambda s: made_up(later=3, method="constrained")),
    "many of Monte Carlo": ("monte-carlo", lambda s: s.monte_carlo(runs=200, late=(3, 90), dropped=(50, 51))),
    "failures": ("monte-carlo", lambda s: s.monte_carlo(waiting=(0, 11), crashed=(2,), late=(5,), dropped=(7,))),
    "one crash": ("monte-carlo", lambda s: s.monte_carlo(runs=1, crashed=(0,))),
    "scenario": ("scenario", lambda s: s.task),
    **{name: ("robot", lambda s, name=name: load_robot(name)) for name in ROBOTS},
    "robot without arms": (
        "robot",
        lambda s: SpatialRobot(name="bare", base={"mass": 10, "inertia": (0.1, 0.2, 0.25)}),
    ),
}
"""By name the kind and the subject."""


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_figure_is_fit_to_print(
    case: str,
    load: Callable[..., Run],
    runs: Mapping[str, Run],
    many_stages: dict[str, Any],
    one_arm: dict[str, Any],
    keeping_clear: dict[str, Any],
    transport: Task,
    tmp_path: Path,
) -> None:
    kind, make = CASES[case]
    subject = make(Subjects(load, runs, many_stages, one_arm, keeping_clear, transport, tmp_path / "study.h5"))
    drawn = figures_of(kind, subject)
    assert drawn
    for make in drawn.values():
        check_figure(make(subject))
