from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.seal import seal, unseal
from psmpc_cli.simulation.monte_carlo_runs import MonteCarloRuns, read_monte_carlo, wilson_interval

from ..made_up_monte_carlo import made_up_monte_carlo


@pytest.mark.parametrize(
    ("successes", "runs", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),
        (5, 10, 0.2366, 0.7634),
        (10, 10, 0.7225, 1.0),
        (81, 263, 0.2553, 0.3662),  # Newcombe, Statistics in Medicine 17 (1998), 857-872, table I, as the next
        (15, 148, 0.0624, 0.1605),
        (1, 29, 0.0061, 0.1718),
        (0, 0, 0.0, 1.0),
    ],
)
def test_intervals_are_the_published_ones(successes: int, runs: int, low: float, high: float) -> None:
    assert wilson_interval(successes, runs) == pytest.approx((low, high), abs=5e-5)


def test_an_interval_holds_the_rate_and_shrinks_with_more_runs() -> None:
    for runs in (1, 10, 100):
        for successes in range(runs + 1):
            low, high = wilson_interval(successes, runs)
            assert 0 <= low <= successes / runs <= high <= 1
            lower, higher = wilson_interval(4 * successes, 4 * runs)
            assert higher - lower < high - low


@pytest.fixture
def runs(tmp_path: Path) -> MonteCarloRuns:
    return made_up_monte_carlo(tmp_path / "study.h5", waiting=(11,), crashed=(2,), late=(5,), dropped=(7,))


def test_a_crash_counts_as_a_failure_and_a_waiting_run_not_at_all(runs: MonteCarloRuns) -> None:
    assert np.flatnonzero(runs.failed).tolist() == [2, 5, 7]
    assert (runs.succeeded.sum(), runs.made.sum()) == (8, 11)
    assert runs.interval == wilson_interval(8, 11)


def test_the_worst_runs_failed_then_are_late_then_wrong(runs: MonteCarloRuns) -> None:
    assert runs.worst(5).tolist() == [2, 5, 7, 10, 9]
    assert runs.why(2) == "crashed: ZeroDivisionError: by zero"
    assert runs.why(5) == "time limit of 60 s reached"
    assert runs.why(7) == "release met its end condition; monitor did not hold: object held"
    assert runs.why(10) == "release met its end condition"
    assert runs.command(5).endswith("--set seed=10 --set seed=15")


def test_quantiles_are_over_the_runs_that_have_the_quantity(runs: MonteCarloRuns) -> None:
    spread = {each.name: each for each in runs.quantiles()}
    ends = spread["mission ends, completed runs [s]"]
    completed = 28 + 0.01 * np.array([0, 1, 3, 4, 6, 7, 8, 9, 10])
    assert ends.runs == 9
    assert ends.at == pytest.approx(np.quantile(completed, (0.05, 0.5, 0.95)))
    assert spread["final error [tolerances]"].runs == 10
    assert spread["tightest position margin [% of the limit]"].at == (50.0, 50.0, 50.0)


def test_a_study_without_a_run_knows_nothing(tmp_path: Path) -> None:
    runs = made_up_monte_carlo(tmp_path / "study.h5", 2, waiting=(0, 1))
    assert runs.interval == (0.0, 1.0)
    assert not len(runs.worst(5))
    assert all(np.isnan(each.at).all() and not each.runs for each in runs.quantiles())


@pytest.mark.parametrize("name", ["status", "seed", "switch_time", "monitor_margin", "final_error"])
def test_an_array_of_another_shape_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "study.h5"
    made_up_monte_carlo(path, 2)
    unseal(path)
    with h5py.File(path, "r+") as file:
        described = dict(file[name].attrs)
        del file[name]
        dataset = file.create_dataset(name, data=1)
        dataset.attrs.update({key: described[key] for key in ("units", "long_name")})
    seal(path)
    with pytest.raises(LogError, match=f"expected {name} along run"):
        read_monte_carlo(path)
