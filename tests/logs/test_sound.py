"""A log whose parts do not fit together is refused, and the message says which."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.read import read_log
from psmpc_cli.logs.write import LogWriter

from .records import HEADER, record

Change = Callable[[h5py.File], object]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.h5"
    with LogWriter(path, HEADER) as log:
        for k in range(3):
            log.write(record(k))
    return path


def entry(name: str, index: object, value: object) -> Change:
    return lambda file: file[name].__setitem__(index, value)


def other(name: str, values: np.ndarray) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = values

    return change


def attribute(name: str, value: object) -> Change:
    return lambda file: file.attrs.__setitem__(name, value)


UNSOUND: list[tuple[Change, str]] = [
    (attribute("task_yaml", 5), "the attribute task_yaml is no text"),
    (attribute("finished", "yes"), "the attribute finished is neither true nor false"),
    (other("state/Q", np.zeros((3, 7))), "state/Q has shape (3, 7) and type float64, not (3, 3) and f8"),
    (other("state/Q", np.full((3, 3), 3e38, "f4")), "state/Q has shape (3, 3) and type float32, not (3, 3) and f8"),
    (other("window/count", np.ones(3)), "window/count has shape (3,) and type float64, not (3,) and i4"),
    (other("final/Q", np.zeros(4)), "final/Q has shape (4,) and type float64, not (3,) and f8"),
    (entry("time", 1, 0.0), "time does not rise"),
    (entry("time", 2, np.nan), "time does not rise"),
    (entry("window/first", 1, 4), "the window of sample 1 holds stages that are not there"),
    (entry("window/count", 2, 5), "the window of sample 2 holds stages that are not there"),
    (entry("ticks/Q", (0, 0), 1e300), "ticks/Q holds a number beyond 1e+60"),
    (entry("stage", 1, "a"), "stage is no list of names"),
]


@pytest.mark.parametrize(("change", "found"), UNSOUND, ids=[found for _, found in UNSOUND])
def test_what_does_not_fit_is_named(path: Path, change: Change, found: str) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(LogError) as refused:
        read_log(path)
    assert f"cut off or damaged ({found})" in str(refused.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e59])
def test_numbers_that_are_not_known_or_have_no_bound_are_sound(path: Path, value: float) -> None:
    with h5py.File(path, "r+") as file:
        file["margin/position"][...] = value
    assert len(read_log(path).time) == 3
