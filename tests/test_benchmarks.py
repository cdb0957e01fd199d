"""Every benchmark can be imported, and what is stored of its results elsewhere is what its file has."""

import runpy
from pathlib import Path

import pytest

from psmpc_cli.paper.claims import load_claims

FOLDER = Path(__file__).parents[1] / "benchmarks"

OTHER_PROGRAMS = ("acados_peer.py", "rockit_peer.py", "do_mpc_peer.py")
"""Those that run in environments of their own, without psmpc."""

SCRIPTS = [
    path for path in sorted(FOLDER.rglob("*.py")) if path.name not in OTHER_PROGRAMS and ".venv" not in str(path)
]


@pytest.mark.parametrize("path", SCRIPTS, ids=[path.stem for path in SCRIPTS])
def test_a_benchmark_can_be_imported(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(path.parent)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # which one of them sets
    assert runpy.run_path(str(path), run_name="imported")["__doc__"]


def test_the_claims_say_in_how_many_searched_settings_they_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDER)
    calibration = runpy.run_path(str(FOLDER / "calibration.py"), run_name="imported")
    counts = {name: (holds, total) for name, (holds, _, total) in calibration["count_held"]().items()}
    assert counts == {claim.id: claim.searched for claim in load_claims() if claim.searched is not None}


@pytest.mark.slow
def test_a_published_problem_with_force_limits_has_the_published_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    detumble = runpy.run_path(str(FOLDER / "detumble.py"), run_name="imported")
    rows = [line.split("|")[2] for line in detumble["table"]() if "intervals" in line]
    assert len(rows) == 8
    assert [float(cost) for cost in rows] == pytest.approx(8 * [8.507], rel=0.02)


@pytest.mark.slow
def test_the_same_problem_with_thrusters_has_the_optimum_in_thrusts(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPOPT with thrusts as inputs; they bind, so that it takes half as long again."""
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    detumble = runpy.run_path(str(FOLDER / "detumble.py"), run_name="imported")
    own, *rows = [line.split("|")[2:4] for line in detumble["thrusters"]() if "optimum" in line or "intervals" in line]
    optimum, duration = map(float, own)
    assert duration > 1.4 * detumble["OPTIMUM"]["duration"]
    assert len(rows) == 4
    assert [float(cost) for cost, _ in rows] == pytest.approx(4 * [optimum], rel=0.02)
    assert [float(time) for _, time in rows] == pytest.approx(4 * [duration], rel=0.03)
