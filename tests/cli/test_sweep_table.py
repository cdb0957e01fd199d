from pathlib import Path

import pytest

from psmpc_cli.cli.sweep_table import MOST_ROWS, print_sweep

from ..made_up_sweep import T_S, made_up_sweep, numbers


def printed(capsys: pytest.CaptureFixture[str], *arguments: object, **given: object) -> list[str]:
    print_sweep(made_up_sweep(*arguments, **given))
    return capsys.readouterr().out.splitlines()


def test_a_row_a_ratio_says_what_became_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sweep.h5"
    heading, names, *rows = printed(capsys, path, "3x3")
    assert heading == "actual start of capture [s] by threshold epsilon"
    assert names.split()[:3] == ["omega_2/omega_1", "0.001", "0.1"]
    assert [row.split()[0] for row in rows[:5]] == ["1e-06", "0.001", "1", "1000", "1e+06"]
    cell = numbers(1.0)
    fine, coarse = cell["actual_start"]
    assert rows[2].split() == ["1", f"{fine}", f"{coarse}", f"{T_S}", f"{cell['completion_time']:.2f}", "1.01", "0.90"]
    assert rows[5] == "9 cells: 9 computed; 900 solves, 0 of them failed"
    assert rows[6].startswith("recommended omega_2/omega_1: ")
    assert rows[7] == f"sweep: {path}"


def test_failures_are_told_with_their_reasons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "sweep.h5", "3x3", failed=(0, 1), waiting=(2, 3, 4))
    assert "9 cells: 3 waiting, 4 computed, 2 failed; 400 solves, 0 of them failed" in lines
    assert "  2 failed: time limit of 30 s reached" in lines


def test_a_sweep_without_ended_cells_has_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "sweep.h5", "3", waiting=(0, 1, 2))
    assert lines[0] == "3 cells: 3 waiting; 0 solves, 0 of them failed"
    assert lines[1].startswith("no ratio is recommended")


def test_of_many_ratios_some_are_printed_the_first_and_last_among_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, _, *rows = printed(capsys, tmp_path / "sweep.h5", "101")
    assert rows[MOST_ROWS] == f"{MOST_ROWS} of 101 ratios"
    assert (rows[0].split()[0], rows[MOST_ROWS - 1].split()[0]) == ("1e-06", "1e+06")
