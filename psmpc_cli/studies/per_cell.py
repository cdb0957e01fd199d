"""What every cell of a study leaves behind: arrays that are filled in cell by cell, and the study they belong to."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.other_task import difference

Identity = Mapping[str, str | int | float]
"""What two studies must have in common for one to go on where the other stopped, by its name for a user."""


@dataclass(frozen=True)
class PerCell:
    """A quantity with a value in every cell, or one for each entry of a further coordinate."""

    name: str
    units: str
    long_name: str
    along: str = ""
    whole: bool = False


def unfilled(
    quantities: Iterable[PerCell], dims: tuple[str, ...], shape: tuple[int, ...], along: Mapping[str, int]
) -> Iterator[Quantity]:
    """Give the arrays of quantities with nothing in them: NaN, or -1 in arrays of whole numbers.

    Args:
        quantities: What is filled in.
        dims: Names of the dimensions along which the cells stand.
        shape: Sizes of these.
        along: Sizes of the further coordinates.
    """
    for quantity in quantities:
        extra = (quantity.along,) if quantity.along else ()
        size = (*shape, *(along[name] for name in extra))
        values = np.full(size, -1, "i4") if quantity.whole else np.full(size, np.nan)
        yield Quantity(quantity.name, (*dims, *extra), values, quantity.units, quantity.long_name)


def ensure_same(results: Results, identity: Identity, task: Task, study: str) -> None:
    """Make sure that a file holds this study.

    Raises:
        InputError: It holds another one; the message says in what it differs.
    """
    for name, wanted in identity.items():
        found = results.attributes.get(name)
        if found != wanted:
            plainly = f"found {name.replace('_', ' ')} {found}, this one has {wanted}"
            differs = difference(results, task) if name == "digest" else plainly
            raise InputError(
                f"--resume: {results.path} holds another {study}: {differs}; give the same task and options, or choose "
                "another file with -o"
            )
