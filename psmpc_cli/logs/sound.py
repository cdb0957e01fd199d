"""Whether what a log says fits together, so that whatever is made from it meets no surprise."""

from collections.abc import Mapping

import numpy as np

from psmpc_cli.logs.schema import SCHEMA, Column

Arrays = Mapping[str, np.ndarray]

LARGEST = 1e60
"""Size of a finite number that is still believed: sums and squares of it are within the range of a float."""

BOUNDED = ("time", "state/", "control/", "force/", "pose/", "effort/", "balance/", "final/", "ticks/")
"""Where nothing is infinite; margins without limits and costs are."""

TEXTS = ("end_reason", "controller", "task_name", "task_yaml", "robot_yaml")


def ensure_sound(attributes: Mapping[str, object], arrays: Arrays) -> None:
    """Make sure that attributes, arrays and their sizes are those of a log.

    Args:
        attributes: Attributes of the log.
        arrays: Its arrays by path, scales among them; what the layout does not know is not looked at.

    Raises:
        ValueError: Something does not fit; the message says what.
    """
    _check_attributes(attributes)
    for path in ("coordinate", "pose_coordinate", "stage"):
        _check_names(path, arrays[path])
    for column in SCHEMA:
        if (values := arrays.get(column.path)) is not None:
            dims = ["ticks/time" if dim == "ticks/tick" else dim for dim in column.dims]
            _check(column, values, tuple(_size(arrays, dim) for dim in dims))
    for path in ("time", "ticks/time"):
        _check_times(path, arrays.get(path, np.zeros(0)))
    _check_windows(arrays["window/first"], arrays["window/count"], len(arrays["stage"]))


def ensure_believable(path: str, values: np.ndarray) -> None:
    """Make sure that numbers can be summed and squared.

    Raises:
        ValueError: One is too large.
    """
    if values.dtype.kind != "f":
        return
    if np.any(np.isfinite(values) & (np.abs(values) > LARGEST)):
        raise ValueError(f"{path} holds a number beyond {LARGEST:g}")
    if path.startswith(BOUNDED) and np.isinf(values).any():
        raise ValueError(f"{path} holds an infinite number")


def _size(arrays: Arrays, path: str) -> int:
    """Return how long the array of a dimension is."""
    if arrays[path].ndim != 1:
        raise ValueError(f"{path} has shape {arrays[path].shape}")
    return len(arrays[path])


def _check_attributes(attributes: Mapping[str, object]) -> None:
    for name in TEXTS:
        if not isinstance(attributes[name], str):
            raise ValueError(f"the attribute {name} is no text")
    if not isinstance(attributes["finished"], bool | np.bool_ | int | np.integer):
        raise ValueError("the attribute finished is neither true nor false")


def _check_names(path: str, names: np.ndarray) -> None:
    if names.ndim != 1 or names.dtype.kind != "U" or not len(names) or len(set(names.tolist())) < len(names):
        raise ValueError(f"{path} is no list of names")


def _check(entry: Column, values: np.ndarray, shape: tuple[int, ...]) -> None:
    """Check kind, size and numbers of an array."""
    text = entry.dtype in ("text", "S16")
    right = values.dtype.kind == "U" if text else values.dtype == np.dtype(entry.dtype)
    if not right or values.shape != shape:
        raise ValueError(
            f"{entry.path} has shape {values.shape} and type {values.dtype}, not {shape} and {entry.dtype}"
        )
    ensure_believable(entry.path, values)


def _check_times(path: str, times: np.ndarray) -> None:
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all() and (times >= 0).all()):
        raise ValueError(f"{path} does not rise")


def _check_windows(first: np.ndarray, count: np.ndarray, stages: int) -> None:
    wrong = (first < 0) | (count < 1) | (count > stages - first)
    if wrong.any():
        raise ValueError(f"the window of sample {int(np.argmax(wrong))} holds stages that are not there")
