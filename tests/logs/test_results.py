"""Results files of studies."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.files import FileLock
from psmpc_cli.logs.results import Quantity, new_results, read_results
from psmpc_cli.logs.schema import PARETO, SWEEP

QUANTITIES = (
    Quantity("start", ("row", "column"), np.full((2, 3), np.nan), "s", "actual start"),
    Quantity("row", ("row",), np.array([10.0, 20.0]), "1", "number of the row"),
    Quantity("column", ("column",), np.array(["a", "b", "ü"]), "1", "name of the column"),
    Quantity("status", ("row", "column"), np.zeros((2, 3), "i4"), "1", "status", ("waiting", "done")),
    Quantity("reason", ("row", "column"), np.full((2, 3), ""), "1", "why"),
    Quantity("spent", (), np.array(0.0), "s", "time spent"),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "results.h5"
    new_results(path, SWEEP, {"task_name": "test"}, QUANTITIES).create()
    return path


def test_what_was_written_is_read_back_with_names_units_and_meanings(path: Path) -> None:
    results = read_results(path, SWEEP)
    assert results.attributes["task_name"] == "test"
    for quantity in QUANTITIES:
        found = results.quantities[quantity.name]
        assert (found.dims, found.units, found.long_name, found.meanings) == (
            quantity.dims,
            quantity.units,
            quantity.long_name,
            quantity.meanings,
        )
        np.testing.assert_array_equal(found.values, quantity.values)


def test_what_is_filled_in_and_saved_is_in_the_file_and_no_more(path: Path) -> None:
    results, reason = read_results(path, SWEEP), np.full((2, 3), "", object)
    results["start"][1, 2], results["status"][1, 2], reason[1, 2] = 6.1, 1, "because of ü" * 100
    results["spent"][()] = 3.5
    about = {**results.quantities, "reason": replace(results.quantities["reason"], values=reason)}
    with FileLock(path) as lock:
        replace(results, quantities=about).save(lock)
    found = read_results(path, SWEEP)
    assert found["start"][1, 2] == 6.1
    assert found["reason"][1, 2] == reason[1, 2]
    assert found["spent"] == 3.5
    assert np.count_nonzero(found["status"]) == 1
    assert np.isnan(found["start"]).sum() == 5


def test_an_existing_file_is_not_overwritten_unasked(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        new_results(path, SWEEP, {}, QUANTITIES).create()
    assert path.read_bytes() == before
    new_results(path, SWEEP, {"task_name": "other"}, QUANTITIES).create(force=True)
    assert read_results(path, SWEEP).attributes["task_name"] == "other"


def test_a_file_of_another_kind_is_refused(path: Path) -> None:
    with pytest.raises(LogError, match="found a sweep, expected a pareto"):
        read_results(path, PARETO)


def test_a_cut_off_file_is_refused(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(LogError, match="cut off or damaged"):
        read_results(path, SWEEP)


def test_a_flipped_byte_is_noticed(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[content.index(np.array([10.0, 20.0]).tobytes())] ^= 1
    path.write_bytes(content)
    with pytest.raises(LogError, match="cut off or damaged"):
        read_results(path, SWEEP)


@pytest.mark.parametrize(("name", "values"), [("start", np.zeros((2, 2))), ("status", np.full((2, 3), 7))])
def test_an_array_that_does_not_fit_is_rejected(path: Path, name: str, values: np.ndarray) -> None:
    with h5py.File(path, "r+") as file:
        attributes = dict(file[name].attrs)
        del file[name]
        file[name] = values
        file[name].attrs.update({key: value for key, value in attributes.items() if key != "DIMENSION_LIST"})
    with pytest.raises(LogError, match=name):
        read_results(path, SWEEP)


def test_dimension_scales_name_every_dimension(path: Path) -> None:
    with h5py.File(path) as file:
        assert [dimension[0].name for dimension in file["start"].dims] == ["/row", "/column"]


def test_xarray_opens_it_with_named_coordinates(path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xarray.open_dataset(path, engine="h5netcdf") as dataset:
        assert dataset["start"].dims == ("row", "column")
        assert dataset["start"].sel(row=20.0, column="ü").size == 1
        assert dataset["start"].attrs["units"] == "s"
