"""Changes of HDF5 files by HDF5's own means, drawn at random: links, storage, shapes, types, attributes, sizes."""

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5p, h5s, h5t, h5z

Edit = Callable[[h5py.File, str, Random, Path], None]
"""Changes the dataset of this name; in the folder lie the secrets."""

SECRETS = ("secret.bin", "secret.h5")
"""Files that no changed file may show."""

SECRET = b"MARKED7!"
"""What they hold: eight bytes, which are a double too."""

OF_SCALES = ("DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes that tie datasets to their scales."""

KINDS: tuple[Any, ...] = (
    *("i8", "u1", "f4", "f2", ">f8", "c16", "S8", "?", "longdouble", "V12", h5py.string_dtype(), h5py.ref_dtype),
    *(h5py.regionref_dtype, h5py.vlen_dtype("f8"), h5py.enum_dtype({"a": 1, "b": 2}), [("a", "f8"), ("b", "i4")]),
    *((("f8", (3,)), h5py.opaque_dtype("M8[s]"))),
)
"""Types of values."""

SHAPES: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda values: values[..., None],
    lambda values: values[:-1] if values.ndim else values[None],
    lambda values: np.concatenate([values] * 2) if values.ndim else np.resize(values, (3, 3)),
    lambda values: values.T if values.ndim > 1 else values.ravel()[:1],
    lambda values: values.ravel()[:0],
    lambda values: np.resize(values, ()),
    lambda values: np.resize(values, (1,) * 20),
)
"""Other shapes of the same values."""


def plant_secrets(folder: Path) -> None:
    """Write the secrets into a new folder."""
    folder.mkdir()
    (folder / "secret.bin").write_bytes(SECRET * 100_000)
    with h5py.File(folder / "secret.h5", "w") as file:
        file["x"] = np.frombuffer(SECRET * 100_000)


def shows_secret(text: bytes) -> bool:
    """Return whether a text holds the secret, as text or as a number."""
    return SECRET in text or repr(float(np.frombuffer(SECRET)[0]))[:8].encode() in text


def edit(path: Path, random: Random, folder: Path) -> str:
    """Change a file once or twice, and return what was changed."""
    done = []
    for _ in range(random.choice([1, 1, 2])):
        with h5py.File(path, "r+") as file:
            name, change = random.choice(_datasets(file) or ["nothing"]), random.choice(EDITS)
            try:
                change(file, name, random, folder)
                done.append(f"{change.__name__} {name}")
            except (TypeError, ValueError, OSError, KeyError, RuntimeError, OverflowError) as error:
                done.append(f"{change.__name__} {name}, as far as HDF5 does it: {error}")  # what is left is a file too
    return "; ".join(done)


def _datasets(file: h5py.File) -> list[str]:
    """Return the names of the datasets whose values can be read without opening another file."""
    names: list[str] = []

    def visit(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset) and not item.is_virtual and item.external is None:
            names.append(name)

    file.visititems(visit)
    return names


def _attributes(item: h5py.HLObject) -> dict[str, Any]:
    return {key: item.attrs[key] for key in item.attrs if key not in OF_SCALES}


def _replace(file: h5py.File, name: str, **how: Any) -> None:
    """Create a dataset in place of another, with its attributes."""
    attributes = _attributes(file[name])
    del file[name]
    file.create_dataset(name, **how).attrs.update(attributes)


def _link(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    soft = h5py.SoftLink(random.choice(["/time", "/nowhere", f"/{name}"]))
    hard = file[random.choice(["/", *file])]
    target = random.choice([soft, hard, h5py.ExternalLink(str(folder / "secret.h5"), "/x")])
    del file[name]
    file[name] = target


def _close_cycle(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    random.choice([file, file[name].parent])["loop"] = file


def _store_outside(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    kind = file[name].dtype if file[name].dtype.kind in "iufS" else "S16"
    outside = [(str(folder / "secret.bin"), 0, h5s.UNLIMITED)]
    _replace(file, name, shape=file[name].shape, dtype=kind, external=outside)


def _make_virtual(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    shape, attributes = file[name].shape or (1,), _attributes(file[name])
    values = h5py.VirtualLayout(shape, file[name].dtype if file[name].dtype.kind in "iuf" else "f8")
    values[...] = h5py.VirtualSource(folder / "secret.h5", "x", shape)
    del file[name]
    file.create_virtual_dataset(name, values).attrs.update(attributes)


def _filter(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    storage = h5p.create(h5p.DATASET_CREATE)
    storage.set_chunk((10,))
    storage.set_filter(32_100, h5z.FLAG_OPTIONAL, (1,))
    del file[name]
    h5d.create(file.id, name.encode(), h5t.IEEE_F64LE, h5s.create_simple((10,)), storage)


def _leave_sparse(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    beside = [1] * (len(file[name].shape) - 1)
    length = random.choice([10**5, 10**8, 10**9, 2**62])
    kind = random.choice(["f8", h5py.string_dtype(), "S100"])
    _replace(file, name, shape=(length, *beside), dtype=kind, chunks=(1000, *beside))


def _enlarge_chunks(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    _replace(file, name, shape=(10,), maxshape=(None,), dtype="f8", chunks=(10**8,), compression="gzip")


def _reshape(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    values = random.choice(SHAPES)(np.asarray(file[name][()]))
    _replace(file, name, data=values, dtype=file[name].dtype)


def _retype(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    _replace(file, name, shape=file[name].shape, dtype=random.choice(KINDS))


def _set_values(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    dataset = file[name]
    if dataset.dtype.kind in "fiu" and dataset.size:
        worst = [0, -1, 100, 127] if dataset.dtype.kind in "iu" else [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300]
        place = tuple(random.randrange(length) for length in dataset.shape) if random.random() < 0.5 else ...
        dataset[place] = random.choice(worst)


def _set_attribute(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    item = file[random.choice([name, *(place for place in ("/", "/runs/one") if place in file)])]
    key = random.choice([*_attributes(item), "other"])
    if key in item.attrs:
        del item.attrs[key]
    match random.randrange(7):
        case 1:
            item.attrs[key] = random.choice(
                [b"\xff\xfe", np.zeros(5), np.nan, np.inf, -1, "", "a" * 60_000, ["a", "b"]]
            )
        case 2:
            item.attrs[key] = h5py.Empty(random.choice(["f8", h5py.string_dtype()]))
        case 3:
            item.attrs.create(key, random.choice([file.ref, [file.ref] * 3]), dtype=h5py.ref_dtype)
        case 4:
            item.attrs.create(key, np.zeros(random.choice([(), 1000, 8000]), random.choice(["f8", "c16", "f8,i4"])))
        case 5:
            item.attrs.create(key, random.choice(["\udcff", "robot: [" * 100, "\x1b[2J"]))
        case 6:
            item.attrs.update({f"{key}{number}": number for number in range(random.choice([5, 300]))})


def _replace_kind(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    file.attrs["kind"] = random.choice(["run", "comparison", "sweep", "pareto", "monte-carlo", "x" * 999])


def _put_other_object(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    del file[name]
    other = random.choice([np.dtype("f8"), h5py.Empty("f8"), None])
    if other is None:
        file.create_group(name)
    else:
        file[name] = other


def _delete(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    parts = name.split("/")
    del file["/".join(parts[: random.randint(1, len(parts))])]


def _add(file: h5py.File, name: str, random: Random, folder: Path) -> None:
    for number in range(random.choice([1, 6000])):
        file[f"{name}_{number}"] = h5py.SoftLink("/")


EDITS: tuple[Edit, ...] = (
    *(_link, _link, _close_cycle, _store_outside, _make_virtual, _filter, _leave_sparse, _enlarge_chunks, _reshape),
    *(_reshape, _retype, _retype, _set_values, _set_attribute, _set_attribute, _set_attribute, _replace_kind),
    *(_put_other_object, _delete, _delete, _add),
)
"""Changes of a dataset, of its attributes, or of those of the file."""
