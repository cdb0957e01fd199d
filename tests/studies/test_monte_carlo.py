"""Monte Carlo studies of the small task, and their rates and spreads."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.schema import MONTE_CARLO
from psmpc_cli.progress import Progress
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
from psmpc_cli.studies.runner import Study, run_study

from ..short_runs import TASK
from ..synthetic_monte_carlo import synthetic_monte_carlo

pytestmark = pytest.mark.slow

NOISE = "uncertainty.noise={position: 1e-3, angle: 1e-3}"


def study_of(folder: Path, runs: int, *changes: str) -> Study:
    (folder / "task.yaml").write_text(TASK)
    return monte_carlo_study(str(folder / "task.yaml"), runs, (NOISE, "seed=4", *changes))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def runs(folder: Path) -> MonteCarloRuns:
    """Three runs, of seeds 4 to 6."""
    return MonteCarloRuns(run_study(study_of(folder, 3), folder / "study.h5", 2))


def test_a_run_is_recorded_as_the_same_seed_simulates(runs: MonteCarloRuns, folder: Path) -> None:
    assert runs["seed"].tolist() == [4, 5, 6]
    summary = simulate(load_task(folder / "task.yaml", [NOISE, "seed=5"])).summary()
    assert summary.end_errors is not None
    assert runs["end_time"][1] == summary.duration
    assert runs["final_error"][1] == summary.end_errors[1]
    assert runs["switch_time"][1].tolist() == [stage.switch_time for stage in summary.stages]
    assert runs["actual_start"][1].tolist() == [stage.actual_start for stage in summary.stages]
    assert runs["velocity_margin"][1] == {limit.kind: limit.margin for limit in summary.limits}["velocity"]
    assert runs["monitor_margin"][1].tolist() == [summary.monitors[0].margin]
    assert runs["control_effort"][1] == summary.control_effort
    assert (runs["succeeded"][1], runs["solves_failed"][1]) == (summary.succeeded, summary.failed_solves)
    assert len(np.unique(runs["final_error"])) == 3
    assert runs.command(2) == f"psmpc simulate {folder / 'task.yaml'} --set '{NOISE}' --set seed=4 --set seed=6"


def test_a_monitor_that_does_not_hold_and_a_time_limit_are_failures(tmp_path: Path) -> None:
    low = MonteCarloRuns(run_study(study_of(tmp_path, 1, "monitors[0].at_least=5"), jobs=2))
    assert (low["completed"].tolist(), low["succeeded"].tolist()) == ([1], [0])
    assert low["monitor_margin"][0, 0] < 0
    assert low.why(0).endswith("monitor did not hold: far apart")
    late = MonteCarloRuns(run_study(study_of(tmp_path, 1, "time_limit=0.3", "monitors=[]"), jobs=2))
    assert late.why(0) == "time limit of 0.3 s reached"
    assert np.isnan(late.end_time).all()
    assert late["end_time"][0] == pytest.approx(0.3)
    assert not late.monitors


def test_a_study_is_resumed_with_more_runs_and_not_with_fewer(tmp_path: Path, runs: MonteCarloRuns) -> None:
    path, seen = tmp_path / "study.h5", list[Progress]()
    run_study(study_of(tmp_path, 2), path, 2)
    first = read_results(path, MONTE_CARLO)["cell_time"]
    found = MonteCarloRuns(run_study(study_of(tmp_path, 3), path, 2, resume=True, watch=seen.append))
    assert seen[-1].total == 1
    assert found["cell_time"][:2].tolist() == first.tolist()
    for name, quantity in runs.results.quantities.items():
        if "wall time" not in quantity.long_name:
            np.testing.assert_array_equal(found[name], quantity.values, name)
    assert [each.name for each in tmp_path.glob("*study*")] == ["study.h5"]
    with pytest.raises(InputError, match="has 3 runs, found 2, expected at least as many"):
        run_study(study_of(tmp_path, 2), path, resume=True)


@pytest.mark.parametrize(
    ("successes", "runs", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),
        (5, 10, 0.2366, 0.7634),
        (10, 10, 0.7225, 1.0),
        (1, 29, 0.0061, 0.1718),  # Newcombe, Statistics in Medicine 17 (1998), 857-872, table I
        (0, 0, 0.0, 1.0),
    ],
)
def test_intervals_are_the_published_ones(tmp_path: Path, successes: int, runs: int, low: float, high: float) -> None:
    found = synthetic_monte_carlo(tmp_path / "study.h5", max(runs, 1), tuple(range(runs, 1)), range(successes, runs))
    assert found.interval == pytest.approx((low, high), abs=5e-5)


@pytest.fixture
def made_up(tmp_path: Path) -> MonteCarloRuns:
    return synthetic_monte_carlo(tmp_path / "study.h5", waiting=(11,), crashed=(2,), late=(5,), dropped=(7,))


def test_the_worst_runs_failed_then_are_late_then_wrong(made_up: MonteCarloRuns) -> None:
    assert made_up.worst(5).tolist() == [2, 5, 7, 10, 9]
    assert made_up.why(2) == "crashed: ZeroDivisionError: by zero"
    assert made_up.why(5) == "time limit of 60 s reached"
    assert made_up.why(7) == "release met its end condition; monitor did not hold: object held"
    assert made_up.why(10) == "release met its end condition"
    assert made_up.command(5).endswith("--set seed=10 --set seed=15")


def test_forces_are_in_the_table_where_they_have_limits(made_up: MonteCarloRuns) -> None:
    rows = ["largest commanded force [% of its limit]", "forces cut at their limits [% of the time]"]
    assert not {*rows} & {*dict(made_up.spread())}
    made_up["force_utilization"][:4] = [0.5, 1.5, 1.0, 1.0]
    made_up["force_saturated"][:4] = [0.0, 0.25, 0.0, 0.0]
    spread = dict(made_up.spread())
    assert [len(spread[row]) for row in rows] == [4, 4]
    assert [np.median(spread[row]) for row in rows] == [100.0, 0.0]


def test_distances_are_in_the_table_where_parts_keep_clear(made_up: MonteCarloRuns) -> None:
    row = "smallest distance of parts [mm]"
    assert row not in {*dict(made_up.spread())}
    made_up["smallest_clearance"][:3] = [0.02, -0.005, 0.04]
    made_up["touched"][:3] = [0.0, 1.0, 0.0]
    assert dict(made_up.spread())[row].tolist() == pytest.approx([20.0, -5.0, 40.0])


def test_a_quantity_spreads_over_the_runs_that_have_it(made_up: MonteCarloRuns) -> None:
    spread = dict(made_up.spread())
    successful = 28 + 0.01 * np.array([0, 1, 3, 4, 6, 8, 9, 10])
    assert spread["mission ends, successful runs [s]"] == pytest.approx(successful)
    assert len(spread["final error [tolerances]"]) == 10
    assert set(spread["tightest position margin [% of the limit]"]) == {50.0}
