"""Tables of studies, from files with made-up numbers."""

from pathlib import Path

import pytest

from ..made_up_fronts import made_up_fronts
from ..made_up_monte_carlo import made_up_monte_carlo
from ..made_up_sweep import T_S, made_up_sweep, numbers
from .command import Psmpc


@pytest.fixture
def shown(psmpc: Psmpc) -> Psmpc:
    """The lines of `psmpc show FILE`."""
    return lambda path: psmpc("show", str(path)).stdout.splitlines()


def test_a_sweep_has_a_row_for_each_ratio_and_a_recommendation(tmp_path: Path, shown: Psmpc) -> None:
    path = tmp_path / "sweep.h5"
    made_up_sweep(path, "3x3")
    heading, names, *rows = shown(path)
    assert heading == "actual start of capture [s] by threshold epsilon"
    assert names.split()[:3] == ["omega_2/omega_1", "0.001", "0.1"]
    assert [row.split()[0] for row in rows[:5]] == ["1e-06", "0.001", "1", "1000", "1e+06"]
    cell = numbers(1.0)
    fine, coarse = cell["actual_start"]
    assert rows[2].split() == ["1", f"{fine}", f"{coarse}", f"{T_S}", f"{cell['completion_time']:.2f}", "1.01", "0.90"]
    assert rows[5].startswith("9 cells: 9 computed; 900 solves")
    assert rows[6].startswith("recommended omega_2/omega_1: ")
    assert rows[7] == f"sweep: {path}"


@pytest.mark.parametrize(
    ("sampling", "given", "lines"),
    [
        (
            "3x3",
            {"failed": (0, 1), "waiting": (2, 3, 4)},
            ("9 cells: 3 waiting, 4 computed, 2 failed", "  2 failed: time limit of 30 s reached"),
        ),
        ("3", {"waiting": (0, 1, 2)}, ("3 cells: 3 waiting", "no ratio is recommended")),
        ("101", {}, ("1e-06", "1e+06", "49 of 101 ratios")),
        ("3x3", {"task": "transport"}, ("omega_1  omega_2", "1000", "9 cells")),
    ],
    ids=["failed", "waiting", "many", "runs of one ratio that differ"],
)
def test_a_sweep_that_is_not_complete_or_not_small(
    tmp_path: Path, shown: Psmpc, sampling: str, given: dict[str, object], lines: tuple[str, ...]
) -> None:
    made_up_sweep(tmp_path / "sweep.h5", sampling, **given)
    found = shown(tmp_path / "sweep.h5")
    assert all(any(line.strip().startswith(expected.strip()) for line in found) for expected in lines), found


def test_a_monte_carlo_study_has_rate_spread_and_worst_runs(tmp_path: Path, shown: Psmpc) -> None:
    path = tmp_path / "study.h5"
    made_up_monte_carlo(path, waiting=(11,), crashed=(2,), late=(5,))
    first, heading, *lines = shown(path)
    assert first == (
        "9 of 11 runs succeeded: 81.8 %, 95 % interval 52.3 to 94.9 % (1 waiting, 10 ended, 1 crashed); "
        "9 of 11 exceeded a velocity limit, by up to 10 %"
    )
    assert heading.split()[-7:] == ["runs", "5", "%", "50", "%", "95", "%"]
    worst = lines.index("worst runs: failed, latest, largest error")
    assert lines[worst + 2].split() == ["12", "failed", "-", "-", *["crashed:", "ZeroDivisionError:", "by", "zero"]]
    assert lines[worst + 3].split()[:4] == ["15", "failed", "60.00", "300.000"]
    assert lines[-2].startswith("repeat one: psmpc simulate transport --set 'uncertainty.noise={position: 1e-3}'")
    assert lines[-2].endswith("--set seed=12")
    assert lines[-1] == f"study: {path}"


def test_a_monte_carlo_study_without_runs_says_so(tmp_path: Path, shown: Psmpc) -> None:
    made_up_monte_carlo(tmp_path / "study.h5", runs=2, waiting=(0, 1))
    lines = shown(tmp_path / "study.h5")
    assert lines[0] == "no run was made yet: 2 waiting"
    assert not any(line.startswith("worst") for line in lines)


def test_fronts_have_a_row_for_each_sample_and_how_they_move(tmp_path: Path, shown: Psmpc) -> None:
    path = tmp_path / "pareto.h5"
    made_up_fronts(path, failed=(1,))
    heading, *rows = shown(path)
    assert heading.split()[:4] == ["T0", "[s]", "t_s", "[s]"]
    assert [row.split()[0] for row in rows[:3]] == ["6.50", "7.50", "8.50"]
    assert [row.split()[-1] for row in rows[:3]] == ["0", "7", "0"]
    assert any("upper left at 2 of 3 instants" in row for row in rows)
    assert rows[-1] == f"results: {path}"
