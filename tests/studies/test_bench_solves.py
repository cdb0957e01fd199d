import numpy as np
import pytest

from psmpc_cli.ocp.window import SHORTEST
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.bench_problems import Problem, relative
from psmpc_cli.studies.bench_solves import COLD, REFERENCE, WARM, Solved, Way, time_solves, ways_with
from psmpc_cli.studies.bench_windows import Recorded

from .small_bench import posed, recorded_run

REPEAT = 2


@pytest.fixture(scope="module")
def problems() -> list[Problem]:
    run: tuple[Experiment, list[Recorded]] = recorded_run()
    return posed(*run, "controller.nodes=6")[1:]


@pytest.fixture(scope="module")
def solved(problems: list[Problem]) -> list[Solved]:
    spec = recorded_run()[0].task.solver
    return time_solves(problems, ways_with(("sqp", "ipopt")), spec, REPEAT, seed=0)


def test_every_back_end_starts_warm_and_cold_and_the_reference_cold() -> None:
    assert ways_with(("sqp",)) == (Way("sqp", WARM), Way("sqp", COLD), Way(REFERENCE, COLD))


def test_every_window_is_timed_every_way(problems: list[Problem], solved: list[Solved]) -> None:
    assert len(solved) == len(problems) * 5
    assert len({(one.index, one.way) for one in solved}) == len(solved)
    for one in solved:
        assert one.times.shape == (REPEAT,)
        assert np.all(one.times > 0)
        assert one.busy > 0


def test_the_reference_way_and_the_back_ends_agree_on_the_optimum(
    problems: list[Problem], solved: list[Solved]
) -> None:
    optima = {problem.index: problem.optimum for problem in problems}
    for one in solved:
        optimum = optima[one.index]
        assert optimum is not None
        assert not one.failed
        assert abs(relative(one.objective, optimum.objective)) < (1e-3 if one.way == Way("sqp", WARM) else 1e-5)
        assert np.abs(one.instants - optimum.instants).max() < SHORTEST
        assert one.violation < 1e-4


def test_the_order_of_the_solves_changes_no_result(problems: list[Problem], solved: list[Solved]) -> None:
    spec = recorded_run()[0].task.solver
    again = time_solves(problems, ways_with(("sqp", "ipopt")), spec, 1, seed=1)
    assert [one.objective for one in again] == [one.objective for one in solved]
    assert [one.iterations for one in again] == [one.iterations for one in solved]


def test_a_solve_that_fails_is_kept_as_failed(problems: list[Problem]) -> None:
    spec = recorded_run()[0].task.solver.model_copy(update={"max_iterations": 1})
    by_way = {one.way: one for one in time_solves(problems[:1], ways_with(("ipopt",)), spec, 1, seed=0)}
    assert by_way[Way("ipopt", COLD)].outcome is Outcome.ITERATION_LIMIT
    assert by_way[Way("ipopt", COLD)].failed
    assert not by_way[Way(REFERENCE, COLD)].failed  # which has options of its own
