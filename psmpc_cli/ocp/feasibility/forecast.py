"""What is known of the stages of a task before anything is solved: reach, postures, and how early each can end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.feasibility.postures import configurations_at_stops
from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import ConfigurationSpace, configuration_space
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import Reach, reach_of
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import BASE
from psmpc_cli.specs.robots.robot import stack


@dataclass(frozen=True, eq=False)
class StageForecast:
    """What is known of one stage before a run.

    Attributes:
        model: The robot.
        stage: The stage.
        reaches_at_waypoints: For each waypoint of the target, by arm, how far the arm's pose is with the base at its
            own pose, under the limits in force; empty in joint space, and for arms (or with a base) whose place neither
            weights nor the end condition ask for.
        earliest_end: Time before which the stage cannot end [s]: from velocity limits, dwells and fixed times.
        stuck: Coordinates that its end condition wants elsewhere but velocity limits let not move that way.
    """

    model: RobotModel
    stage: Stage
    reaches_at_waypoints: Sequence[Mapping[str, Reach]]
    earliest_end: float
    stuck: tuple[int, ...] = ()

    @property
    def reaches(self) -> Mapping[str, Reach]:
        """By arm, how far its target is: of a trajectory, the last row's."""
        return self.reaches_at_waypoints[-1]


def forecast_stages(task: Task) -> tuple[StageForecast, ...]:
    """Return the forecast of every stage of a task."""
    model = RobotModel(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    ends = earliest_ends(task, stages)
    along = ([reaches_of(stage, model, xi) for xi in stage.reference.points] for stage in stages)
    forecasts = zip(stages, along, ends, strict=True)
    return tuple(StageForecast(model, stage, reaches, *end) for stage, reaches, end in forecasts)


def forecast_configurations(task: Task, forecasts: Sequence[StageForecast]) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (nq,) each."""
    stages = [forecast.stage for forecast in forecasts]
    return configurations_at_stops(task, forecasts[0].model, stages, [forecast.reaches for forecast in forecasts])


def earliest_ends(task: Task, stages: Sequence[Stage]) -> list[tuple[float, tuple[int, ...]]]:
    """Return how early every stage of a task can end, by velocity and acceleration limits alone: a lower bound.

    A coordinate that one end condition asks for at one place, and a later one at another, needs at least the time to go
    there as fast as the limits of the stages in between allow, less the tolerances of both. From the start of the task
    it has to gain that velocity first. The attitude of a spatial base has a row of its own, the last: it moves by the
    angle to its target, as fast as all limits of the angular velocity together allow.

    Args:
        task: The task.
        stages: Its stages.

    Returns:
        For each stage the time before which it cannot end [s], and the coordinates of v that are stuck: its end
        condition wants them elsewhere, but their limits do not let them move that way. Number n is the attitude.
    """
    Q, v = initial_state(task)
    space = configuration_space(task.robot)
    # What is known of each coordinate: its value (the attitude's is its angle from `attitude`) when an end condition
    # last asked for it, within which tolerance, when that was, and how fast it may have moved since. (n + 1,) each.
    attitude = Q[space.attitude]
    value = np.append(space.in_order_of_v(Q), 0.0)
    tolerance = np.zeros(len(value))
    since = np.zeros(len(value))
    fastest_since = np.zeros((4, len(value)))  # velocity up and down, acceleration up and down
    initial_speed = np.append(v, np.linalg.norm(v[space.rotation]))
    has_been_asked = np.zeros(len(value), bool)
    ends = list[tuple[float, tuple[int, ...]]]()
    end = 0.0
    for stage in stages:
        rates = largest_rates(space, stage)  # (4, n + 1), as `fastest_since`
        if not stage.moved_by.moves:
            rates[:, space.base] = 0.0
            rates[:, -1] = 0.0
        fastest_since = np.maximum(fastest_since, rates)
        asked = tolerances_of(space, stage)  # tolerance by coordinate that the end condition asks for
        rows = np.array(list(asked), int)
        within = np.array(list(asked.values()))
        angle = angle_between(attitude, stage.target[space.attitude])
        target = np.append(coordinates_of(space, stage, stage.target), angle)
        difference = target[rows] - value[rows]
        distance = np.maximum(np.abs(difference) - within - tolerance[rows], 0.0)
        # Velocity and acceleration upwards or downwards, whichever way a coordinate has to go.
        upwards = fastest_since[::2, rows]
        downwards = fastest_since[1::2, rows]
        speed, acceleration = np.where(difference > 0, upwards, downwards)
        is_stuck = (distance > 0) & (speed <= 0)
        # A coordinate may have any velocity when an end condition has asked for it; at the start it is known.
        towards_target = np.minimum(np.sign(difference) * initial_speed[rows], speed)
        first_speed = np.where(has_been_asked[rows], speed, towards_target)
        arrivals = since[rows] + shortest_time(distance, speed, acceleration, first_speed)
        hold = stage.end.hold
        earliest = max(end + max(stage.end.dwell, hold), *(arrivals[~is_stuck] + hold), 0.0)
        end = min(max(earliest, stage.end.earliest), stage.end.latest)
        value[rows] = target[rows]
        tolerance[rows] = within
        since[rows] = end
        fastest_since[:, rows] = 0.0
        has_been_asked[rows] = True
        if space.n in asked:
            attitude = stage.target[space.attitude]
            value[-1] = 0.0
        ends.append((end, tuple(rows[is_stuck].tolist())))
    return ends


def initial_state(task: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return Q (nq,) and v (n,) at the start."""
    spec = task.spec
    robot = task.robot
    return stack(spec.initial, robot, "joint"), stack(spec.initial_velocity, robot, "joint", 0.0, of_error=True)


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    """Return the angle between two attitudes [rad], as unit quaternions; 0 in the plane."""
    return float(2 * np.arccos(min(1.0, abs(float(one @ other))))) if len(one) else 0.0


def largest_rates(space: ConfigurationSpace, stage: Stage) -> np.ndarray:
    """Return the largest velocities and accelerations up and down, the attitude's last, (4, n + 1)."""
    limits = stage.limits
    both = np.array([limits.velocity_high, -limits.velocity_low, limits.acceleration_high, -limits.acceleration_low])
    of_turn = np.linalg.norm(np.maximum(both[::2], both[1::2])[:, space.rotation], axis=1)
    return np.column_stack([both, np.repeat(of_turn, 2)])


def shortest_time(distance: np.ndarray, rate: np.ndarray, gain: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Return the shortest times over distances with bounded velocities and accelerations, (K,) [s].

    Args:
        distance: Distances to go, (K,) [m, rad].
        rate: Largest velocities.
        gain: Largest accelerations, by which velocities grow; infinite where there is no limit.
        begins: Velocities at the beginning, towards the target.
    """
    with np.errstate(all="ignore"):
        ramp = np.where(np.isfinite(gain), (rate**2 - begins**2) / (2 * gain), 0.0)
        fast = np.where(np.isfinite(gain), (rate - begins) / gain, 0.0) + (distance - ramp) / rate
        slow = (np.sqrt(begins**2 + 2 * gain * distance) - begins) / gain
    return np.asarray(np.where(distance <= 0, 0.0, np.where((distance >= ramp) & (rate > 0), fast, slow)))


def coordinates_of(space: ConfigurationSpace, stage: Stage, target: np.ndarray) -> np.ndarray:
    """Return the coordinates that a target's numbers say, in the order of v (n,); NaN for those that they do not."""
    coordinates = np.full(space.nq, np.nan)
    for part in stage.parts_in_Q:
        coordinates[part.coordinates] = target[part.numbers]
    return space.in_order_of_v(coordinates)


def coordinate_of_row(stage: Stage) -> dict[int, int]:
    """Return which coordinate of v each row of the error is of; those of poses of arms, and of points, are of none."""
    by_row = dict[int, int]()
    for part in stage.parts_in_Q:
        rows = range(part.rows.start, part.rows.stop)
        by_row |= zip(rows, range(part.rates.start, part.rates.stop), strict=True)
    return by_row


def tolerances_of(space: ConfigurationSpace, stage: Stage) -> dict[int, float]:
    """Return the tolerance of every coordinate in the end condition [m, rad]; in task space those of the base.

    Row n is the attitude of a spatial base, where the end condition has all of it.
    """
    asked = dict(zip(stage.end.rows, stage.end.tolerance.tolist(), strict=True))
    coordinates = coordinate_of_row(stage)
    by_coordinate = {coordinates[row]: tolerance for row, tolerance in asked.items() if row in coordinates}
    rotation = range(space.rotation.start, space.rotation.stop)
    if stage.attitudes and set(rotation) <= set(asked):
        by_coordinate[space.n] = float(np.linalg.norm([asked[row] for row in rotation]))
    return by_coordinate


def is_asked_for(stage: Stage, rows: Sequence[int]) -> bool:
    """Tell whether the weights or the end condition of a stage ask for all of some rows of its target."""
    return bool(stage.relevant_rows[list(rows)].all())


def reaches_of(stage: Stage, model: RobotModel, target: np.ndarray, base: np.ndarray | None = None) -> dict[str, Reach]:
    """Return for each arm how far its pose in a target is from its shoulder, and whether it can take it.

    It can if some joint coordinates within their limits take the pose. Arms are left out whose pose neither weights nor
    the end condition ask for; all are if these do not ask for the pose of the base, which then may be anywhere.

    Args:
        stage: The stage.
        model: The robot.
        target: Numbers of a target of the stage, (numbers,).
        base: Pose of the base, (n_pose,); by default where the target has it.
    """
    base_rows = range(model.spec.parts["base"])
    if not is_asked_for(stage, base_rows):
        return {}
    low, high = bounds_of(stage, "position")
    base_pose = target[stage.parts[BASE].numbers] if base is None else base
    reaches = {}
    for arm in stage.poses_of_arms:
        part = stage.parts[arm]
        if is_asked_for(stage, range(part.rows.start, part.rows.stop)):
            joints = model.parts[arm]
            reaches[arm] = reach_of(model, arm, base_pose, target[part.numbers], (low[joints], high[joints]))
    return reaches


def bounds_of(stage: Stage, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of the positions or velocities of Q, (n,) each."""
    return getattr(stage.limits, f"{kind}_low"), getattr(stage.limits, f"{kind}_high")
