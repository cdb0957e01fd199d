from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from psmpc_cli.ocp.lexicographic import LevelShape, transcribe_level
from psmpc_cli.ocp.transcription import Nlp, transcribe
from psmpc_cli.solvers.casadi_nlp import CasadiSolver

from psmpc_cli.control import Command
from psmpc_cli.ocp.window import Bounds, bounds, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Outcome, Solution, build_solver
from psmpc_cli.solvers.base import FEASIBLE
from psmpc_cli.specs.task import SolverSpec

CONVERGED = SolverSpec(kind="sqp", iterations=50)
ONE = SolverSpec(kind="sqp")


class Recorded:
    """A window of a run, with what a back-end needs to solve it."""

    def __init__(self, model: RobotModel, decision: Command) -> None:
        window = decision.solution.window
        self.guess, self.parameters = decision.solution.guess, decision.solution.parameters
        self.nlp: Nlp = transcribe(model, window_shape(window.stages, (20,) * len(window.stages), "exact"))
        self.bounds = bounds(self.nlp, window)
        self._evaluate = ca.Function("nlp", [self.nlp.x, self.nlp.p], [self.nlp.f, self.nlp.g])

    def solve(self, spec: SolverSpec, warm: bool = True, limits: Bounds | None = None) -> Solution:
        guess = self.guess if warm else Guess(self.guess.z)
        return build_solver(self.nlp, spec).solve(guess, self.parameters, limits or self.bounds)

    def instants(self, z: np.ndarray) -> np.ndarray:
        return np.cumsum(z[self.nlp.layout.duration_index[0]])

    def merit(self, z: np.ndarray, penalty: float) -> float:
        """The exact l1 merit function of the NLP."""
        f, g = (np.asarray(values).ravel() for values in self._evaluate(z, self.parameters))
        return float(f[0] + penalty * sum(piece.clip(0).sum() for piece in self.excess(z, g)))

    def violation(self, z: np.ndarray) -> float:
        _, g = self._evaluate(z, self.parameters)
        return max(piece.max(initial=0.0) for piece in self.excess(z, np.asarray(g).ravel()))

    def excess(self, z: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, ...]:
        held = self.bounds
        return held.lbx - z, z - held.ubx, held.lbg - g, g - held.ubg


def chosen(decisions: list[Command], stages: int) -> Command:
    """A sample whose guess is warm, in the midst of the windows over that many stages."""
    warm = [d for d in decisions if len(d.solution.window.stages) == stages and d.solution.guess.warm]
    return warm[len(warm) // 2]


@pytest.fixture(params=[1, 2, 3], ids=["one_stage", "two_stages", "three_stages"])
def recorded(request: pytest.FixtureRequest, model: RobotModel, decisions: list[Command]) -> Recorded:
    return Recorded(model, chosen(decisions, request.param))


@pytest.fixture(scope="module")
def two_stages(model: RobotModel, decisions: list[Command]) -> Recorded:
    return Recorded(model, chosen(decisions, 2))


def assert_same_optimum(recorded: Recorded, one: Solution, other: Solution) -> None:
    assert one.outcome is other.outcome is Outcome.OPTIMAL
    assert one.objective == pytest.approx(other.objective, rel=1e-5)
    apart = recorded.instants(one.z) - recorded.instants(other.z)
    assert np.abs(apart).max(initial=0.0) < 1e-3


@pytest.mark.parametrize("warm", [True, False], ids=["warm", "cold"])
def test_iterated_to_convergence_it_reaches_the_optimum_of_fatrop(recorded: Recorded, warm: bool) -> None:
    solution = recorded.solve(CONVERGED, warm)
    assert_same_optimum(recorded, solution, recorded.solve(SolverSpec(kind="fatrop")))
    assert recorded.violation(solution.z) < 1e-8


def test_one_iteration_on_the_shifted_plan_decreases_the_merit_function(recorded: Recorded) -> None:
    solution, optimum = recorded.solve(ONE), recorded.solve(SolverSpec(kind="fatrop"))
    penalty = 2 * float(np.abs(np.r_[optimum.lam_g, optimum.lam_x]).max())
    assert solution.iterations == 1
    assert solution.outcome.usable
    assert recorded.merit(solution.z, penalty) < recorded.merit(recorded.guess.z, penalty)
    assert recorded.violation(solution.z) <= FEASIBLE


def test_a_cold_start_is_iterated_until_the_step_is_small(two_stages: Recorded) -> None:
    """What is not marked as the shifted plan is none, however good it is."""
    z = two_stages.guess.z.copy()
    z[two_stages.nlp.layout.duration_index] += 0.2
    spoiled = Recorded.__new__(Recorded)
    spoiled.__dict__.update(two_stages.__dict__, guess=Guess(z))
    cold = spoiled.solve(ONE, warm=False)
    assert cold.iterations > 1
    assert cold.objective == pytest.approx(two_stages.solve(CONVERGED).objective, rel=1e-5)


@pytest.mark.parametrize("what", ["fixed_instant", "bounded_inputs", "slow_at_the_end"])
def test_other_bounds_lead_to_the_optimum_of_fatrop_too(two_stages: Recorded, what: str) -> None:
    held, layout = two_stages.bounds, two_stages.nlp.layout
    lbx, ubx = held.lbx.copy(), held.ubx.copy()
    if what == "fixed_instant":
        at = two_stages.instants(two_stages.guess.z)[0] + 0.3
        lbx[layout.duration_index[0]] = ubx[layout.duration_index[0]] = at
    elif what == "bounded_inputs":
        strongest = np.abs(two_stages.solve(CONVERGED).z[layout.input_index(1)]).max()
        lbx[layout.input_index(1)], ubx[layout.input_index(1)[:, :5]] = -strongest / 2, strongest / 2
    else:
        late = layout.state_index[30:, 9:]
        fastest = np.abs(two_stages.solve(CONVERGED).z[late]).max()
        lbx[late], ubx[late] = -fastest / 2, fastest / 2
    limits = Bounds(lbx, ubx, held.lbg, held.ubg)
    solution = two_stages.solve(CONVERGED, limits=limits)
    assert_same_optimum(two_stages, solution, two_stages.solve(SolverSpec(kind="fatrop"), limits=limits))
    assert solution.objective > two_stages.solve(CONVERGED).objective + 1e-6


def test_a_window_without_a_solution_is_infeasible_at_once(two_stages: Recorded) -> None:
    """An end condition 10 m away in a 4 s horizon."""
    held, rows = two_stages.bounds, two_stages.nlp.end_rows[0]
    lbg, ubg = held.lbg.copy(), held.ubg.copy()
    lbg[rows], ubg[rows] = 10.0, 10.1
    solution = two_stages.solve(ONE, warm=False, limits=replace(held, lbg=lbg, ubg=ubg))
    assert solution.outcome is Outcome.INFEASIBLE
    assert solution.iterations == 1
    assert ":" in solution.outcome.value


def test_a_deadline_stops_it_after_the_iteration_that_passes_it(two_stages: Recorded) -> None:
    stopped = two_stages.solve(SolverSpec(kind="sqp", iterations=50, deadline=1e-9))
    assert stopped.iterations == 1
    assert stopped.outcome is Outcome.FEASIBLE
    assert two_stages.solve(SolverSpec(kind="sqp", iterations=50, deadline=60.0)).outcome is Outcome.OPTIMAL


def test_an_iterate_that_violates_constraints_at_the_deadline_does_not_count(two_stages: Recorded) -> None:
    z = two_stages.guess.z.copy()
    z[two_stages.nlp.layout.state_index[1:]] += 0.05
    z[two_stages.nlp.layout.duration_index] += 0.3
    spec = SolverSpec(kind="sqp", deadline=1e-9)
    solution = build_solver(two_stages.nlp, spec).solve(Guess(z), two_stages.parameters, two_stages.bounds)
    assert two_stages.violation(solution.z) > FEASIBLE
    assert solution.outcome is Outcome.DEADLINE
    assert not solution.outcome.usable


def test_ipopt_stops_at_a_deadline_too(two_stages: Recorded) -> None:
    stopped = two_stages.solve(SolverSpec(kind="ipopt", deadline=1e-6), warm=False)
    assert stopped.iterations < two_stages.solve(SolverSpec(kind="ipopt"), warm=False).iterations
    assert stopped.outcome is (Outcome.FEASIBLE if two_stages.violation(stopped.z) <= FEASIBLE else Outcome.DEADLINE)


def test_the_levels_of_htmpc_are_left_to_fatrop(model: RobotModel) -> None:
    level = transcribe_level(model, LevelShape(("joint", "task"), "cost", 8, "exact"))
    assert isinstance(build_solver(level, ONE), CasadiSolver)
