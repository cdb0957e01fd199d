"""The schema of a log."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.figures.coordinates import plot_errors, plot_forces, plot_states
from psmpc_cli.logs.numbers import format_number
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import SCHEMA
from psmpc_cli.report.texts import measure_rows
from psmpc_cli.report.view import view
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

from ..sliding_arm import ROBOT, sliding_task


def test_every_dimension_has_its_scale() -> None:
    scales = {column.path for column in SCHEMA if column.is_scale} | {f"{c.path}_element" for c in SCHEMA if c.ragged}
    assert {dim for column in SCHEMA for dim in column.dims} == scales
    assert len({column.path for column in SCHEMA}) == len(SCHEMA)


@pytest.fixture(scope="module")
def sliding(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run of an arm whose first joint turns and whose second one slides."""
    folder = tmp_path_factory.mktemp("sliding")
    (folder / "slider.yaml").write_text(ROBOT)
    plant = {"kind": "rk4", "low_level_rate": 100}
    more = {"solver": {"kind": "sqp", "compiled": False}, "plant": plant, "time_limit": 0.5}
    return simulate(load_task(sliding_task(str(folder / "slider.yaml"), **more)), folder / "log.h5")


OF_BASE = {
    "state/Q": ["m"] * 3 + ["1"] * 4,
    "state/Qdot": ["m/s"] * 3 + ["rad/s"] * 3,
    "control/u": ["m/s^2"] * 3 + ["rad/s^2"] * 3,
    "force/F": ["N"] * 3 + ["N m"] * 3,
}
OF_ARM = {
    "state/Q": ["rad", "m"],
    "state/Qdot": ["rad/s", "m/s"],
    "control/u": ["rad/s^2", "m/s^2"],
    "force/F": ["N m", "N"],
}


@pytest.mark.parametrize("path", OF_ARM)
def test_columns_have_the_units_of_their_coordinates(sliding: Run, path: str, tmp_path: Path) -> None:
    """In the file, in a copy of it, in tables and in xarray."""
    units = [*OF_BASE[path], *OF_ARM[path]]
    sliding.save(tmp_path / "copy.h5")
    for log in (sliding.path, tmp_path / "copy.h5"):
        with h5py.File(log) as file:
            assert list(file[path].attrs["column_units"]) == units
            assert "column_units" not in file["window/instants"].attrs
    assert list(sliding.to_xarray()[path].attrs["column_units"]) == units
    heading = sliding.to_csv(tmp_path)[0].read_text().split(",")
    found = [name.partition("[")[2].rstrip("]") or "1" for name in heading if name.startswith(f"{path}/")]
    assert found == units


def test_joints_that_slide_have_peaks_of_their_own(sliding: Run) -> None:
    assert sliding["peak/sliding_force"].max() == pytest.approx(np.abs(sliding["force/F"][:, 7]).max(), rel=0.3)
    assert sliding["peak/joint_torque"].max() == pytest.approx(np.abs(sliding["force/F"][:, 6]).max(), rel=0.3)
    summary = sliding.summary()
    assert {limit.coordinate: limit.unit for limit in summary.limits} == {"arm.2": "m", "arm.1": "rad/s"}
    rows = dict(measure_rows(summary))
    assert rows["largest force, acceleration of a sliding joint"].startswith(
        f"{format_number(summary.peaks['sliding_force'])} N / "
    )


def test_figures_and_pages_draw_what_slides_apart_from_what_turns(sliding: Run, tmp_path: Path) -> None:
    labels = [" ".join(axes.get_ylabel().split()) for axes in plot_states(sliding).axes]
    assert labels[-2:] == ["Arm angle (rad)", "Arm position (m)"]
    labels = [" ".join(axes.get_ylabel().split()) for axes in plot_forces(sliding).axes]
    assert labels[-2:] == ["Arm torque (N m)", "Arm force (N)"]
    labels = [" ".join(axes.get_ylabel().split()) for axes in plot_errors(sliding).axes]
    assert labels[-2:] == ["Position error (m)", "Angle error (rad)"]
    page = view(sliding).save(tmp_path / "page.html").read_text(encoding="utf-8")
    for label in ("arm (rad)", "arm (m)", "arm (N m)", "arm (N)", "arm (rad/s)", "arm (m/s)"):
        assert f'"{label}"' in page
