"""Made-up records of a robot with three coordinates in a task with four stages."""

from dataclasses import replace

import numpy as np

from psmpc_cli.logs.record import Record, SolveRecord, TickRecord
from psmpc_cli.logs.write import Header, StageTimes

COORDINATES, POSES, STAGES = ("base.x", "base.y", "arm_1.1"), ("base.x", "base.y", "base.theta"), ("a", "b", "c", "d")
TICKS = 5
SAMPLE = 0.1

HEADER = Header(
    attributes={"psmpc_version": "0.1.0", "controller": "psmpc", "task_name": "made up"}
    | {"task_yaml": "not: a task", "robot_yaml": "not: a robot"},
    coordinates=COORDINATES,
    pose_coordinates=POSES,
    stages=STAGES,
    priorities=(1.0, 100.0, 1.0, 0.01),
    epsilons=(1e-3, 1e-1),
    ticks=True,
    plans=True,
    monitors=("object held", "größte Geschwindigkeit"),
)

LEAN = replace(HEADER, ticks=False, plans=False)

NEVER = StageTimes(np.full(4, np.nan), np.full(4, np.nan), np.zeros(4, bool), np.full((4, 2), np.nan))


def record(k: int, first: int = 0, count: int = 1, length: int = 7, multipliers: int = 0) -> Record:
    """Return the record of sample k, all its numbers different, with `count` stages in the window."""
    numbers = iter(k + np.arange(1, 10000) / 10000)

    def draw(*shape: int) -> np.ndarray:
        return np.array([next(numbers) for _ in range(int(np.prod(shape)))]).reshape(shape)

    n, m = len(COORDINATES), len(POSES)
    return Record(
        time=SAMPLE * k,
        Q=draw(n),
        Qdot=draw(n),
        u=draw(n),
        F=draw(n),
        xi=draw(m),
        window_first=first,
        instants=draw(count - 1),
        nadir=draw(count),
        nodes=10.0 + np.arange(count),
        flags=frozenset(
            name for bit, name in enumerate(("appended", "postponed", "fallback", "braking")) if k >> bit & 1
        ),
        switches=(),
        presence={first + 1: float(draw(1)[0])} if count > 1 else {},
        solve=SolveRecord(
            status=("optimal", "iteration_limit")[k % 2],
            iterations=k,
            wall_time=float(draw(1)[0]),
            objective=float(draw(1)[0]),
            guess=draw(length),
            warm=k % 2 == 1,
            guess_multipliers=draw(multipliers),
            parameters=draw(length + 1),
            solution=draw(length),
        ),
        stage_cost=float(draw(1)[0]),
        position_margin=draw(n),
        velocity_margin=draw(n),
        control_effort=float(draw(1)[0]),
        thruster_effort=draw(2),
        momentum_error=draw(3),
        energy_error=float(draw(1)[0]),
        ticks=TickRecord(SAMPLE * (k + np.arange(TICKS) / TICKS), draw(TICKS, n), draw(TICKS, n), draw(TICKS, n)),
    )
