import numpy as np
import pytest

from psmpc_cli.ocp.node_counts import COUNTS
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.studies.bench_problems import Problem, relative
from psmpc_cli.studies.bench_windows import Recorded

from .small_bench import posed, recorded_run


@pytest.fixture(scope="module")
def run() -> tuple[Experiment, list[Recorded]]:
    return recorded_run()


@pytest.fixture(scope="module", params=["5", "8"])
def problems(run: tuple[Experiment, list[Recorded]], request: pytest.FixtureRequest) -> list[Problem]:
    return posed(*run, f"controller.nodes={request.param}")


def test_a_window_stands_on_the_mesh_that_is_asked_for(problems: list[Problem]) -> None:
    nodes = int(problems[0].nodes)
    assert [problem.window.nodes for problem in problems] == [(nodes,), (nodes, nodes), (nodes, nodes)]
    for problem in problems:
        assert len(problem.bounds.lbx) == problem.nlp.layout.size == len(problem.starts["cold"].z)


def test_an_automatic_mesh_gives_each_stage_its_own_nodes(run: tuple[Experiment, list[Recorded]]) -> None:
    for problem in posed(*run, "controller.nodes=auto"):
        assert set(problem.window.nodes) <= set(COUNTS)
        assert problem.optimum is not None


def test_a_warm_start_has_multipliers_unless_a_stage_has_just_entered(problems: list[Problem]) -> None:
    assert [problem.starts["warm"].lam_g is not None for problem in problems] == [True, False, True]


def test_a_cold_start_knows_no_control(problems: list[Problem]) -> None:
    for problem in problems:
        plan = problem.plan(problem.starts["cold"].z)
        assert not plan.u.any()
        assert np.array_equal(plan.X[0], problem.window.x0)
        warm = problem.plan(problem.starts["warm"].z)
        assert np.array_equal(plan.instants, warm.instants)


def test_both_back_ends_agree_on_the_optimum(problems: list[Problem]) -> None:
    for problem in problems:
        assert problem.optimum is not None
        assert problem.optimum.apart < 1e-5
        assert np.all(np.diff(problem.optimum.instants, prepend=problem.window.start) > 0)


def test_a_gap_has_a_sign() -> None:
    assert relative(1.1, 1.0) == pytest.approx(0.1)
    assert relative(-1.1, -1.0) == pytest.approx(-0.1)
