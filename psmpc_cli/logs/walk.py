"""One walk over an HDF5 file before anything of it is read: it holds plain values, in itself, and not too many.

HDF5 takes values from other files, which it opens when they are read, and declares lengths that no memory holds. The
walk looks at links, storage, types and lengths alone. The readers compare names, types and shapes with the schema.
"""

from math import prod
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5z

from psmpc_cli.errors import LogError
from psmpc_cli.specs.document import printable, shortened

LINKS = {h5l.TYPE_SOFT: "a soft link", h5l.TYPE_EXTERNAL: "an external link"}

FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
"""Filters of chunks; HDF5 would load others from a folder that the environment names."""

OF_SCALES = ("DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes with which HDF5 ties datasets to their dimension scales by references; nothing here reads them."""

RUNS = "runs"
"""Group of a comparison that holds its runs, and attribute with their names, the only one of a group with several."""

DEEPEST = 4
MOST_OBJECTS = 5_000
MOST_ATTRIBUTES = 15_000
"""Most links from the root, as in /runs/NAME/stages/name; most objects and attributes: those of some fifty runs."""

LARGEST_ATTRIBUTE = 2**16
"""Largest attribute, of texts their references [bytes]: HDF5's own limit, unless a file asks for another."""

LEAST_ALLOWED = 2**26
GROWTH = 16
"""Memory that all values may take [bytes], and how much more for each byte of the file: logs grow to some two."""

TEXT_SIZE = 64
"""Memory that a text takes at least [bytes]."""


def unexpected_item(item: h5py.HLObject, found: str, expected: str, at: str = "") -> LogError:
    """Return the error that an object in an HDF5 file is not as it should be.

    Args:
        item: The object.
        found: What it is, in words.
        expected: What it should be, in words.
        at: What follows its path in the message if the error is in a member or an attribute of it.
    """
    place = printable(shortened(f"{item.name or '/'}{at}"))
    return LogError(f"{item.file.filename}: {place}: found {printable(shortened(found))}, expected {expected}")


def require_harmless(file: h5py.File) -> None:
    """Make sure that an HDF5 file is harmless to read: plain values in the file itself, which memory can hold.

    A file from elsewhere may link to other files, nest groups without end, or declare arrays larger than any memory.
    Only links, types and shapes are looked at, no values.

    Raises:
        LogError: It holds something else.
    """
    memory_limit = LEAST_ALLOWED + GROWTH * file.id.get_filesize()  # [bytes], larger for a larger file
    total_memory = 0
    groups = [(file["/"], 0)]  # those still to be looked at, each with its number of links from the root
    object_count = 0
    attribute_count = 0
    while groups:
        group, depth = groups.pop()
        object_count += len(group)
        if depth >= DEEPEST or object_count > MOST_OBJECTS:
            found = f"a group {depth} links from the root with object {object_count} of the file"
            raise unexpected_item(group, found, f"at most {DEEPEST} links, and {MOST_OBJECTS} objects")
        for name in group.id:
            link = group.id.links.get_info(name).type
            member = _open_member(group, name) if link == h5l.TYPE_HARD else None  # other links may leave the file
            if not isinstance(member, h5py.Group | h5py.Dataset):
                found = "a type" if member is not None else LINKS.get(link, "a link of another program")
                expected = "a dataset or group in the file itself"
                raise unexpected_item(group, found, expected, at=f"/{name.decode(errors='replace')}")
            attribute_count = require_plain_attributes(member, attribute_count)
            if isinstance(member, h5py.Group):
                groups.append((member, depth + 1))
                continue
            total_memory += _memory_of_values(member)
            if total_memory > memory_limit:
                expected = f"at most {memory_limit} in a file of this size"
                raise unexpected_item(member, f"{total_memory} bytes up to here", expected)


def _open_member(group: h5py.Group, name: bytes) -> h5py.HLObject:
    """Open a member of a group faster than h5py does by its name, which asks each time if the file may be written."""
    member = h5o.open(group.id, name)
    if isinstance(member, h5g.GroupID):
        return h5py.Group(member)
    return h5py.Dataset(member) if isinstance(member, h5d.DatasetID) else h5py.Datatype(member)


def _memory_of_values(dataset: h5py.Dataset) -> int:
    """Compute the memory that the values of a dataset take when they are read [bytes], without reading them.

    A text of variable length counts as `TEXT_SIZE`, whatever its real length is. A file may declare chunks (the parts
    in which HDF5 stores and reads a dataset) that are larger than the dataset itself; then these count.

    Raises:
        LogError: The values are in other files, need an unknown filter, or are no plain numbers and texts.
    """
    storage = dataset.id.get_create_plist()  # how HDF5 stores it
    is_virtual = storage.get_layout() == h5d.VIRTUAL
    if is_virtual or storage.get_external_count():  # checked first: the shape may be that of another file
        storage_name = "a virtual dataset" if is_virtual else "external storage"
        raise unexpected_item(dataset, storage_name, "values in the file itself")
    if unknown_filters := {storage.get_filter(number)[0] for number in range(storage.get_nfilters())} - FILTERS:
        raise unexpected_item(dataset, f"filter {min(unknown_filters)}", "deflate, shuffle or Fletcher-32")
    dtype = dataset.dtype
    shape = dataset.shape
    if shape is None or not _is_plain(dtype):
        found = "no values" if shape is None else f"values of type {dtype}"
        raise unexpected_item(dataset, found, "numbers or texts")
    text = h5py.check_string_dtype(dtype)
    # text.length: the declared length of texts of fixed length, None of others
    bytes_of_value = dtype.itemsize if text is None else TEXT_SIZE + 8 * (text.length or 0)
    chunk = storage.get_chunk() if storage.get_layout() == h5d.CHUNKED else ()
    value_count: int = max(prod(shape), prod(chunk))
    return value_count * bytes_of_value


def require_plain_attributes(item: h5py.Group | h5py.Dataset, before: int = 0) -> int:
    """Make sure that the attributes of a group or dataset are plain numbers and texts, and few enough.

    Args:
        item: The group or dataset.
        before: Number of attributes of all objects that were checked before it.

    Returns:
        That number with the attributes of this object.

    Raises:
        LogError: One is something else, or there are too many.
    """
    count: int = before + h5a.get_num_attrs(item.id)
    if count > MOST_ATTRIBUTES:
        raise unexpected_item(item, f"{count} attributes up to here", f"at most {MOST_ATTRIBUTES}")
    is_dataset = isinstance(item, h5py.Dataset)
    for number in range(count - before):
        attribute = h5a.open(item.id, index=number)
        name = attribute.name.decode(errors="replace")
        if name in OF_SCALES and is_dataset:
            continue  # HDF5's own references between datasets, which nothing here reads
        dtype = attribute.dtype
        shape = attribute.shape
        # a dataset may have several values in an attribute; of groups only a comparison has, the names of its runs
        is_array = shape and not is_dataset and name != RUNS
        if shape is None or is_array or not _is_plain(dtype) or prod(shape) * dtype.itemsize > LARGEST_ATTRIBUTE:
            found = "no value" if shape is None else f"values of type {dtype} with shape {shape}"
            raise unexpected_item(item, found, "a number or a text", at=f" attribute {name}")
    return count


def _is_plain(dtype: np.dtype[Any]) -> bool:
    """Return whether values of a NumPy type are real numbers of at most 8 bytes, or texts."""
    return h5py.check_string_dtype(dtype) is not None or (dtype.kind in "iufb" and dtype.itemsize <= 8)
