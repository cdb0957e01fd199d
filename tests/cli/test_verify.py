from pathlib import Path

import h5py
import pytest

from .on_a_log import COMPARISON, Psmpc, is_refused, part, psmpc

__all__ = ["part", "psmpc"]


def test_a_verification_names_what_where_and_when(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("verify", "part.h5", "--every", "2")
    assert (ran.code, ran.stderr) == (0, "")
    assert "3 horizons, the low-level law acting at every instant" in ran.stdout
    assert "closed loop, 6 samples, each from its logged state, the force held over a tick" in ran.stdout
    for name in ("position off the plan", "beyond a velocity limit", "logged state off the integrated one"):
        assert any(line.startswith(name) for line in ran.stdout.splitlines())
    assert psmpc("verify", "part.h5", "--every", "0").code == 2


REFUSED = [
    (("verify", "task.yaml"), "task.yaml: found no HDF5 file"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[" ".join(arguments) for arguments, _ in REFUSED])
def test_bad_input_is_refused_in_one_message(
    psmpc: Psmpc, part: Path, arguments: tuple[str, ...], message: str
) -> None:
    before = part.read_bytes()
    assert is_refused(psmpc(*arguments), message)
    assert part.read_bytes() == before


def test_a_comparison_is_no_log(psmpc: Psmpc, part: Path) -> None:
    with h5py.File(part, "r+") as file:
        file.attrs["kind"] = "comparison"
    assert is_refused(psmpc("verify", "part.h5"), COMPARISON)
