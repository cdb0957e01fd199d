"""A record as the row it leaves in each dataset along /time."""

from collections.abc import Mapping

import numpy as np

from psmpc_cli.logs.record import LevelsRecord, Record

Row = Mapping[str, object]


def row(record: Record, stages: int) -> Row:
    """Return what a record leaves in /time and in every column, by path, in a task with so many stages."""
    happened = {name: name in record.flags for name in ("appended", "postponed", "fallback", "braking", "unmeasured")}
    solve, n = record.solve, len(record.Q)
    deviation = record.plan_deviation if len(record.plan_deviation) else np.full(2 * n, np.nan)
    return {
        "time": record.time,
        "state/Q": record.Q,
        "state/Qdot": record.Qdot,
        "control/u": record.u,
        "force/F": record.F,
        "pose/xi": record.xi,
        "window/first": record.window_first,
        "window/count": len(record.instants) + 1,
        "window/instants": _at_their_stages(stages, record.window_first, record.instants),
        "window/cost": _at_their_stages(stages, record.window_first, record.window_cost),
        "window/basin": record.basin,
        "window/nodes": _at_their_stages(stages, record.window_first, record.nodes),
        "window/presence": _by_stage(stages, record.presence),
        "window/share": _by_stage(stages, record.shares),
        **{f"events/{name}": yes for name, yes in happened.items()},
        "solver/status": solve.status,
        "solver/warm": solve.warm,
        "solver/iterations": solve.iterations,
        "solver/wall_time": solve.wall_time,
        "solver/objective": solve.objective,
        "normalization/nadir": _at_their_stages(stages, record.window_first, record.nadir),
        "cost/current_stage": record.stage_cost,
        "margin/position": record.position_margin,
        "margin/velocity": record.velocity_margin,
        "effort/control": record.control_effort,
        "effort/base_force": record.thruster_effort[0],
        "effort/base_torque": record.thruster_effort[1],
        "deviation/Q": deviation[:n],
        "deviation/Qdot": deviation[n:],
        "deviation/end": _by_stage(stages, record.end_errors),
        "balance/momentum": record.momentum_error,
        "balance/energy": record.energy_error,
    }


def levels_row(levels: LevelsRecord | None, stages: int) -> Row:
    """Return what the levels leave in every column of LEVELS, by path; that there are none, without any."""
    unknown = np.full(stages, np.nan)
    levels = levels or LevelsRecord(unknown, unknown, unknown, np.full(stages, -1))
    return {f"levels/{name}": getattr(levels, name) for name in ("objective", "cost", "wall_time", "solved")}


def uncertain_row(record: Record) -> Row:
    """Return what a record leaves in the columns of TRUE_STATE, PAYLOAD and DISTURBANCE that its log has."""
    found: dict[str, object] = {}
    if record.true is not None:
        found |= dict(zip(("state/Q_true", "state/Qdot_true"), np.split(record.true, 2), strict=True))
    if record.payload is not None:
        found |= dict(zip(("payload/held", "payload/energy"), record.payload, strict=True))
    if record.disturbance is not None:
        found["control/disturbance"] = record.disturbance
    return found


def _at_their_stages(stages: int, first: int, values: np.ndarray) -> np.ndarray:
    """Return the window's values at their stages' places (S,); NaN elsewhere."""
    placed = np.full(stages, np.nan)
    placed[first : first + len(values)] = values
    return placed


def _by_stage(stages: int, values: Mapping[int, float]) -> np.ndarray:
    """Return values by stage index at their stages' places (S,); NaN elsewhere."""
    placed = np.full(stages, np.nan)
    placed[list(values)] = list(values.values())
    return placed
