"""The file of a sweep: what is in it, and how a sweep goes on that was stopped."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results, create_results, read_results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.per_cell import Identity, PerCell, ensure_same, unfilled
from psmpc_cli.studies.sampling import Sampling

WAITING, COMPUTED, SHARED, FAILED = range(4)
STATUS = ("waiting", "computed", "shared", "failed")
"""Codes of a cell's status and what they mean."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep as it was asked for.

    Attributes:
        task: The task; the priorities of the studied stages vary.
        stages: The two studied stages, by index, the second right after the first.
        sampling: The priorities they have in each cell.
        every_cell: Compute every cell from its beginning, nothing shared.
    """

    task: Task
    stages: tuple[int, int]
    sampling: Sampling
    every_cell: bool

    @property
    def identity(self) -> Identity:
        """What two sweeps must have in common for one to go on where the other stopped, by its name for a user."""
        low, high = self.sampling.omega.min(), self.sampling.omega.max()
        return {
            "psmpc_version": __version__,
            "digest": self.task.digest,
            "stages": ",".join(str(stage + 1) for stage in self.stages),
            "sampling": self.sampling.label,
            "range": f"{low:.6g} to {high:.6g}",
            "every_cell": int(self.every_cell),
        }


CELL_QUANTITIES = (
    PerCell("detection_time", "s", "first sample with the switch in the window"),
    PerCell("instant_at_detection", "s", "optimized switching instant at that sample"),
    PerCell("switch_time", "s", "instant that ended each stage", "stage"),
    PerCell("actual_start", "s", "actual start of the second stage", "epsilon"),
    PerCell("completion_time", "s", "instant that ended the second stage"),
    PerCell("stage_cost", "s", "integral of the cost Lbar of each stage while it was the current one", "stage"),
    PerCell("final_error", "1", "largest error of the second stage's end condition at its end, over its tolerance"),
    PerCell("control_effort", "m^2/s^3, rad^2/s^3", "integral of |u|^2"),
    PerCell("base_force", "N s", "integral of the norm of the base force"),
    PerCell("base_torque", "N m s", "integral of the magnitude of the base torque"),
    PerCell("variation_base_position", "m/s^2", "total variation of the base's linear acceleration"),
    PerCell("variation_base_angle", "rad/s^2", "total variation of the base's angular acceleration"),
    PerCell("variation_joints", "rad/s^2", "total variation of the joints' acceleration"),
    PerCell("solves", "1", "number of solves", whole=True),
    PerCell("iterations_median", "1", "median of the iterations of a solve"),
    PerCell("iterations_largest", "1", "largest number of iterations of a solve", whole=True),
    PerCell("solve_time_median", "s", "median wall time of a solve"),
    PerCell("solve_time_largest", "s", "longest wall time of a solve"),
    PerCell("appended", "1", "stages that entered the window", whole=True),
    PerCell("postponed", "1", "samples at which a stage was seen, but the window with it had no solution", whole=True),
    PerCell("fallbacks", "1", "failed solves after which the shifted plan went on", whole=True),
    PerCell(
        "basin_changes", "1", "windows in which another guess of the instants than the last plan's won", whole=True
    ),
)
"""What every cell leaves behind."""


def create_sweep(path: Path, sweep: Sweep, force: bool) -> None:
    """Write the file of a sweep with all cells waiting.

    Raises:
        InputError: The file exists already or cannot be written.
    """
    task = sweep.task.spec
    attributes = {
        **sweep.identity,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "task_name": task.name,
        "first_stage": task.stages[sweep.stages[0]].name,
        "second_stage": task.stages[sweep.stages[1]].name,
        "horizon": task.controller.horizon,
        "sample_time": task.controller.sample_time,
        "nodes": task.controller.nodes,
        "onset": task.onset.kind,
        "task_yaml": sweep.task.task_yaml,
        "robot_yaml": sweep.task.robot_yaml,
    }
    create_results(path, SWEEP, attributes, [*_coordinates(sweep), *_quantities(sweep)], force)


def _coordinates(sweep: Sweep) -> list[Quantity]:
    """Return the coordinates along every dimension, and the priorities of the cells."""
    task, omega, ratio = sweep.task.spec, sweep.sampling.omega, sweep.sampling.ratio
    first, second = (f"priority of {task.stages[stage].name}" for stage in sweep.stages)
    dims, over = dimensions(sweep.sampling), "omega_2 / omega_1"
    if sweep.sampling.kind == "grid":
        cells = omega.reshape(*sweep.sampling.shape, 2)
        along = [
            Quantity("omega_2", ("omega_2",), cells[:, 0, 1], "1", second),
            Quantity("omega_1", ("omega_1",), cells[0, :, 0], "1", first),
            Quantity("ratio", dims, ratio.reshape(sweep.sampling.shape), "1", over),
        ]
    else:
        axis = ratio if sweep.sampling.kind == "ratios" else np.arange(len(omega))
        along = [
            Quantity(dims[0], dims, axis, "1", over if dims[0] == "ratio" else "number of the cell"),
            Quantity("omega_1", dims, omega[:, 0], "1", first),
            Quantity("omega_2", dims, omega[:, 1], "1", second),
        ]
        if dims[0] != "ratio":
            along.append(Quantity("ratio", dims, ratio, "1", over))
    stages, units = np.array([stage.name for stage in task.stages]), _presence_units(task.onset.kind)
    return [
        *along,
        Quantity("stage", ("stage",), stages, "1", "stage"),
        Quantity("epsilon", ("epsilon",), np.array(task.onset.series), units, "threshold of the actual start"),
    ]


def dimensions(sampling: Sampling) -> tuple[str, ...]:
    """Return the names of the dimensions along which the cells of a sweep stand."""
    return {"grid": ("omega_2", "omega_1"), "ratios": ("ratio",), "random": ("cell",)}[sampling.kind]


def _presence_units(onset: str) -> str:
    return "m/s^2, rad/s^2" if onset == "control" else "1"


def _quantities(sweep: Sweep) -> list[Quantity]:
    """Return everything that is filled in, cell by cell."""
    task, shape, dims = sweep.task.spec, sweep.sampling.shape, dimensions(sweep.sampling)
    along = {"stage": len(task.stages), "epsilon": len(task.onset.series)}
    filled = [
        Quantity("status", dims, np.full(shape, WAITING, "i4"), "1", "status of the cell", STATUS),
        Quantity("origin", dims, np.full(shape, -1, "i4"), "1", "flat index of the cell whose run it shares"),
        Quantity("reason", dims, np.full(shape, ""), "1", "why the cell failed"),
        Quantity(
            "cell_time", dims, np.full(shape, np.nan), "s", "wall time of the cell's run, with all that is around"
        ),
    ]
    spent = Quantity("wall_time", (), np.array(0.0), "s", "wall time spent on the sweep")
    return [*filled, *unfilled(CELL_QUANTITIES, dims, shape, along), spent]


def read_sweep(path: Path) -> Results:
    """Return the results of a sweep, complete or not.

    Raises:
        LogError: The file is missing, damaged, of another version, or no sweep.
    """
    return read_results(path, SWEEP)


def resume_sweep(path: Path, sweep: Sweep) -> Results:
    """Return what a stopped sweep has come to.

    Raises:
        InputError: The file holds another sweep; the message says in what it differs.
        LogError: As for `read_sweep`.
    """
    if not path.exists():
        raise InputError(f"--resume: found no file {path}, expected a sweep that was stopped; leave --resume out")
    results = read_sweep(path)
    ensure_same(results, sweep.identity, sweep.task, "sweep")
    return results
