from pathlib import Path

import h5py

from .command import Psmpc


def test_a_rerun_says_whether_everything_is_equal(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("rerun", "part.h5", "--quiet", "--strict", "-o", "again.h5")
    assert (ran.code, ran.stderr) == (0, "")
    assert ran.stdout.startswith("equal: all ")
    with h5py.File("again.h5", "r+") as file:
        file["force/F"][4, 1] += 1.0
    ran = psmpc("rerun", "again.h5", "--quiet")
    assert ran.code == 0
    assert ["force/F", "N,", "N", "m", "1.0e+00", "4"] in [line.split() for line in ran.stdout.splitlines()]
    assert "differs: 1 of " in ran.stdout
    assert psmpc("rerun", "again.h5", "--quiet", "--strict").code == 1
    assert sorted(path.name for path in Path().glob("*.h5")) == ["again.h5", "part.h5"]
