from pathlib import Path

import pytest

from psmpc_cli.cli.monte_carlo_table import print_monte_carlo

from ..made_up_monte_carlo import made_up_monte_carlo


def printed(capsys: pytest.CaptureFixture[str], path: Path, **given: object) -> list[str]:
    print_monte_carlo(made_up_monte_carlo(path, **given))
    return capsys.readouterr().out.splitlines()


def test_the_rate_the_spread_and_the_worst_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, heading, *lines = printed(capsys, tmp_path / "study.h5", waiting=(11,), crashed=(2,), late=(5,))
    assert first == ("9 of 11 runs succeeded: 81.8 %, 95 % interval 52.3 to 94.9 % (1 waiting, 10 ended, 1 crashed)")
    assert heading.split()[-7:] == ["runs", "5", "%", "50", "%", "95", "%"]
    worst = lines.index("worst runs: failed, latest, largest error")
    assert lines[worst + 2].split() == ["12", "failed", "-", "-", *["crashed:", "ZeroDivisionError:", "by", "zero"]]
    assert lines[worst + 3].split()[:4] == ["15", "failed", "60.00", "300.000"]
    assert lines[worst + 4].split()[:2] == ["20", "succeeded"]
    assert lines[-2].startswith("repeat one: psmpc simulate transport --set 'uncertainty.noise={position: 1e-3}'")
    assert lines[-2].endswith("--set seed=12")
    assert lines[-1] == f"study: {tmp_path / 'study.h5'}"


def test_a_study_that_has_not_begun_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "study.h5", runs=2, waiting=(0, 1))
    assert lines[0] == "no run was made yet: 2 waiting"
    assert not any(line.startswith("worst") for line in lines)
