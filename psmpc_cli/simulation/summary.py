"""The summary of a run, from its log alone."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.errors import LogError, SpecError
from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.problem import StageCosts, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.simulation.deviations import Deviations, largest_deviations
from psmpc_cli.simulation.measures import end_error
from psmpc_cli.simulation.monitors import Verdict, verdicts
from psmpc_cli.simulation.smoothness import Variation, total_variation
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task, parse_task


@dataclass(frozen=True)
class StageSummary:
    """One stage: when it started and ended [s], and the published values where there are any; NaN where unknown.

    `duration` is the time from the instant that ended the stage before it to the one that ended it [s].
    """

    name: str
    priority: float
    actual_start: float
    published_start: float
    premature: bool
    switch_time: float
    published_switch: float
    duration: float


@dataclass(frozen=True)
class SolveSummary:
    """Wall time of the solves [s] and iterations, over all windows or those with a switch in them."""

    count: int
    median: float
    p95: float
    p99: float
    largest: float
    iterations: float


@dataclass(frozen=True)
class LimitSummary:
    """The smallest margin to a kind of limit over all ticks, its coordinate, and it over half the limits' distance."""

    kind: str
    coordinate: str
    margin: float
    relative: float


@dataclass(frozen=True)
class Summary:
    """What a run came to.

    Attributes:
        ended: The run came to an end; it was neither killed nor interrupted.
        completed: The last stage met its end condition.
        succeeded: It did, and every monitor held.
        reason: Why the run stopped.
        duration: Simulated time [s].
        stages: By stage.
        solves, switching_solves: All solves, and those of windows with a switch.
        missed: Samples whose solve took longer than the sample time.
        appended, postponed, fallbacks: How often each happened.
        unmeasured: Samples whose state was not measured, at least in part.
        basins: How often another guess of the instants than the last plan's won; None where there was no other.
        unsolved_levels: Levels of a lexicographic controller that did not converge; None under any other.
        limits: The tightest position and velocity margins.
        control_effort: Integral of |u|^2.
        base_force, base_torque: Integrals of their norms [N s], [N m s].
        variation: Total variation of the control.
        momentum_error, energy_error: Largest drift of the physics' balance.
        monitors: The verdicts.
        distances: Distance between the first two end-effectors at the end of each stage [m]; NaN with one arm.
        deviations: How far the motion came from the plans, and beyond the limits.
        end_errors: Error of the last stage's end condition over its tolerance at the end, of the state seen and of the
            true state; None without noise.
    """

    ended: bool
    completed: bool
    succeeded: bool
    reason: str
    duration: float
    stages: tuple[StageSummary, ...]
    solves: SolveSummary
    switching_solves: SolveSummary
    missed: int
    appended: int
    postponed: int
    fallbacks: int
    unmeasured: int
    basins: int | None
    unsolved_levels: int | None
    limits: tuple[LimitSummary, ...]
    control_effort: float
    base_force: float
    base_torque: float
    variation: Variation
    momentum_error: float
    energy_error: float
    monitors: tuple[Verdict, ...]
    distances: tuple[float, ...]
    deviations: Deviations
    end_errors: tuple[float, float] | None = None


def summarize(log: Log) -> Summary:
    """Return the summary of a log, finished or not."""
    loaded = task_of(log)
    completed = bool(log.attributes["finished"])
    monitored = verdicts(loaded.spec, log)
    switching = log["window/count"] > 1
    wall_time = log["solver/wall_time"]
    return Summary(
        ended=bool(np.isfinite(log.final["time"])),
        completed=completed,
        succeeded=completed and all(verdict.held for verdict in monitored),
        reason=str(log.attributes["end_reason"]) or "the run was killed, or goes on",
        duration=_duration(log),
        stages=tuple(_stage(log, loaded, i) for i in range(len(log.stage_names))),
        solves=_solves(log, np.ones(len(wall_time), bool)),
        switching_solves=_solves(log, switching),
        missed=int(np.sum(wall_time > loaded.spec.controller.sample_time)),
        appended=int(log["events/appended"].sum()),
        postponed=int(log["events/postponed"].sum()),
        fallbacks=int(log["events/solve_failed"].sum()),
        unmeasured=int(log.columns.get("events/unmeasured", np.zeros(0)).sum()),
        basins=_basins(log),
        unsolved_levels=int(np.sum(log["levels/solved"] == 0)) if "levels/solved" in log.columns else None,
        limits=_limits(log, loaded),
        control_effort=float(log["effort/control"].sum()),
        base_force=float(log["effort/base_force"].sum()),
        base_torque=float(log["effort/base_torque"].sum()),
        variation=total_variation(log),
        momentum_error=_largest(log["balance/momentum"]),
        energy_error=_largest(log["balance/energy"]),
        monitors=monitored,
        distances=_distances(log),
        deviations=largest_deviations(log),
        end_errors=end_errors(log) if "Q_true" in log.final and np.isfinite(log.final["time"]) else None,
    )


def task_of(log: Log) -> Task:
    """Return the task a log was made from, as it ran.

    Raises:
        LogError: Its texts are not a task and a robot of this version, or not those of the run it holds.
    """
    task_yaml, robot_yaml, name = (str(log.attributes[key]) for key in ("task_yaml", "robot_yaml", "task_name"))
    try:
        loaded = parse_task(task_yaml, robot_yaml, name)
    except SpecError as error:
        raise LogError(f"{log.path}: the task or robot in it does not hold in this version:\n{error}") from None
    described = labels(loaded.robot, "joint"), tuple(stage.name for stage in loaded.spec.stages)
    if described != (log.coordinates, log.stage_names):
        raise LogError(f"{log.path}: the task and robot in it do not describe the run it holds")
    return loaded


def _duration(log: Log) -> float:
    if np.isfinite(log.final["time"]):
        return float(log.final["time"])
    return float(log.time[-1]) if len(log.time) else 0.0


def _stage(log: Log, loaded: Task, index: int) -> StageSummary:
    name, stages = log.stage_names[index], log.stages
    published = loaded.spec.published.get(str(log.attributes["controller"]))
    return StageSummary(
        name=name,
        priority=float(stages["priority"][index]),
        actual_start=float(stages["actual_start"][index]),
        published_start=published.actual_start.get(name, np.nan) if published else np.nan,
        premature=bool(stages["early"][index]),
        switch_time=float(stages["switch_time"][index]),
        published_switch=published.switch_time.get(name, np.nan) if published else np.nan,
        duration=float(stages["switch_time"][index] - (stages["switch_time"][index - 1] if index else 0.0)),
    )


def _solves(log: Log, chosen: np.ndarray) -> SolveSummary:
    wall_time, iterations = log["solver/wall_time"][chosen], log["solver/iterations"][chosen]
    if not len(wall_time):
        return SolveSummary(0, np.nan, np.nan, np.nan, np.nan, np.nan)
    median, p95, p99, largest = np.percentile(wall_time, [50, 95, 99, 100])
    return SolveSummary(len(wall_time), median, p95, p99, largest, float(np.median(iterations)))


def _limits(log: Log, loaded: Task) -> tuple[LimitSummary, ...]:
    """Return for positions and velocities the coordinate whose margin is smallest relative to its limit."""
    stages = build_stages(loaded.spec, loaded.robot, build_model(loaded.robot))
    first = log["window/first"]
    tightest = []
    for kind in ("position", "velocity"):
        margin = log[f"margin/{kind}"]
        if not len(margin) or not np.isfinite(margin).any():
            continue
        limits = [stages[s].limits for s in first]
        width = np.array([getattr(limit, f"{kind}_high") - getattr(limit, f"{kind}_low") for limit in limits]) / 2
        bounded = np.isfinite(width) & (width > 0)
        relative = np.where(np.isfinite(margin), margin / np.where(bounded, width, 1.0), np.inf)
        row, column = np.unravel_index(np.argmin(relative), relative.shape)
        coordinate = log.coordinates[int(column)]
        tightest.append(LimitSummary(kind, coordinate, float(margin[row, column]), float(relative[row, column])))
    return tuple(tightest)


def _basins(log: Log) -> int | None:
    basin = log.columns.get("window/basin", np.full(len(log.time), -1))
    return int(np.sum(basin > 0)) if np.any(basin >= 0) else None


def end_errors(log: Log) -> tuple[float, float]:
    """Return the last stage's end errors of the final state, as the controller saw it and true."""
    loaded = task_of(log)
    model = build_model(loaded.robot)
    stage, costs = build_stages(loaded.spec, loaded.robot, model)[-1], StageCosts(model)
    noisy = "Q_true" in log.final
    states = (np.concatenate([log.final[f"Q{of}"], log.final[f"Qdot{of}"]]) for of in ("", "_true" if noisy else ""))
    seen, true = (end_error(costs, stage, x) for x in states)
    return seen, true


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max()) if values.size else np.nan


def _distances(log: Log) -> tuple[float, ...]:
    arms = [name.removesuffix(".x") for name in log.pose_coordinates if name.endswith(".x") and name != "base.x"]
    if len(arms) < 2 or not len(log.time):
        return (np.nan,) * len(log.stage_names)
    names, xi = list(log.pose_coordinates), np.vstack([log["pose/xi"], log.final["xi"]])
    gap = [xi[:, names.index(f"{arms[0]}.{axis}")] - xi[:, names.index(f"{arms[1]}.{axis}")] for axis in "xy"]
    distance, time = np.hypot(*gap), np.append(log.time, log.final["time"])
    known = np.isfinite(time)
    return tuple(float(np.interp(t, time[known], distance[known])) for t in log.stages["switch_time"])
