"""Checks of arguments of the public functions: a wrong one is an `InputError` that says what was found and expected.

They stand where a value enters from Python; what the rooms hand to each other is trusted.
"""

import os
from collections.abc import Mapping
from math import inf
from multiprocessing import current_process
from numbers import Integral, Real
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.specs.document import counted, quoted, shortened


def rejected(name: str, value: object, wanted: str) -> InputError:
    """Create the error of an argument that is not what was wanted."""
    return InputError(f"{name}: found {_describe_argument(value)}, expected {wanted}")


def require(name: str, value: object, kinds: type | tuple[type, ...], wanted: str) -> None:
    """Make sure that an argument is of one of some types.

    Raises:
        InputError: It is not.
    """
    if not isinstance(value, kinds):
        raise rejected(name, value, wanted)


def require_callable(name: str, value: object, wanted: str) -> None:
    """Make sure that an argument can be called.

    Raises:
        InputError: It cannot.
    """
    if not callable(value):
        raise rejected(name, value, f"a function of {wanted}")


def require_whole(name: str, value: object, least: int, most: float = inf) -> None:
    """Make sure that an argument is a whole number in a range.

    Raises:
        InputError: It is not.
    """
    allowed = f"from {least} to {most:.0f}" if most < inf else f">= {least}"
    if not isinstance(value, Integral) or isinstance(value, bool) or not least <= int(value) <= most:
        raise rejected(name, value, f"a whole number {allowed}")


def as_path(name: str, value: str | os.PathLike[str]) -> Path:
    """Return the path of a file that an argument names.

    Raises:
        InputError: It is no path.
    """
    require(name, value, (str, os.PathLike), "the path of a file")
    if not str(value).strip() or "\0" in str(value):
        raise rejected(name, value, "the path of a file")
    return Path(value)


def require_options(
    path: str | os.PathLike[str] | None,
    jobs: int | None,
    force: bool,
    resume: bool = False,
    dask: str | None = None,
) -> Path | None:
    """Check the arguments that every function that runs a study takes, before it starts processes.

    Args:
        path: The file of results; None to keep them in memory.
        jobs: Number of processes at once; None for one a core.
        force: Whether an older file is replaced.
        resume: Whether the study in the file is continued.
        dask: Address of the scheduler of a Dask cluster that runs the cells instead.

    Returns:
        `path` as a Path, or None.

    Raises:
        InputError: An option is of another type, there are fewer processes than one, or more than one where none can be
            started.
    """
    if jobs is not None:
        require_whole("jobs", jobs, least=1)
    require("force", force, bool, "True or False")
    require("resume", resume, bool, "True or False")
    require("dask", dask, (str, type(None)), "the address of a Dask scheduler")
    if current_process().daemon and dask is None and jobs != 1:
        raise InputError(
            f"jobs: found {jobs or 'one for each core'} in a process that may start no other, such as a worker of Dask "
            "or of a multiprocessing pool, expected jobs=1, which computes in this process"
        )
    return None if path is None else as_path("path", path)


def _describe_argument(value: object) -> str:
    """Describe an argument: an array by its shape, a scalar as it is written, anything else by its type."""
    if value is None or isinstance(value, bool | Real):
        return shortened(str(value))
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype.name}"
    if isinstance(value, Mapping):
        return f"a mapping of {counted(len(value), 'key', 'keys')}"
    if isinstance(value, list | tuple):
        return f"a {type(value).__name__} of {counted(len(value), 'entry', 'entries')}"
    return f"a value of type {type(value).__name__}"
