"""A task of two seconds, ten centimetres there and back, and logs of its runs."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

TASK = """\
robot: planar_dual_arm
initial: {base: [0, 0, 0], arm_1: [0, 0, 0], arm_2: [0, 0, 0]}
controller: {horizon: 1, nodes: 5}
plant: {kind: ideal, low_level_rate: 100}
skills:
  move: {space: joint, weights: {base: [100, 100, 10], arm_1: [1, 1, 1], arm_2: [1, 1, 1]}}
stages:
  - name: go
    skill: move
    target: {base: [0.1, 0, 0], arm_1: [0.02, 0, 0], arm_2: [0, 0, 0]}
    ends_when: {coordinates: [base], tolerance: 0.005}
  - name: back
    skill: move
    target: {base: [0, 0, 0], arm_1: [0, 0, 0], arm_2: [0, 0, 0]}
    ends_when: {coordinates: [base], tolerance: 0.005}
object: {shape: [0.4, 0.2], pose: [0, 1, 0], taken_by: go}
monitors:
  - {name: far apart, quantity: distance, of: [arm_1, arm_2], during: back, at_least: 1.0}
published:
  smpc: {switch_time: {go: 0.9}, actual_start: {back: 0.8}}
time_limit: 4
solver: {kind: fatrop}
"""

CUT = (
    "plant.kind=rk4",
    "solver.compiled=false",
    "limits.base.force=[6, 20, 1]",
    "uncertainty.force_share={base: [0.8, 1, 1]}",
    "log.ticks=true",
    "log.shares=false",
    "time_limit=1.5",
)
"""Changes with which the plan keeps forces on the base within limits of which less is there than it knows."""


def there_and_back(folder: Path, *changes: str, samples: int | None = None, name: str = "log", text: str = TASK) -> Run:
    """Return the log of a run there and back, or of another text, interrupted after so many samples.

    Equal runs are made once, and their logs are written into each folder.
    """
    path = folder / f"{name}.h5"
    (folder / "task.yaml").write_text(text)
    path.write_bytes(_log(changes, samples, text))
    return read_run(path)


@cache
def _log(changes: tuple[str, ...], samples: int | None, text: str) -> bytes:
    told: list[Sample] = []

    def watch(progress: Sample) -> None:
        told.append(progress)
        if len(told) == samples:
            raise KeyboardInterrupt

    with TemporaryDirectory() as folder:
        task = Path(folder) / "task.yaml"
        path = Path(folder) / "log.h5"
        task.write_text(text)
        simulate(load_task(task, changes), path, watch=watch)
        return path.read_bytes()
