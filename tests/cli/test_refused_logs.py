"""What every command that starts from a log refuses, in one message and without touching the log."""

from pathlib import Path

import h5py
import pytest

from .command import Psmpc, Ran

COMPARISON = "part.h5: found a comparison of several runs, expected the log of one"

REFUSED = [
    (("rerun", "part.h5", "-o", "part.h5"), "part.h5 exists already"),
    (("verify", "task.yaml"), "task.yaml: found no HDF5 file"),
    (("simulate",), "found no task: expected a task file, a built-in name such as transport, or --continue LOG"),
    (("simulate", "task.yaml", "--continue", "part.h5"), "--continue goes on with the task in the log"),
    (("simulate", "--continue", "part.h5", "--plant", "rk4"), "--continue goes on with the task in the log"),
    (("simulate", "--continue", "none.h5"), "none.h5: found no such file"),
    (("replay", "part.h5", "--step", "6"), "part.h5: found no sample 6; expected one from 0 to 5"),
    (("replay", "part.h5", "--step", "2", "--solver", "nlp"), 'solver.kind: found the text "nlp", expected one of'),
    (("replay", "part.h5", "--step", "2", "--solver", "a=b"), "--solver: found 'a=b', expected the name of a solver"),
]


def is_refused(ran: Ran, message: str) -> bool:
    """Return whether bad input was refused in one message, and nothing else was said."""
    return (ran.code, ran.stdout) == (2, "") and message in ran.stderr and "Traceback" not in ran.stderr


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[" ".join(arguments) for arguments, _ in REFUSED])
def test_bad_input_is_refused_in_one_message(
    psmpc: Psmpc, part: Path, arguments: tuple[str, ...], message: str
) -> None:
    before = part.read_bytes()
    assert is_refused(psmpc(*arguments), message)
    assert part.read_bytes() == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("rerun", "part.h5"),
        ("verify", "part.h5"),
        ("simulate", "--continue", "part.h5"),
        ("replay", "part.h5", "--step", "0"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_comparison_is_no_log(psmpc: Psmpc, part: Path, arguments: tuple[str, ...]) -> None:
    with h5py.File(part, "r+") as file:
        file.attrs["kind"] = "comparison"
    assert is_refused(psmpc(*arguments), COMPARISON)
