from pathlib import Path

import h5py
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.studies.sampling import grid_sampling
from psmpc_cli.studies.sweep import load_sweep_task
from psmpc_cli.studies.sweep_file import CELL_QUANTITIES, Sweep, create_sweep, resume_sweep

PAGE = Path(__file__).parents[2] / "docs" / "sweeps.md"


def test_the_page_has_every_quantity_of_a_cell() -> None:
    _, begun, rest = PAGE.read_text(encoding="utf-8").partition(
        "<!-- cells -->\n| array | units | what |\n|---|---|---|\n"
    )
    found, ended, _ = rest.partition("<!-- end of cells -->")
    assert begun
    assert ended
    quantities = ((f"`{quantity.name}`", quantity.units, quantity.long_name) for quantity in CELL_QUANTITIES)
    assert found == "".join(f"| {' | '.join(row)} |\n" for row in quantities)


def test_the_sweep_of_another_version_is_not_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "sweep.h5"
    sweep = Sweep(load_sweep_task("approach_capture", (), ()), (0, 1), grid_sampling("2x2", (0.1, 10.0)), False)
    create_sweep(path, sweep, force=False)
    resume_sweep(path, sweep)
    with h5py.File(path, "r+") as file:
        file.attrs["psmpc_version"] = "0.0.1"
    with pytest.raises(InputError, match=r"holds another sweep: found psmpc version 0\.0\.1, this one has "):
        resume_sweep(path, sweep)
