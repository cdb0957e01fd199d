"""One walk over an HDF5 file before anything of it is read: it holds plain values, in itself, and not too many.

HDF5 finds values in other files, which it opens when they are read, and declares lengths that no memory holds. The walk
looks at links, storage, types and lengths alone. Which names, types and shapes a file has is in the schema, with which
the readers compare it.
"""

from math import prod
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5z

from psmpc_cli.errors import LogError
from psmpc_cli.specs.document import printable, shortened

FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
"""Filters of chunks; others may be loaded from a library that is named in the environment."""

RUNS = "runs"
"""Group of a comparison that holds its runs, and attribute with their names, the only one with several values."""

OF_SCALES = ("DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes with which HDF5 ties datasets to their dimension scales by references; nothing here reads them."""

DEEPEST = 4
"""Most links from the root to a dataset, such as /runs/NAME/stages/name."""

MOST_OBJECTS, MOST_ATTRIBUTES = 5_000, 100
"""Most objects in a file, some fifty runs; and most attributes of one of them."""

LARGEST_ATTRIBUTE = 2**16
"""Largest attribute without its texts [bytes]: HDF5's own limit, unless a file asks for another."""

PLAIN_SIZE, GROWTH = 2**26, 16
"""Most memory for all values [bytes]: so much, and so many bytes for each one of the file.

Logs have up to two bytes for each one of the file; plans of very different lengths are compressed further.
"""

TEXT_SIZE = 64
"""Memory that a text takes at least [bytes]."""


def misfit(item: h5py.HLObject, found: str, expected: str, member: str = "") -> LogError:
    """Return the error of an object, an attribute or a link that is not as it should be."""
    place = printable(shortened(f"{item.name or '/'}{member}"))
    return LogError(f"{item.file.filename}: {place}: found {printable(shortened(found))}, expected {expected}")


def walk(file: h5py.File) -> None:
    """Make sure that a file holds nothing but groups and datasets of plain values, in itself, which memory holds.

    Raises:
        LogError: It holds something else.
    """
    allowed = PLAIN_SIZE + GROWTH * file.id.get_filesize()
    groups, depth, objects, size = [file["/"]], 0, 0, 0
    while groups:
        if depth > DEEPEST:
            raise misfit(groups[0], "a group", f"datasets, at most {DEEPEST} links from the root")
        below: list[h5py.Group] = []
        for group in groups:
            objects += len(group)
            if objects > MOST_OBJECTS:
                raise misfit(group, f"{objects} objects or more in the file", f"at most {MOST_OBJECTS}")
            for name in group:
                member = _member(group, name)
                check_attributes(member)
                if isinstance(member, h5py.Group):
                    below.append(member)
                    continue
                size += _memory(member)
                if size > allowed:
                    raise misfit(member, f"{size} bytes up to here", f"at most {allowed} in a file of this size")
        groups, depth = below, depth + 1


def _member(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    """Open a member of a group, which is a hard link to a group or a dataset."""
    inside = f"{'' if group.name == '/' else '/'}{name}"
    try:
        link = group.get(name, getlink=True)
    except TypeError:
        raise misfit(group, "a link of another program", "what the file itself holds", inside) from None
    if not isinstance(link, h5py.HardLink):
        kind = "an external link" if isinstance(link, h5py.ExternalLink) else "a soft link"
        raise misfit(group, kind, "what the file itself holds", inside)
    member = group[name]
    if not isinstance(member, h5py.Group | h5py.Dataset):
        raise misfit(group, "a type", "a dataset or a group", inside)
    return member


def _memory(dataset: h5py.Dataset) -> int:
    """Return the memory that the values of a dataset take [bytes], texts without their length.

    Raises:
        LogError: They are in other files, or are no plain numbers and texts.
    """
    storage = dataset.id.get_create_plist()
    if dataset.is_virtual or storage.get_external_count():  # before anything opens those files
        kind = "a virtual dataset" if dataset.is_virtual else "external storage"
        raise misfit(dataset, kind, "values in the file itself")
    filters = {storage.get_filter(number)[0] for number in range(storage.get_nfilters())}
    if not filters <= FILTERS:
        raise misfit(dataset, f"filter {min(filters - FILTERS)}", "deflate, shuffle or Fletcher-32")
    if not _is_plain(dataset.dtype) or dataset.shape is None:
        found = "no values" if dataset.shape is None else f"values of type {dataset.dtype}"
        raise misfit(dataset, found, "numbers or texts")
    text = h5py.check_string_dtype(dataset.dtype)
    each = dataset.dtype.itemsize if text is None else TEXT_SIZE + 8 * (text.length or 0)
    values: int = max(prod(dataset.shape), prod(dataset.chunks or ()))
    return values * each


def check_attributes(item: h5py.Group | h5py.Dataset) -> None:
    """Make sure that the attributes of an object are plain numbers and texts, those of a group one alone.

    Raises:
        LogError: One is something else.
    """
    if h5a.get_num_attrs(item.id) > MOST_ATTRIBUTES:
        raise misfit(item, f"{h5a.get_num_attrs(item.id)} attributes", f"at most {MOST_ATTRIBUTES}")
    for name in item.attrs:
        if name in OF_SCALES and isinstance(item, h5py.Dataset):
            continue
        attribute = item.attrs.get_id(name)
        kind, shape = attribute.dtype, attribute.shape
        if shape is None or not _is_plain(kind) or (shape and isinstance(item, h5py.Group) and name != RUNS):
            found = f"{'no' if shape is None else 'x'.join(map(str, shape)) or 'a'} value of type {kind}"
            raise misfit(item, found, "a number or a text", f" attribute {name}")
        if (size := prod(shape) * kind.itemsize) > LARGEST_ATTRIBUTE:
            raise misfit(item, f"{size} bytes", f"at most {LARGEST_ATTRIBUTE}", f" attribute {name}")


def _is_plain(kind: np.dtype[Any]) -> bool:
    """Return whether values of a NumPy type are real numbers of at most 8 bytes, or texts."""
    return h5py.check_string_dtype(kind) is not None or (kind.kind in "iufb" and kind.itemsize <= 8)
