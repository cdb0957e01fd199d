"""Every command that reads a log, on a log of every kind of built-in task and of every controller."""

from pathlib import Path
from typing import get_args

import pytest

from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.controller import ControllerSpec
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.sweep import sweep

from .command import Psmpc

READERS = (
    "show log.h5",
    "show log.h5 --verbose",
    "show log.h5 --csv tables",
    "view log.h5",
    "replay log.h5 --step 0",
    "verify log.h5",
)

DRAWN = ("catch_tumbling", "inspect_around", "tracking", "transport")
"""Tasks whose logs have all kinds of figures: of grasps, distances, trajectories, of a robot in the plane and in space.

Every figure has its own tests.
"""

SHORT = ("controller.nodes=2", "time_limit=0.1", "solver.compiled=false", "solver.max_iterations=3", "log.ticks=true")
"""One sample: what is compiled would take longer than it."""


def share_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build the problem of a task once for all commands: each alone would build it again, which takes longest."""
    built = dict[str, Problem]()

    def build(task: Task) -> Problem:
        if task.digest not in built:
            built[task.digest] = build_problem(task)
        return built[task.digest]

    for module in ("logs.run", "simulation.run", "simulation.replay"):
        monkeypatch.setattr(f"psmpc_cli.{module}.build_problem", build)


CONTROLLERS = get_args(ControllerSpec.model_fields["kind"].annotation)

LIKE_OTHERS = {"approach_capture", "catch_drifting", "inspect", "transport_as_printed"}
"""Tasks whose logs have what the logs of others have."""

LOGS = (
    *((task, "psmpc") for task in built_ins("task") if task not in LIKE_OTHERS),
    *(("transport", kind) for kind in CONTROLLERS if kind != "psmpc"),
    ("catch_tumbling", "htmpc"),
)
"""A log of each kind of task and of each controller, and the datasets of htmpc beside those of a capture in space."""


def longer(task: str, controller: str) -> tuple[str, ...]:
    """The commands that take longest, for logs that they have something else to do with than with others."""
    if controller == "psmpc":
        return ("rerun log.h5 --quiet --strict", *(("plot log.h5",) if task in DRAWN else ()))
    return ("report log.h5",) if controller == "htmpc" else ()


@pytest.mark.slow
@pytest.mark.parametrize(("task", "controller"), LOGS)
def test_every_log_is_read_by_every_command(
    psmpc: Psmpc, tmp_path: Path, task: str, controller: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    share_problems(monkeypatch)
    loaded = load_task(task, (f"controller.kind={controller}", *SHORT))
    assert len(simulate(loaded, tmp_path / "log.h5").time) == 1
    for line in (*READERS, *longer(task, controller)):
        ran = psmpc(*line.split())
        assert (ran.code, ran.stderr) == (0, ""), line
        assert ran.stdout, line
    with pytest.importorskip("xarray").open_dataset(tmp_path / "log.h5", engine="h5netcdf") as dataset:
        assert dataset.load().sizes["time"] == 1


def test_a_sweep_over_keys_is_printed_and_said_to_have_no_figures(psmpc: Psmpc, tmp_path: Path) -> None:
    task = load_task("transport", ["controller.nodes=4", "time_limit=0.2", "log.shares=false", "plant.kind=ideal"])
    sweep(task, {"stages.capture.priority": [1, 10]}, path=tmp_path / "keys.h5", jobs=1)
    shown = psmpc("show", str(tmp_path / "keys.h5"))
    assert (shown.code, shown.stdout.splitlines()[0]) == (0, "0 of 2 runs succeeded: 2 computed")
    assert shown.stdout.count("time limit of 0.2 s reached") == 2
    drawn = psmpc("plot", str(tmp_path / "keys.h5"))
    assert drawn.code == 2
    assert "found a sweep over keys, of which there are no figures" in drawn.stderr
