from pathlib import Path

from .command import Psmpc


def test_a_verification_names_what_where_and_when(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("verify", "part.h5", "--every", "2")
    assert (ran.code, ran.stderr) == (0, "")
    assert "3 horizons, the low-level law acting at every instant" in ran.stdout
    assert "closed loop, 6 samples, each from its logged state, the force held over a tick" in ran.stdout
    for name in ("position off the plan", "beyond a velocity limit", "logged state off the integrated one"):
        assert any(line.startswith(name) for line in ran.stdout.splitlines())
    assert psmpc("verify", "part.h5", "--every", "0").code == 2
