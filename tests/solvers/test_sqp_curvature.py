from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.control.window_solver import SolvedWindow
from psmpc_cli.ocp.end_curvature import EndCurvature

from psmpc_cli.control import Command
from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.ocp.gauss_newton import Linearization
from psmpc_cli.ocp.window import bounds
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.solvers import Guess, Outcome, Solution, build_solver
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.task import SolverSpec

CONVERGED = SolverSpec(kind="sqp", iterations=40, max_iterations=40)
TASK = """\
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


class Reaching:
    """A window of a closed loop, with what a back-end needs to solve it."""

    def __init__(self, transport: Task) -> None:
        experiment = build_experiment(parse_task(TASK, transport.robot_yaml, "reach"))
        windows = experiment.controller.windows
        solved = [decision.solution for decision in decided(experiment, 1.5)]
        self.cold, self.warm = (next(s for s in solved if self.holds(s, warm)) for warm in (False, True))
        self.nlp, _ = windows.compiled_for(self.warm.window)

    def holds(self, solved: SolvedWindow, warm: bool) -> bool:
        return len(solved.window.stages) == 2 and solved.guess.warm == warm

    def solve(self, spec: SolverSpec, solved: SolvedWindow, guess: Guess | None = None) -> Solution:
        limits = bounds(self.nlp, solved.window)
        return build_solver(self.nlp, spec).solve(guess or solved.guess, solved.parameters, limits)


def decided(experiment: Experiment, until: float) -> list[Command]:
    found: list[Command] = []

    class Keeping(SwitchingController):
        def decide(self, now: float, x: np.ndarray) -> Command:
            found.append(super().decide(now, x))
            return found[-1]

    of = experiment.controller
    controller = Keeping(of.spec, of.stages, of.windows)
    for record in closed_loop(replace(experiment, controller=controller)):
        if record.command.time >= until:
            break
    return found


@pytest.fixture(scope="module")
def reaching(transport: Task) -> Reaching:
    return Reaching(transport)


def test_it_converges_in_a_few_iterations(reaching: Reaching) -> None:
    optimum = reaching.solve(SolverSpec(kind="fatrop"), reaching.warm)
    warm, cold = reaching.solve(CONVERGED, reaching.warm), reaching.solve(CONVERGED, reaching.cold)
    assert warm.outcome is cold.outcome is optimum.outcome is Outcome.OPTIMAL
    assert warm.iterations <= 5
    assert cold.iterations <= 15
    assert warm.objective == pytest.approx(optimum.objective, rel=1e-6)


def test_without_the_curvature_it_does_not(reaching: Reaching, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(curvature: EndCurvature, model: Linearization, *rest: object) -> Linearization:
        return model

    monkeypatch.setattr(EndCurvature, "added_to", nothing)
    assert reaching.solve(CONVERGED, reaching.warm).outcome is not Outcome.OPTIMAL


def test_its_solution_carries_the_multipliers_of_the_curved_end(reaching: Reaching) -> None:
    rows = reaching.nlp.end_rows[0]
    optimum, solution = (
        reaching.solve(SolverSpec(kind="fatrop"), reaching.warm),
        reaching.solve(CONVERGED, reaching.warm),
    )
    assert np.abs(optimum.lam_g[rows]).max() > 1.0
    assert solution.lam_g[rows] == pytest.approx(optimum.lam_g[rows], abs=1e-2)


def test_it_counts_from_the_first_iteration_on_where_the_guess_has_them(reaching: Reaching) -> None:
    """Right after a switch came into sight; the plan of later samples is near enough for either."""
    with_them = reaching.solve(CONVERGED, reaching.warm)
    without = reaching.solve(CONVERGED, reaching.warm, Guess(reaching.warm.guess.z, warm=True))
    assert with_them.iterations < without.iterations
