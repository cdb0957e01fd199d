"""The weight study: how the ratio of the priorities decides when Capture starts. Paper section IV-B, Fig. 6."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.runner import COMPUTED, run_study
from psmpc_cli.studies.sampling import parse_sampling
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, weight_study

pytestmark = pytest.mark.slow

BASELINE = yaml.safe_load((Path(__file__).parents[2] / "benchmarks" / "weights.yaml").read_text(encoding="utf-8"))

SAMPLE = 0.1 + 1e-9


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Five ratios from 1e-6 to 1e6 on a coarse mesh."""
    path = tmp_path_factory.mktemp("weights") / "sweep.h5"
    task = load_sweep_task(DEFAULT_TASK, ("controller.nodes=25",), ())
    return run_study(weight_study(task, (0, 1), parse_sampling("5", (1e-3, 1e3))), path, 2)


def test_no_cell_and_no_solve_fails_at_any_ratio(sweep: Results) -> None:
    assert np.all(sweep["status"] == COMPUTED)
    assert not sweep["solves_failed"].any()


def test_capture_starts_the_earlier_the_higher_the_ratio(sweep: Results) -> None:
    assert np.all(np.diff(sweep["actual_start"], axis=0) <= SAMPLE)
    assert np.all(sweep["actual_start"][0, -1] - sweep["actual_start"][-1, -1] > 3.5)


def test_capture_never_starts_before_its_switch_can_be_seen(sweep: Results) -> None:
    floor = sweep["switch_time"][:, :1] - 4.0
    assert np.all(sweep["actual_start"] >= floor - 1e-9)


def test_the_instant_stays_where_the_condition_can_first_be_met(sweep: Results) -> None:
    assert np.ptp(sweep["switch_time"][:, 0]) < SAMPLE
    np.testing.assert_allclose(sweep["instant_at_detection"], sweep["switch_time"][:, 0], atol=SAMPLE)


def test_the_starts_are_where_the_baseline_has_them(sweep: Results) -> None:
    rows = BASELINE["as shipped, N_s = 100"]["actual_start"]
    expected = np.array([rows[float(f"{ratio:.3g}")] for ratio in sweep["ratio"]])
    np.testing.assert_allclose(sweep["actual_start"], expected, atol=0.3 + 1e-9)
