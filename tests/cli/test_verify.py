from pathlib import Path

from ..simulation.logged import there_and_back
from .command import Psmpc


def test_a_verification_names_what_where_and_when(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("verify", "part.h5", "--every", "2")
    assert (ran.code, ran.stderr) == (0, "")
    assert "3 horizons, the low-level law acting at every instant" in ran.stdout
    assert "closed loop, 6 samples, each from its logged state, the force held over a tick" in ran.stdout
    for name in ("position off the plan", "beyond a velocity limit", "logged state off the integrated one"):
        assert any(line.startswith(name) for line in ran.stdout.splitlines())
    assert psmpc("verify", "part.h5", "--every", "0").code == 2


def test_a_closed_loop_that_is_left_out_has_no_table(psmpc: Psmpc, tmp_path: Path) -> None:
    there_and_back(tmp_path, "controller.offset_free=true", samples=3, name="uncertain")
    ran = psmpc("verify", "uncertain.h5")
    assert (ran.code, ran.stderr) == (0, "")
    assert "3 horizons" in ran.stdout
    assert "note: the closed loop was left out" in ran.stdout
    assert "closed loop, " not in ran.stdout
    assert "logged state off the integrated one" not in ran.stdout
