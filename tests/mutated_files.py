"""HDF5 files made wrong at random, for tests and for `benchmarks/fuzz.py`."""

import re
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

import h5py
import numpy as np

from .mutated_text import VALUES

SIGNATURES = re.compile(rb"\x89HDF|TREE|SNOD|HEAP|GCOL|OHDR|FRHP|BTHD")
"""How HDF5's own structures begin."""


def mutated_bytes(content: bytes, random: Random) -> bytes:
    """Return the bytes of a file cut off, flipped, overwritten, moved or repeated."""
    kind = random.randrange(8)
    if kind == 0:
        return content[: random.randrange(len(content))]
    changed = bytearray(content)
    if kind == 1:
        at, length = random.randrange(len(content)), random.choice([1, 8, 64, 512, 4096])
        changed[at : at + length] = random.choice([b"\x00", b"\xff", random.randbytes(1)]) * length
    elif kind == 2:
        at, length = random.randrange(len(content)), random.choice([1, 8, 64, 4096])
        del changed[at : at + length]
    elif kind == 3:
        at, other, length = random.randrange(len(content)), random.randrange(len(content)), random.choice([8, 64, 512])
        changed[at : at + length] = content[other : other + length]
    else:
        for _ in range(random.choice([1, 1, 2, 8, 64])):
            changed[_place(content, random)] ^= 1 << random.randrange(8)
    return bytes(changed)


def mutated_file(path: Path, random: Random) -> None:
    """Change an HDF5 file by HDF5's own means into one that a stranger could have made."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        random.choice(_OF_FILE)(file, random.choice(names), random)


def _place(content: bytes, random: Random) -> int:
    """Return where a bit is flipped: anywhere, or in a structure of HDF5's own."""
    if random.random() < 0.5:
        return random.randrange(len(content))
    starts = [match.start() for match in SIGNATURES.finditer(content)] or [0]
    return min(random.choice(starts) + random.randrange(600), len(content) - 1)


def _remove(file: h5py.File, name: str, random: Random) -> None:
    del file[name]


def _put(file: h5py.File, name: str, value: object) -> None:
    del file[name]
    file[name] = value


def _soft_link(file: h5py.File, name: str, random: Random) -> None:
    _put(file, name, h5py.SoftLink(random.choice(["/time", "/", "/nowhere", f"/{name}"])))


def _external_link(file: h5py.File, name: str, random: Random) -> None:
    _put(file, name, h5py.ExternalLink(random.choice(["other.h5", "/dev/zero", "pipe", "../x.h5"]), f"/{name}"))


def _hard_circle(file: h5py.File, name: str, random: Random) -> None:
    _put(file, name, random.choice([file["/"], file[name].parent]))


def _group(file: h5py.File, name: str, random: Random) -> None:
    del file[name]
    file.create_group(name)


def _elsewhere(file: h5py.File, name: str, random: Random) -> None:
    shape = file[name].shape
    del file[name]
    file.create_dataset(name, shape, "f8", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])


def _virtual(file: h5py.File, name: str, random: Random) -> None:
    del file[name]
    layout = h5py.VirtualLayout((5,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", (5,))
    file.create_virtual_dataset(name, layout)


def _huge(file: h5py.File, name: str, random: Random) -> None:
    """Declare far more than there is."""
    old, size = file[name], 10 ** random.choice([7, 9, 12, 15])
    shape, dtype = (size, *old.shape[1:]), old.dtype
    del file[name]
    chunks = random.choice([(1,), (2**20,)]) + shape[1:]
    file.create_dataset(name, shape, dtype, maxshape=(None, *shape[1:]), chunks=chunks, compression="gzip")


def _bomb(file: h5py.File, name: str, random: Random) -> None:
    """Put much into little."""
    del file[name]
    dataset = file.create_dataset(name, (100 * 2**17,), "f8", chunks=(2**17,), compression="gzip")
    chunk = zlib.compress(bytes(2**20), 9)
    for first in range(0, len(dataset), 2**17):
        dataset.id.write_direct_chunk((first,), chunk)


def _other_filter(file: h5py.File, name: str, random: Random) -> None:
    del file[name]
    file.create_dataset(name, data=np.zeros(20), chunks=(10,), compression="lzf")


def _other_type(file: h5py.File, name: str, random: Random) -> None:
    kinds = [
        np.zeros(3, "i8"),
        np.zeros(3, "f4"),
        "text",
        b"bytes",
        ["a", "b"],
        np.zeros(3, [("a", "f8")]),
        1j,
        h5py.Empty("f"),
    ]
    _put(file, name, random.choice(kinds))


def _reference(file: h5py.File, name: str, random: Random) -> None:
    _put(file, name, np.array([file.ref] * 3, h5py.ref_dtype))


def _other_shape(file: h5py.File, name: str, random: Random) -> None:
    values = file[name][()]
    _put(
        file,
        name,
        random.choice([values[..., None], np.asarray(values).ravel()[:1], values[:0] if np.ndim(values) else 0]),
    )


def _other_numbers(file: h5py.File, name: str, random: Random) -> None:
    dataset = file[name]
    if dataset.dtype.kind in "fi" and dataset.size:
        worst = random.choice([np.nan, np.inf, -np.inf, 1e308, -1e300, 1e50, -1.0, 0.0])
        dataset[...] = worst if dataset.dtype.kind == "f" else random.choice([-1, 0, 100])


def _attribute(file: h5py.File, name: str, random: Random) -> None:
    """Change an attribute of the file or of a dataset."""
    where = random.choice([file, file, file[name]])
    key = random.choice(sorted(set(where.attrs) - {"DIMENSION_LIST", "REFERENCE_LIST"}) or ["new"])
    worst = [
        *VALUES[:40],
        1,
        -1,
        np.nan,
        np.zeros(5),
        b"\xff\xfe",
        [1, 2],
        h5py.Empty("f"),
        file.ref,
        np.zeros((50, 50)),
    ]
    value = random.choice(worst)
    where.attrs[key] = value.replace("\x00", "") if isinstance(value, str) else value


def _no_attribute(file: h5py.File, name: str, random: Random) -> None:
    where = random.choice([file, file[name]])
    if len(where.attrs):
        del where.attrs[random.choice(list(where.attrs))]


def _long_text(file: h5py.File, name: str, random: Random) -> None:
    _put(file, name, np.array(["x" * 10**7, "y"], h5py.string_dtype()))


def _unknown(file: h5py.File, name: str, random: Random) -> None:
    file.create_dataset(random.choice(["zz", "stages/zz", "a" * 3000, "\u2028", "runs/zz"]), data=1.0)


_OF_FILE: tuple[Callable[[h5py.File, str, Random], None], ...] = (
    *(_remove, _soft_link, _external_link, _hard_circle, _group, _elsewhere, _virtual, _huge, _bomb, _other_filter),
    *(_other_type, _reference, _other_shape, _other_numbers, _attribute, _no_attribute, _long_text, _unknown),
)
