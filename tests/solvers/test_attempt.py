import numpy as np
import pytest

from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers import Guess, Outcome, Solution, attempt

NONE = np.zeros(0)
BOUNDS = Bounds(NONE, NONE, NONE, NONE)


class Made:
    """A solver that returns what it was made with, or raises it."""

    def __init__(self, result: Solution | Exception) -> None:
        self.result = result

    def solve(self, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


def solution(*z: float) -> Solution:
    return Solution(Outcome.OPTIMAL, np.array(z), NONE, NONE, 1.0, 3, 0.1)


def test_a_solution_comes_through_as_it_is() -> None:
    made = solution(1.0, 2.0)
    assert attempt(Made(made), Guess(NONE), NONE, BOUNDS) is made


@pytest.mark.parametrize("error", [RuntimeError("a\nb"), ZeroDivisionError("a"), np.linalg.LinAlgError("a")])
def test_a_solver_that_raises_has_failed_where_it_started(error: Exception, caplog: pytest.LogCaptureFixture) -> None:
    failed = attempt(Made(error), Guess(np.ones(2)), NONE, BOUNDS)
    assert failed.outcome is Outcome.FAILED
    assert failed.z.tolist() == [1, 1]
    assert caplog.messages == [f"the solver raised {type(error).__name__}: a"]


def test_a_point_that_is_no_numbers_is_no_solution() -> None:
    assert attempt(Made(solution(1.0, np.nan)), Guess(NONE), NONE, BOUNDS).outcome is Outcome.FAILED


def test_a_mistake_in_the_program_is_none_of_the_solver() -> None:
    with pytest.raises(TypeError):
        attempt(Made(TypeError("a")), Guess(NONE), NONE, BOUNDS)
