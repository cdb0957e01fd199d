"""Windows whose limits on states are soft: as the hard ones where those can be met, the least violation where not."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from psmpc_cli.ocp.transcription import Nlp, transcribe

from psmpc_cli.control import Command
from psmpc_cli.ocp.plan import mesh
from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.ocp.window import (
    Window,
    bounds,
    node_limits,
    pack_guess,
    parameter_vector,
    scaled_violations,
    window_shape,
    worst_violations,
)
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Outcome, Solution, build_solver
from psmpc_cli.specs.task import SolverSpec

SQP, FATROP, IPOPT = (SolverSpec(kind=kind, iterations=50) for kind in ("sqp", "fatrop", "ipopt"))
PIQP = SQP.model_copy(update={"compiled": False})
BASE_X = 0


@dataclass(frozen=True, eq=False)
class Solved:
    """A window's solution."""

    nlp: Nlp
    window: Window
    solution: Solution

    @property
    def X(self) -> np.ndarray:
        return np.asarray(self.solution.z[self.nlp.layout.state_index])

    @property
    def tau(self) -> np.ndarray:
        return np.asarray(self.solution.z[self.nlp.layout.duration_index[0]])

    @property
    def penalty(self) -> float:
        layout, tau = self.nlp.layout, np.append(self.tau, self.window.horizon - self.tau.sum())
        e = scaled_violations(self.X, *node_limits(layout, self.window.stages))
        return float(np.trapezoid(e.sum(axis=1), mesh(tau, layout.nodes)))


class Windows:
    """Solves the windows of a run with hard and with soft limits."""

    def __init__(self, model: RobotModel, costs: StageCosts) -> None:
        self._model, self._costs = model, costs

    def solve(self, decision: Command, window: Window, spec: SolverSpec, soft: bool) -> Solved:
        nlp = transcribe(self._model, window_shape(window.stages, window.nodes, "exact", soft))
        instants = decision.plan.instants
        z = pack_guess(nlp, window, decision.prediction, instants, self._costs)
        p = parameter_vector(nlp, window, instants)
        return Solved(nlp, window, build_solver(nlp, spec).solve(Guess(z), p, bounds(nlp, window)))


@pytest.fixture(scope="module")
def windows(model: RobotModel, costs: StageCosts) -> Windows:
    return Windows(model, costs)


def chosen(decisions: list[Command], stages: int) -> Command:
    """A sample in the midst of the windows over that many stages, its plan a solution."""
    found = [d for d in decisions if len(d.solution.window.stages) == stages and "solve_failed" not in d.events]
    return found[len(found) // 2]


def bounded(window: Window, **limits: np.ndarray) -> Window:
    """The window with other limits in all of its stages."""
    return replace(window, stages=tuple(replace(s, limits=replace(s.limits, **limits)) for s in window.stages))


def moving(decisions: list[Command], stages: int) -> Command:
    """A window over that many stages in whose first the base has more than 20 cm to go towards lesser x."""
    return [d for d in decisions if len(d.solution.window.stages) == stages and -1.8 < d.x[BASE_X] < -1.0][-1]


def beyond_a_limit(window: Window) -> Window:
    """The base is measured 5 cm beyond a limit that it cannot be back at within an interval."""
    high = window.stages[0].limits.position_high.copy()
    high[BASE_X] = window.x0[BASE_X] - 0.05
    return bounded(window, position_high=high)


def too_fast_to_stop(window: Window) -> Window:
    """The base moves at 0.1 m/s towards a limit 1 cm away, and decelerates by 0.2 m/s^2 at most: it takes 2.5 cm."""
    high, x0, n = window.stages[0].limits.position_high.copy(), window.x0.copy(), len(window.x0) // 2
    high[BASE_X], x0[n + BASE_X] = window.x0[BASE_X] + 0.01, 0.1
    strongest = np.where(np.arange(n) == BASE_X, 0.2, np.inf)
    window = bounded(window, position_high=high, acceleration_low=-strongest, acceleration_high=strongest)
    return replace(window, x0=x0)


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_where_hard_limits_can_be_met_soft_ones_have_the_same_solution(
    windows: Windows, decisions: list[Command], stages: int
) -> None:
    decision = chosen(decisions, stages)
    hard, soft = (windows.solve(decision, decision.solution.window, SQP, soft) for soft in (False, True))
    assert hard.solution.outcome is soft.solution.outcome is Outcome.OPTIMAL
    assert soft.solution.objective == pytest.approx(hard.solution.objective, rel=1e-8)
    assert soft.penalty < 1e-6
    assert np.abs(soft.tau - hard.tau).max(initial=0.0) < 1e-6


@pytest.mark.parametrize("spec", [FATROP, IPOPT], ids=["fatrop", "ipopt"])
def test_slack_inputs_lead_to_the_hard_solution_too(
    windows: Windows, decisions: list[Command], spec: SolverSpec
) -> None:
    decision = chosen(decisions, 2)
    hard, soft = (windows.solve(decision, decision.solution.window, spec, soft) for soft in (False, True))
    assert hard.solution.outcome is soft.solution.outcome is Outcome.OPTIMAL
    relaxed = 1e-8 * soft.nlp.layout.violation_index.size  # both let go of every bound by 1e-8
    assert soft.solution.objective == pytest.approx(hard.solution.objective, abs=relaxed + 1e-6)
    assert np.abs(soft.tau - hard.tau).max(initial=0.0) < 1e-5


@pytest.mark.parametrize(
    ("stages", "change"),
    [(1, beyond_a_limit), (2, beyond_a_limit), (1, too_fast_to_stop)],
    ids=["beyond_a_limit", "beyond_a_limit_before_a_switch", "too_fast_to_stop"],
)
def test_a_limit_that_cannot_be_met_is_violated_alike_by_all_solvers(
    windows: Windows, decisions: list[Command], stages: int, change: Callable[[Window], Window]
) -> None:
    decision = moving(decisions, stages)
    window = change(decision.solution.window)
    assert windows.solve(decision, window, SQP, soft=False).solution.outcome is Outcome.INFEASIBLE
    found = [windows.solve(decision, window, spec, soft=True) for spec in (SQP, PIQP, FATROP, IPOPT)]
    best = found[0]
    assert 0 < worst_violations(best.nlp.layout, best.solution.z).max() <= 0.05 + 1e-6
    for other in found:
        assert other.solution.outcome is Outcome.OPTIMAL
        assert other.solution.objective == pytest.approx(best.solution.objective, rel=1e-5)
        assert other.penalty == pytest.approx(best.penalty, rel=1e-4)
        assert np.abs(other.tau - best.tau).max(initial=0.0) < 1e-3


def test_what_is_not_a_limit_on_states_stays_hard(windows: Windows, decisions: list[Command]) -> None:
    decision = moving(decisions, 2)
    found = windows.solve(decision, too_fast_to_stop(decision.solution.window), SQP, soft=True)
    stage, layout = found.window.stages[0], found.nlp.layout
    u = np.diff(found.X[:, layout.n + BASE_X]) / (
        np.append(found.tau, found.window.horizon - found.tau.sum()) / 20
    ).repeat(20)
    assert np.abs(u).max() <= 0.2 + 1e-6
    at_the_end = np.abs(StageCosts(found.nlp.model).errors(stage, found.X[[20]])[0, list(stage.end_rows)])
    assert (at_the_end <= stage.tolerance + 1e-6).all()
