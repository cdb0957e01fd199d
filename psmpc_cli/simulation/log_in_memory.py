"""The log of a run that is written nowhere: what a log is asked after a run can be asked of it all the same."""

from pathlib import Path

import numpy as np

from psmpc_cli.logs.create import Header
from psmpc_cli.logs.layout import MOMENTUM, TIME
from psmpc_cli.logs.read import Log
from psmpc_cli.logs.rows import Row, levels_row, row, uncertain_row
from psmpc_cli.simulation.loop import Ending, simulate
from psmpc_cli.simulation.run import header, new_clock
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.simulation.stage_times import StageClock

NOWHERE = Path("a run that was not written")
"""What stands for the file of such a log."""


def run_in_memory(experiment: Experiment) -> tuple[Log, Ending]:
    """Run the closed loop to its end and return its log, without plans, ticks and verdicts, and how it ended."""
    clock, rows = new_clock(experiment), list[Row]()
    described, samples = header(experiment), simulate(experiment)
    try:
        while True:
            record = next(samples)
            clock.update(record)
            levels = levels_row(record.levels, len(described.stages)) if described.levels else {}
            rows.append({**row(record, len(described.stages)), **levels, **uncertain_row(record)})
    except StopIteration as stop:
        ending: Ending = stop.value
    clock.hand_over(tuple((switch.stage, switch.time) for switch in ending.switches))
    return _log(experiment, described, rows, clock, ending), ending


def _log(experiment: Experiment, described: Header, rows: list[Row], clock: StageClock, ending: Ending) -> Log:
    """Return the log of a run that has ended."""
    times = clock.times
    return Log(
        path=NOWHERE,
        attributes={**described.attributes, "finished": ending.completed, "end_reason": ending.reason},
        columns=_columns(described, rows),
        stages={
            "name": np.array(described.stages),
            "priority": np.array(described.priorities),
            "epsilon": np.array(described.epsilons),
            "switch_time": times.switch_time,
            "actual_start": times.actual_start,
            "premature": times.premature,
            "actual_start_by_epsilon": times.by_epsilon,
        },
        coordinates=described.coordinates,
        pose_coordinates=described.pose_coordinates,
        final=_final(experiment, described.noisy, ending),
        monitors={},
        ticks={},
        plans=False,
    )


def _columns(described: Header, rows: list[Row]) -> dict[str, np.ndarray]:
    """Return every dataset with a row a sample."""
    names = {
        "coordinate": described.coordinates,
        "pose_coordinate": described.pose_coordinates,
        "stage": described.stages,
        "momentum": MOMENTUM,
    }
    columns = {}
    for column in (TIME, *described.columns):
        size = (len(rows), len(names[column.scale])) if column.scale else (len(rows),)
        columns[column.path] = np.array([each[column.path] for each in rows], column.dtype).reshape(size)
    return columns


def _final(experiment: Experiment, noisy: bool, ending: Ending) -> dict[str, np.ndarray]:
    """Return time, state and poses at the end; with noise the state is the measured one, the true one beside it."""
    states = {"": ending.x, "_true": ending.true} if noisy else {"": ending.x}
    time = np.array(ending.time)
    found = {"time": time, "end_time": time, "xi": experiment.model.poses(ending.true[: experiment.model.n]).ravel()}
    for of, x in states.items():
        found |= dict(zip((f"Q{of}", f"Qdot{of}"), np.split(x, 2), strict=True))
    return found
