"""What a file of ours can be made of. Whatever holds, reading it is reading and nothing else.

No link leads out of the file or anywhere but to one object, no data stand elsewhere, no filter needs a plug-in, and
nothing takes much more memory than the file is large.
"""

from collections.abc import Iterator
from math import prod

import h5py
from h5py import h5a, h5d, h5g, h5l, h5o, h5s, h5t, h5z

OF_DIMENSIONS = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid")
"""Attributes in which HDF5 keeps dimension scales; they hold references, which point nowhere in another file."""

ROOM = 2**26
"""Bytes that any file may take in memory, however small it is."""

EXPANSION = 20
"""By how much a file may grow in memory; logs are not compressed but for the plans, and other programs may do that."""

PLAN_EXPANSION = 1000
"""The same for the rows of plans, which are short and stand side by side in a wide array; one is read at a time."""

MOST_OBJECTS, DEEPEST, MOST_ATTRIBUTES, MOST_TEXTS = 20_000, 8, 200, 20_000
"""Objects, levels of groups, attributes of an object, and texts of an array."""

LARGEST_ATTRIBUTE, LARGEST_CHUNK = 2**20, 2**26
"""Bytes."""

PLAIN = (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM)
"""Classes of type; all hold their values themselves."""

FILTERS = (h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32)
"""Filters that HDF5 brings along."""

LINKS = {h5l.TYPE_SOFT: "a soft link", h5l.TYPE_EXTERNAL: "an external link"}


class RefusedError(Exception):
    """A file has what none of ours has; the message is what was found."""


def damaged(error: Exception) -> str:
    """Say in one line that a file cannot be read, and why."""
    reason = (str(error) or type(error).__name__).partition("\n")[0][:200]
    return f"an HDF5 file that is cut off or damaged ({reason})"


def ensure_plain(file: h5py.File, size: int) -> list[tuple[str, h5py.Dataset]]:
    """Return every dataset of a file of so many bytes with its path; nothing of their content is read.

    Raises:
        RefusedError: The file holds what none of ours does.
        OSError, RuntimeError, ValueError, KeyError: It is damaged.
    """
    datasets = list(_datasets(file))
    whole = sum(_in_memory(dataset) for path, dataset in datasets if not _of_plan(path))
    plans = sum(_in_memory(dataset) for path, dataset in datasets if _of_plan(path))
    if whole > ROOM + EXPANSION * size or plans > ROOM + PLAN_EXPANSION * size:
        raise RefusedError(f"arrays of {max(whole, plans):.1e} bytes in a file of {size:.1e}")
    return datasets


def _of_plan(path: str) -> bool:
    return "/plan/" in path


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Give every dataset of a file by its path; no link is followed but to an object in the file itself."""
    root = h5g.open(file.id, b"/")
    _check_attributes("/", root)
    waiting, found = [("", root, 0)], 0
    while waiting:
        above, group, depth = waiting.pop()
        found += group.get_num_objs()  # in a circle of groups both grow
        if depth >= DEEPEST or found > MOST_OBJECTS:
            raise RefusedError(f"more than {MOST_OBJECTS} objects or {DEEPEST} levels of groups")
        for name in group:
            path = f"{above}/{name.decode(errors='replace')}"
            kind = group.links.get_info(name).type
            if kind != h5l.TYPE_HARD:
                raise RefusedError(f"{LINKS.get(kind, 'an unknown link')} at {_short(path)}")
            member = h5o.open(group, name)
            _check_attributes(path, member)
            if isinstance(member, h5g.GroupID):
                waiting.append((path, member, depth + 1))
            elif isinstance(member, h5d.DatasetID):
                _check_dataset(path, member)
                yield path, h5py.Dataset(member)
            else:
                raise RefusedError(f"neither a group nor a dataset at {_short(path)}")


def _check_dataset(path: str, dataset: h5d.DatasetID) -> None:
    """Refuse data that stand elsewhere, need a plug-in or are no plain values."""
    creation, where = dataset.get_create_plist(), _short(path)
    if creation.get_external_count():
        raise RefusedError(f"data in another file at {where}")
    if creation.get_layout() == h5d.VIRTUAL:
        raise RefusedError(f"a virtual dataset at {where}")
    filters = [creation.get_filter(i)[0] for i in range(creation.get_nfilters())]
    if unknown := [number for number in filters if number not in FILTERS]:
        raise RefusedError(f"data behind filter {unknown[0]} at {where}")
    kind = dataset.get_type()
    if kind.get_class() not in PLAIN:
        raise RefusedError(f"neither numbers nor texts at {where}")
    if dataset.get_space().get_simple_extent_type() == h5s.NULL:
        raise RefusedError(f"a dataset without a size at {where}")
    if creation.get_layout() == h5d.CHUNKED and prod(creation.get_chunk()) * kind.get_size() > LARGEST_CHUNK:
        raise RefusedError(f"a chunk of more than {LARGEST_CHUNK} bytes at {where}")
    if varies(dataset) and prod(dataset.shape) > MOST_TEXTS:
        raise RefusedError(f"more than {MOST_TEXTS} texts at {where}")


def varies(dataset: h5d.DatasetID) -> bool:
    """Return whether a dataset holds texts that stand elsewhere in the file, each as long as it is."""
    kind = dataset.get_type()
    return kind.get_class() == h5t.STRING and bool(kind.is_variable_str())


def _check_attributes(path: str, thing: h5g.GroupID | h5d.DatasetID) -> None:
    """Refuse attributes that are many, huge, or no plain values."""
    if h5a.get_num_attrs(thing) > MOST_ATTRIBUTES:
        raise RefusedError(f"more than {MOST_ATTRIBUTES} attributes at {_short(path)}")
    for index in range(h5a.get_num_attrs(thing)):
        attribute = h5a.open(thing, index=index)
        name = attribute.name.decode(errors="replace")
        kind, extent = attribute.get_type(), attribute.get_space()
        if kind.get_class() not in PLAIN and name not in OF_DIMENSIONS:
            raise RefusedError(f"an attribute {_short(name)} that is neither number nor text at {_short(path)}")
        if extent.get_simple_extent_type() == h5s.NULL:
            raise RefusedError(f"an empty attribute {_short(name)} at {_short(path)}")
        if extent.get_simple_extent_npoints() * kind.get_size() > LARGEST_ATTRIBUTE:
            raise RefusedError(f"an attribute {_short(name)} of more than {LARGEST_ATTRIBUTE} bytes at {_short(path)}")


def _in_memory(dataset: h5py.Dataset) -> int:
    """Return how many bytes a dataset takes when all of it is read."""
    return int(prod(dataset.shape) * dataset.id.get_type().get_size())


def _short(text: str) -> str:
    """Write not too much of a name, in one line."""
    return ascii(text[:60])[1:-1]
