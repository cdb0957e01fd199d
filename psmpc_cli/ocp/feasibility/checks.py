"""Whether a task can be done, as far as can be decided before anything is solved: limits, reach, order of events."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility.drift import drifts
from psmpc_cli.ocp.feasibility.forecast import (
    StageForecast,
    bounds_of,
    coordinates_of,
    forecast_configurations,
    forecast_stages,
    initial_state,
    is_asked_for,
    reaches_of,
    tolerances_of,
)
from psmpc_cli.ocp.feasibility.posing import posing_remarks
from psmpc_cli.ocp.feasibility.postures import largest_load_ratio, reasons_unforeseen
from psmpc_cli.ocp.feasibility.targets import clearance_remarks, cone_remarks, monitor_faults
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.problem import in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import configuration_space
from psmpc_cli.robot.dynamics import LARGEST_CONDITION
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import Reach, furthest_centre
from psmpc_cli.robot.rotations import conjugate, log, product, rotate
from psmpc_cli.specs.arguments import require
from psmpc_cli.specs.document import Changes, Fault, Location, dotted, quoted
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.load import load_task as load_valid_task
from psmpc_cli.specs.parts import ERROR_AXES, LENGTH
from psmpc_cli.specs.robots.robot import labels, units
from psmpc_cli.specs.stages import TrajectorySpec
from psmpc_cli.specs.uncertainty import standard_deviations

SLACK = 1e-9
"""By which a bound may be missed [m, rad]: decimals of degrees."""

ALL_KNOWN = 3
"""Links of a planar arm up to which "not reachable" is certain."""

ENVELOPE = {"position": "m", "angle": "rad", "velocity": "m/s", "angular_velocity": "rad/s"}
"""Keys of a grasp's envelope and their units."""

SPEED_SLACK = 1e-6
"""By which a trajectory may be faster than a velocity limit [m/s, rad/s]: values are written with a few digits."""


def load_task(reference: str | Path | Mapping[str, Any], set: Changes = (), *, feasibility: bool = True) -> Task:
    """Load a task and its robot, and make sure that it can be done: what `psmpc check` rejects is an error.

    Args:
        reference: The name of a built-in task, the path of a file, or the task itself as a mapping of its keys.
        set: Keys of the task to change: a mapping of paths to values, such as `{"controller.nodes": "auto"}` or
            `{"stages.capture.priority": 10}`, or a sequence of texts `path=value` and options short for them.
        feasibility: Whether to check also that start and targets are within limits, that poses are within reach, and
            that stages can end in the order of the task. This takes up to a second for long tasks of spatial robots.
            Without it a task that no run can complete is loaded, and runs as it is.

    Raises:
        InputError: The reference or the changes are of another type.
        SpecError: The task, the robot's file or a change is not valid, or the task cannot be done; the message lists
            all faults with their places in the task's file.
    """
    require("feasibility", feasibility, bool, "True or False")
    task = load_valid_task(reference, set)
    return ensure_feasible(task) if feasibility else task


def ensure_feasible(task: Task) -> Task:
    """Return a task if it can be done as far as can be decided before a run.

    Raises:
        SpecError: It cannot; the message lists all faults with their places in the task's file.
    """
    if problems := review(task):
        raise SpecError(task.source.report(problems))
    return task


def review(task: Task) -> list[Fault]:
    """Return all faults by which a task cannot be done: what `psmpc check` reports as errors."""
    forecasts = forecast_stages(task)
    return [
        *_start_outside_limits(task, forecasts[0].stage),
        *(problem for forecast in forecasts for problem in _targets_outside_limits(task, forecast.stage)),
        *(problem for forecast in forecasts for problem in _beyond_momentum(task, forecast)),
        *(problem for forecast in forecasts for problem in _out_of_reach(task, forecast, certain=True)),
        *(
            problem
            for now, then in pairwise(forecasts)
            for problem in _ends_outside_next_limits(task, now.stage, then.stage)
        ),
        *_impossible_ends(task, forecasts),
        *_singular_postures(task, forecasts),
        *_arrivals_outside_grasps(task, forecasts),
        *monitor_faults(task, forecasts[0].model),
    ]


def _arrivals_outside_grasps(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield faults of a capture in which grippers may arrive where they cannot close on the object.

    A gripper closes while position, angle and velocities of the hand relative to its grasp on the object are within the
    envelope of the grasp. The stage before the capture has to guarantee that, by its target and by the tolerances of
    its end condition. Nothing is said where that stage has no such tolerances, or does not bring all grippers to poses.

    Args:
        task: The task.
        forecasts: What is known of each stage before a run; here only the stages themselves count.
    """
    target_object = task.spec.body
    stage = forecasts[task.spec.held_stages.start - 1].stage  # grippers close at its end, and hold in those that follow
    poses = stage.poses_of_arms
    brings_grippers_there = len(stage.end.rows) > 0 and set(target_object.grippers) <= set(poses)
    if target_object.mass == 0.0 or not brings_grippers_there:
        return
    envelope = target_object.grasp.envelope

    def norms(motion: np.ndarray) -> list[float]:
        """Return the norms of the linear and the angular part."""
        linear, angular = np.split(motion, [task.robot.dimension])
        return [float(np.linalg.norm(linear)), float(np.linalg.norm(angular))]

    space = configuration_space(task.robot)
    # By row of the error; infinite where the end condition does not bound it.
    tolerance_of_row = np.full(len(stage.weights), np.inf)
    tolerance_of_row[list(stage.end.rows)] = stage.end.tolerance
    rate_tolerance_of_row = np.full(len(stage.weights), np.inf)
    if stage.end.rate_tolerance is not None:
        rate_tolerance_of_row[list(stage.end.rows)] = stage.end.rate_tolerance
    arrival_errors = dict[str, list[float]]()  # of each arm, in the order of ENVELOPE
    for arm, grasp_pose in target_object.grasp.at.items():
        rows = stage.parts[arm].rows
        arrival_errors[arm] = norms(tolerance_of_row[rows]) + norms(rate_tolerance_of_row[rows])
        distance, angle = norms(space.pose_error(poses[arm], space.composed(target_object.pose, grasp_pose)))
        follows_object = target_object.motion.moves or arm in stage.on_object
        is_outside = distance > envelope.position or angle > envelope.angle
        if is_outside and not follows_object:
            far = f"{distance:.3g} m and {np.degrees(angle):.3g} deg"
            message = f"found a pose {far} from where {quoted(stage.name)} leads {arm}, expected it there"
            yield Fault(("object", "grasp", "at", arm), message)
    for row, (key, unit) in enumerate(ENVELOPE.items()):
        largest, arm = max((errors[row], arm) for arm, errors in arrival_errors.items())
        allowed = getattr(envelope, key)
        if largest > allowed * (1 + SLACK):
            arrives = (
                f"lets {arm} arrive within {largest:.3g} {unit}" if np.isfinite(largest) else f"does not bound {arm}"
            )
            message = (
                f"found {allowed:.3g} {unit}, expected no less than {quoted(stage.name)} ends with, which {arrives}"
            )
            yield Fault(("object", "grasp", "envelope", key), message)


def _start_outside_limits(task: Task, first: Stage) -> Iterator[Fault]:
    """Yield the coordinates of the initial state that are outside the limits of the first stage."""
    Q, v = initial_state(task)
    space = configuration_space(task.robot)
    position = coordinates_of(space, first, Q)
    for key, kind, values in (("initial", "position", position), ("initial_velocity", "velocity", v)):
        for row in _rows_out_of_bounds(values, *bounds_of(first, kind)):
            yield Fault(_location(task, (key,), row), _out_of_bounds_message(task, row, values[row], first, kind))


def _targets_outside_limits(task: Task, stage: Stage) -> Iterator[Fault]:
    """Yield the coordinates of a stage's target, or of a point of its trajectory, that are outside its limits."""
    space = configuration_space(task.robot)
    for index, waypoint in enumerate(stage.reference.points):
        values = coordinates_of(space, stage, waypoint)
        for row in _forbidden_coordinates(stage, values):
            yield Fault(_location(task, stage, row, index), _out_of_bounds_message(task, row, values[row], stage))


def _forbidden_coordinates(stage: Stage, values: np.ndarray) -> list[int]:
    """Return the coordinates whose values (n,) the stage asks for but its limits forbid."""
    return [row for row in _rows_out_of_bounds(values, *bounds_of(stage, "position")) if is_asked_for(stage, [row])]


def _out_of_reach(task: Task, forecast: StageForecast, certain: bool) -> Iterator[Fault]:
    """Yield the poses of a stage's target that an arm cannot take, with the base where the target has it.

    Args:
        task: The task.
        forecast: The stage, with how far each arm is from its pose at each of the target's waypoints.
        certain: True: yield the poses that are proven to be out of reach, as faults. False: yield those for which a
            search has found no joint coordinates although there may be some, as remarks.
    """
    base_pose = configuration_space(task.robot).format_pose
    for index, (waypoint, reaches) in enumerate(
        zip(forecast.stage.reference.points, forecast.reaches_at_waypoints, strict=True)
    ):
        for arm, reach in reaches.items():
            if not reach.reachable:
                is_proven, message = _why_out_of_reach(task, arm, reach, f"with the base at {base_pose(waypoint)}")
                if is_proven == certain:
                    yield Fault(_location_of_part(task, forecast.stage, arm, index), f"found {message}")


def _why_out_of_reach(task: Task, arm: str, reach: Reach, base: str) -> tuple[bool, str]:
    """Return whether a pose is proven to be out of an arm's reach, and why it is, in words for a message.

    It is proven if the pose is farther away, or nearer, than the lengths of the links allow. If only joint limits keep
    the arm from it, that is proven for planar arms of up to `ALL_KNOWN` links, whose solutions are all known.

    Args:
        task: The task.
        arm: Name of the arm.
        reach: How far the pose is from the arm's first joint, the shoulder, and how far the arm reaches.
        base: Where the base is, in words.
    """
    far = f"{reach.distance:.4g} m from"
    if reach.distance > reach.full_reach:
        return True, (
            f"a pose {far} the shoulder of {arm} {base}, expected at most its reach of {reach.full_reach:.4g} m"
        )
    if not reach.within_annulus:
        return True, (
            f"a pose that puts the last joint {reach.wrist_distance:.4g} m from the shoulder of {arm} {base}, "
            f"expected between {reach.inner:.4g} and {reach.outer:.4g} m, the reach of the links before the "
            "last"
        )
    if task.robot.dimension == 2 and len(task.robot.arms[arm].links) <= ALL_KNOWN:
        return True, (
            f"a pose that {arm} can take only beyond its joint limits {base} ({far} its shoulder, within its "
            f"reach of {reach.full_reach:.4g} m), expected one within them"
        )
    metres, angle = reach.missed
    return False, (
        f"no joint coordinates of {arm} within their limits that take the pose {base}: the nearest misses "
        f"it by {metres:.2g} m and {np.degrees(angle):.2g} deg, expected a pose within reach, or weights and an end "
        "condition that do not ask for all of it"
    )


def _beyond_momentum(task: Task, forecast: StageForecast) -> Iterator[Fault]:
    """Yield a fault where an end condition wants a floating base to be where its momentum cannot bring it.

    Nothing pushes such a base. So the common centre of mass of robot and arms moves at p / M, linear momentum over
    mass, whatever the arms do, and the base cannot be farther from it than stretched arms allow. The stage ends at some
    time between its earliest possible end and the time limit of the task. The least distance in that time is taken axis
    by axis, which is never too large, so that a fault is certain. Nothing is said once the base was pushed or held in
    this or an earlier stage, or where an object or uncertainty changes the momentum.

    Args:
        task: The task.
        forecast: The stage, with the time before which it cannot end.
    """
    model = forecast.model
    stage = forecast.stage
    so_far = [task.spec.moved_by(index, task.robot) for index in range(stage.index + 1)]
    is_disturbed = any(moved_by.is_pushed or not moved_by.moves for moved_by in so_far)
    if is_disturbed or task.spec.uncertainty.changes_the_plant or task.spec.body.mass:
        return
    d = task.robot.dimension
    Q, v = initial_state(task)
    masses = np.array([body.mass for body in task.robot.bodies])
    velocity_of_centre = model.momentum(Q, v)[:d] / masses.sum()
    end_times = np.array([forecast.earliest_end, max(task.spec.time_limit, forecast.earliest_end)])
    # where the centre of mass is if the stage ends at the first, and at the last, of these times
    centres = model.centre_of_mass(Q) + end_times[:, None] * velocity_of_centre
    tolerances = {row: tolerance for row, tolerance in tolerances_of(model.space, stage).items() if row < d}
    axes = list(tolerances)
    wanted = stage.target[axes]
    below = centres.min(axis=0)[axes] - wanted
    above = wanted - centres.max(axis=0)[axes]
    distance = float(np.linalg.norm(np.maximum(np.maximum(below, above) - list(tolerances.values()), 0.0)))
    largest_distance = furthest_centre(task.robot, stage.limits)
    if distance > largest_distance * (1 + SLACK) + SLACK:
        message = (
            f"found the base at least {distance:.4g} m from the common centre of mass, which momentum keeps, expected "
            f"at most {largest_distance:.4g} m, with all arms stretched"
        )
        yield Fault(_location_of_part(task, stage, "base", len(stage.reference.points) - 1), message)


def _ends_outside_next_limits(task: Task, stage: Stage, then: Stage) -> Iterator[Fault]:
    """Yield the coordinates that a stage ends with where the limits of the next stage do not allow them."""
    space = configuration_space(task.robot)
    values = coordinates_of(space, stage, stage.target)
    tolerances = tolerances_of(space, stage)
    rows = np.array(sorted(tolerances.keys() - {len(values), *_forbidden_coordinates(stage, values)}), int)
    within = np.array([tolerances[row] for row in rows])
    low, high = bounds_of(then, "position")
    for row in rows[_rows_out_of_bounds(values[rows], low[rows] - within, high[rows] + within)]:
        message = f"{_out_of_bounds_message(task, row, values[row], then)}, where {quoted(then.name)} keeps it"
        yield Fault(("stages", stage.index, "ends_when"), message)


def _singular_postures(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield the nearly singular postures in which a stage begins or ends whose control is the acceleration of poses."""
    if not task.spec.acts_in_task_space:
        return
    stops = forecast_configurations(task, forecasts)
    condition = forecasts[0].model.task_space_condition(np.array(stops))
    for index, forecast in enumerate(forecasts):
        name = quoted(forecast.stage.name)
        before = ("initial",) if index == 0 else ("stages", index - 1, "target")
        for stop, path, does in ((index, before, "begins"), (index + 1, ("stages", index, "target"), "ends")):
            if forecast.stage.input == "task" and condition[stop] > LARGEST_CONDITION:
                message = f"a posture with a condition number of J_C of {condition[stop]:.3g}, in which {name} {does}"
                wanted = f"at most {LARGEST_CONDITION:g} for input task: arms that are bent, not outstretched"
                yield Fault(path, f"found {message}, expected {wanted}")


def _rates_beyond_limits(task: Task, stage: Stage) -> Iterator[Fault]:
    """Yield rates at which a stage is to end that its limits of velocity do not allow."""
    space = configuration_space(task.robot)
    low, high = bounds_of(stage, "velocity")
    names = labels(task.robot, "joint")
    for row, wanted, within in _ends_in_motion(stage):
        is_of_velocity = row < space.n_twist or stage.space == "joint"
        if is_of_velocity and not low[row] - within <= wanted <= high[row] + within:
            limits = _limits_in_words(task, row, stage, "velocity")
            message = f"found {names[row]} at {wanted:g} at the end, expected within its limits of velocity, {limits}"
            yield Fault(("stages", stage.index, "ends_when", "moving"), message)


def _ends_in_motion(stage: Stage) -> Iterator[tuple[int, float, float]]:
    """Yield the rows of an end condition that are to move at the end, their rates, and how near these must be."""
    if len(stage.end.target_rates) and stage.end.rate_tolerance is not None:
        rates = stage.end.target_rates.tolist(), stage.end.rate_tolerance.tolist()
        yield from zip(stage.end.rows, *rates, strict=True)


def _impossible_ends(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield faults of stages that cannot end as the task says.

    They are end conditions that velocity limits never let be met, and fixed times that come before the stage can have
    begun and lasted for its dwell time. A stage begins when the one before it ends; how early that is at best follows
    from velocity limits, dwell times and fixed times (`StageForecast.earliest_end`).

    Args:
        task: The task.
        forecasts: Each stage, with the time before which it cannot end.
    """
    earliest_start = 0.0
    for forecast in forecasts:
        stage = forecast.stage
        path = ("stages", forecast.stage.index)
        yield from _rates_beyond_limits(task, stage)
        yield from _stuck_coordinates(task, forecast)
        if stage.end.latest < earliest_start + stage.end.dwell:
            since = dotted(("stages", stage.index - 1))
            message = f"found {stage.end.latest:g} s, expected later: {since} cannot end before {earliest_start:.4g} s"
            yield Fault((*path, "at"), f"{message} under the velocity limits")
        earliest_start = max(earliest_start, forecast.earliest_end)


def _stuck_coordinates(task: Task, forecast: StageForecast) -> Iterator[Fault]:
    """Yield coordinates that a stage's end condition wants elsewhere, though limits or a mount keep them in place."""
    path = ("stages", forecast.stage.index, "ends_when")
    names = (*labels(task.robot, "joint"), "the attitude of base")
    attitude = len(names) - 1  # number of the attitude of a spatial base, behind the coordinates
    for row in forecast.stuck:
        is_of_base = row < task.robot.parts["base"] or row == attitude
        if is_of_base and not forecast.stage.moved_by.moves:
            yield Fault(path, f"found {names[row]} to be moved, expected it where it is: it is fixed")
            continue
        limits = _limits_in_words(
            task, 3 if row == attitude else row, forecast.stage, "velocity"
        )  # row 3: a first angular rate
        message = f"found {names[row]} to be moved, expected velocity limits that allow it, not {limits}"
        yield Fault(path, message)


def remarks(task: Task, forecasts: Sequence[StageForecast]) -> list[Fault]:
    """Return what is probably not meant in a task that can be done: advice of `psmpc check`, not errors.

    One function yields each kind of remark: targets that want the base elsewhere than the stage before leaves it, poses
    for which no joint coordinates were found, trajectories and time limits that no run can keep, tolerances below the
    noise, loads that outweigh the robot, momentum that carries a robot elsewhere than a stage without thrusters wants
    it, bodies that are nearer than they should keep, weights without effect, and others.

    Args:
        task: The task.
        forecasts: What is known of each stage before a run: the stage, how far its targets are for the arms, how early
            it can end.
    """
    stages = [forecast.stage for forecast in forecasts]
    model = forecasts[0].model
    stops = forecast_configurations(task, forecasts)  # coordinates at the start and at every stage's target
    return [
        *(problem for forecast in forecasts for problem in _out_of_reach(task, forecast, certain=False)),
        *(problem for before, forecast in pairwise(forecasts) for problem in _far_base(task, before.stage, forecast)),
        *(problem for forecast in forecasts for problem in _too_fast(task, forecast.stage)),
        *_too_short(task, forecasts),
        *_below_noise(task, forecasts),
        *_unknown_load(task, forecasts),
        *_early_release(task),
        *_bunched_commands(task),
        *_idle_weights(task),
        *_full_wheels(task, model),
        *_drifts_elsewhere(task, forecasts),
        *_not_routed(task, stages),
        *cone_remarks(task, model, stages),
        *clearance_remarks(task, model, stages, stops),
        *posing_remarks(task, model, stages, stops),
    ]


def _idle_weights(task: Task) -> Iterator[Fault]:
    """Yield weights of a skill that have no effect, since nothing moves the base along their axes in any of its stages.

    Where thrusters push the base, in some stage of the skill, all weights count. Where only wheels turn it, weights of
    its position have no effect; where neither does, weights of its whole pose. That is so for weights of control, force
    and rate; of the weights of the error only those of a position that wheels cannot move are looked at. A weight that
    is a single number for all coordinates means those that something acts on, and is not reported.
    """
    d = task.robot.dimension
    axes = ERROR_AXES[d]
    for name, skill in task.spec.skills.items():
        stages = [index for index, stage in enumerate(task.spec.stages) if stage.skill == name]
        moved_by = [task.spec.moved_by(index, task.robot) for index in stages]
        if not moved_by or any(traits.is_pushed for traits in moved_by):
            continue
        is_turned = any(traits.is_turned for traits in moved_by)
        idle = slice(d if is_turned else len(axes))  # the position, or the whole pose
        idle_axes = ", ".join(axes[idle])
        mobilities = " or ".join(dict.fromkeys(traits.name for traits in moved_by))
        for key in ("control", "force", "rate"):
            weights_by_part = getattr(skill.weights, key)
            base_weights = weights_by_part.get("base", ()) if isinstance(weights_by_part, Mapping) else ()
            if any(base_weights[idle]):
                reason = f"nothing {'pushes' if is_turned else 'moves'} the base where it is {mobilities}"
                message = f"found weights without effect, expected 0 for {idle_axes}, or none: {reason}"
                yield Fault(("skills", name, "weights", key, "base"), message)
        error_weights = skill.weights.parts.get("base", ())
        if is_turned and any(error_weights[:d]):
            message = (
                f"found weights of the base's position, expected 0 for {idle_axes}, or arms that follow it: "
                f"nothing pushes the base where it is {mobilities}"
            )
            yield Fault(("skills", name, "weights", "base"), message)


def _full_wheels(task: Task, model: RobotModel) -> Iterator[Fault]:
    """Yield an angular momentum at the start that is more than reaction wheels can store: the robot would keep turning.

    It is checked where only wheels act on the base in the first stage. Momentum is then conserved: once the base is at
    rest, the wheels store the robot's angular momentum about its common centre of mass and what they store at first.
    """
    wheels = Wheels.of(task.robot)
    first_moved_by = task.spec.moved_by(0, task.robot)
    only_wheels_act = wheels.count > 0 and first_moved_by.is_turned and not first_moved_by.is_pushed
    if not only_wheels_act:
        return
    Q, v = initial_state(task)
    linear, angular = np.split(model.momentum(Q, v), [model.dimension])
    # Momentum about the origin less that of the drifting centre of mass. `np.cross` takes vectors of three: those of a
    # planar robot are filled up with zeros, its momentum being the component along z.
    of_drift = np.cross([*model.centre_of_mass(Q), 0.0][:3], [*linear, 0.0][:3])
    about_centre = [0.0, 0.0, *angular][-3:] - of_drift
    _, quaternion = model.space.to_3d(Q[model.space.base_coordinates])
    along_base = np.array(rotate(conjugate(quaternion), about_centre))[-len(angular) :] + wheels.at_first
    to_store = np.abs(wheels.allocation @ along_base)  # by each wheel [N m s]
    worst = int((to_store / wheels.momentum).argmax())
    capacity = wheels.momentum[worst]
    if to_store[worst] > capacity:
        needs = (
            f"found a start with {to_store[worst]:.3g} N m s for wheel {worst + 1} to store, once the base is at rest"
        )
        message = f"{needs}, expected at most {capacity:g} N m s: what else would stop its turn?"
        yield Fault(("initial_velocity",), message)


def _drifts_elsewhere(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield stages without thrusters that want the base elsewhere than where the robot drifts.

    Such a stage goes on with the momentum that an earlier stage leaves, and that one's end condition decides. Where the
    momentum at the start of the task decides, the base certainly cannot get there, which `_beyond_momentum` reports as
    a fault.
    """
    for drift in drifts(task, forecasts):
        if drift.before is None or not len(drift.displacement):
            continue
        before = drift.before
        path = ("stages", before.index, "ends_when")
        name = quoted(drift.stage.name)
        if not np.isfinite(drift.spread):
            wanted = f"a velocity of the base, or momentum: {{linear: ...}}: nothing pushes it to its place in {name}"
            yield Fault(path, f"found an end of {quoted(before.name)} at any velocity of the base, expected {wanted}")
        elif drift.miss:
            away = " away from it" if drift.displacement @ drift.velocity < 0 else ""
            found = f"found a robot that drifts{away} at {drift.speed:.3g} m/s"
            distance = f"{np.linalg.norm(drift.displacement):.3g} m from where it wants its centre of mass"
            wanted = f"momentum that carries it there, by the {quoted('moving')} of that end: nothing pushes it"
            yield Fault(path, f"{found} in {name}, {distance}, expected {wanted}")


def _not_routed(task: Task, stages: Sequence[Stage]) -> Iterator[Fault]:
    """Yield stages that have no route since places of theirs are not known before the run."""
    for stage, reason in reasons_unforeseen(task.spec, stages).items() if task.spec.routes else ():
        wanted = "what rests: routes are planned before the run, and this stage has none"
        yield Fault(("routes",), f"found stage {quoted(stages[stage].name)}, where {reason}, expected {wanted}")


LARGEST_UNKNOWN_LOAD = 1.0
"""Largest inertia of a load, over the robot's, that the low-level law need not know of.

The robot does 1 / (1 + rho) of what is commanded, see `HeldLoad.largest_ratio`. Optimal state feedback of a linear
system is stable down to half of its gain, which is rho = 1: Safonov, Athans: Gain and phase margin for multiloop LQG
regulators (1977). Beyond, plans count on more than twice the deceleration that there is.
docs/capture_results.md has runs.
"""


def _unknown_load(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield an object so heavy that the low-level law, which does not know of it, moves the robot far too slowly.

    The low-level law computes forces for the accelerations that the controller commands. If it counts with the robot
    alone, and the held object has rho times the inertia of the robot in a motion, only 1 / (1 + rho) of a commanded
    acceleration is left in that motion. The largest rho counts, over the postures at the targets of the stages that
    take and hold the object.

    Args:
        task: The task.
        forecasts: The stages, with how far their targets are for the arms, from which postures are computed.
    """
    target_object = task.spec.body
    if target_object.grasp.known:
        return
    worst = largest_load_ratio(task, forecasts[0].model, forecast_configurations(task, forecasts))
    if worst is None or worst.ratio <= LARGEST_UNKNOWN_LOAD:
        return
    has_armature = not worst.coordinate.startswith("base.")  # of a joint more of it lowers the ratio
    message = (
        f"found false, and an object of {target_object.mass:g} kg that has {worst.ratio:.3g} times the inertia of "
        f"the robot in a motion mostly of {worst.coordinate}, where {quoted(worst.stage)} "
        f"leads: {100 / (1 + worst.ratio):.2g} % of an acceleration commanded there are left, and it settles up to "
        f"{1 + worst.ratio:.3g} times as slowly; expected true, estimated, or a ratio of at most "
        f"{LARGEST_UNKNOWN_LOAD:g}"
        f"{', with the armatures of its joints in the robot file' if has_armature else ''}"
    )
    yield Fault(("object", "grasp", "known"), message)


LARGEST_PRIORITY_OF_RELEASE = 0.01
"""Largest priority of a stage that lets go, over that of the one before it, at which no run opened grippers early.

docs/limits.md has the runs, of horizons from 2 to 12 s.
"""


def _early_release(task: Task) -> Iterator[Fault]:
    """Yield a priority of a stage that lets an object go at which grippers may open while they still carry it.

    Windows before the switch have the costs of that stage too: with a large priority it pays to open the grippers
    early. Only an object without a mass is looked at: there nothing but a monitor watches the hands. Hands that hold an
    object with a mass keep their relative pose by a constraint, whatever the priorities.
    """
    spec = task.spec
    traits = spec.controller.traits
    releasing = spec.held_stages.stop  # index of the stage that lets go
    is_released = 0 < releasing < len(spec.stages)  # not if no stage holds an object, or it is held to the end
    if not is_released or spec.body.mass or traits.one_stage:
        return
    carrying_stage = spec.stages[releasing - 1]
    releasing_stage = spec.stages[releasing]
    carrying_priority = carrying_stage.priority if traits.has_priorities else 1.0
    releasing_priority = releasing_stage.priority if traits.has_priorities else 1.0
    if releasing_priority <= LARGEST_PRIORITY_OF_RELEASE * carrying_priority * (1 + SLACK):
        return
    message = (
        f"found a priority of {releasing_priority:g}, and of {carrying_priority:g} for {quoted(carrying_stage.name)}, "
        f"which carries the object; expected at most {LARGEST_PRIORITY_OF_RELEASE:g} times that: above, "
        f"{quoted(releasing_stage.name)} may open the grippers while they carry"
    )
    yield Fault(("stages", releasing, "priority") if traits.has_priorities else ("controller", "kind"), message)


def _bunched_commands(task: Task) -> Iterator[Fault]:
    """Yield a jitter with which commands often arrive together, or long after the one before."""
    jitter = task.spec.uncertainty.jitter
    half = task.spec.controller.sample_time / 2
    if jitter <= half * (1 + SLACK):
        return
    message = (
        f"found {jitter:g} s, expected at most {half:g} s, half a sample: above, commands arrive in bunches, of which "
        "the last alone acts, and until then the robot applies an old one for longer than any plan has it"
    )
    yield Fault(("uncertainty", "jitter"), message)


def _below_noise(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield end conditions that are met by chance: a tolerance is below three standard deviations of the noise.

    The noise is that of the measurements that the controller counts with. Its standard deviation in each row of an end
    condition (an error of the target) is computed linearly, for the robot at rest at the stage's target. Of each end
    condition the row is reported whose noise is the largest against its tolerance.

    Args:
        task: The task.
        forecasts: The stages, with how far their targets are for the arms, from which postures are computed.
    """
    noise = task.spec.measurement_noise
    if not noise.of_state:
        return
    model = forecasts[0].model
    costs = StageCosts(model)
    deviations = standard_deviations(noise, task.robot)
    at_rest = np.zeros(model.n)
    stages = [forecast.stage for forecast in forecasts]
    _, *Q_at_targets = forecast_configurations(task, forecasts)
    for stage, Q in zip(stages, Q_at_targets, strict=True):
        if not stage.end.rows:
            continue
        placed, x = in_own_chart(model, stage, Q, at_rest)
        three_sigma = 3 * costs.end_deviations(placed, x, deviations)[: len(stage.end.rows)]
        worst = int(np.argmax(three_sigma / stage.end.tolerance))
        if stage.end.tolerance[worst] < three_sigma[worst]:
            name = labels(task.robot, stage.space)[stage.end.rows[worst]]
            message = (
                f"found a tolerance of {stage.end.tolerance[worst]:.3g} for {name}, "
                f"expected at least {three_sigma[worst]:.2g}, three standard deviations of its measurement: "
                "when the stage ends depends on the noise"
            )
            yield Fault(("stages", stage.index, "ends_when"), message)


def _too_short(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield a time limit that stops every run before its last stage can end."""
    earliest = max(forecast.earliest_end for forecast in forecasts)
    if earliest > task.spec.time_limit:
        message = (
            f"found {task.spec.time_limit:g} s, expected at least {earliest:.4g} s: "
            f"{quoted(forecasts[-1].stage.name)} cannot end before under the velocity limits"
        )
        yield Fault(("time_limit",), message)


def _far_base(task: Task, before: Stage, then: StageForecast) -> Iterator[Fault]:
    """Yield a target that wants the base elsewhere than the stage before leaves it, where an arm could not reach.

    The arm reaches its own target from the one pose of the base and not from the other: one of the two may be a
    misprint. Only arms at poses are looked at, and no stages in which the base reacts to the arms.

    Args:
        task: The task.
        before: The stage before; nothing is said unless its end condition has all coordinates of the base.
        then: Forecast of the stage that follows, with how far its targets are for the arms.
    """
    d = task.robot.dimension
    stage = then.stage
    if stage.moved_by.reacts:
        return
    first_waypoint = stage.reference.points[0]
    base_left = before.target[configuration_space(task.robot).base_coordinates]
    if not set(range(task.robot.parts["base"])) <= set(before.end.rows):
        return
    from_target = then.reaches_at_waypoints[0]  # reaches with the base where the target has it, and where it is left
    from_left = reaches_of(stage, then.model, first_waypoint, base_left)
    out_of_reach = [
        arm for arm, reach in from_left.items() if reach.distance > reach.full_reach and not reach.reachable
    ]
    if not out_of_reach:
        return
    arm = out_of_reach[0]  # one is enough for the message
    if from_target[arm].reachable:
        distance = np.linalg.norm(first_waypoint[:d] - base_left[:d])
        message = (
            f"found the base {distance:.4g} m from where {quoted(before.name)} leaves it, "
            f"expected it there: the target of {arm} is then {from_left[arm].distance:.4g} m from its shoulder, "
            f"its reach is {from_left[arm].full_reach:.4g} m"
        )
        yield Fault(_location_of_part(task, stage, "base", 0), message)


def _too_fast(task: Task, stage: Stage) -> Iterator[Fault]:
    """Warn of coordinates that a target trajectory moves faster than their velocity limits, each where it is worst.

    It is only a warning: the robot falls behind the trajectory and catches up later. Between its times a trajectory
    moves at a constant rate; an attitude turns at a constant rate about a fixed axis. Some coordinates are left out:
    joints under a target in task space, which has no values for them (NaN), and coordinates that neither the weights
    nor the end condition of the stage ask for.
    """
    target = task.spec.stages[stage.index].target
    if not isinstance(target, TrajectorySpec):
        return
    times = np.array(target.times)
    low, high = bounds_of(stage, "velocity")
    space = configuration_space(task.robot)
    coordinates = np.array([coordinates_of(space, stage, waypoint) for waypoint in stage.reference.points])
    changes = np.diff(coordinates, axis=0)  # of position and joints; a spatial base's attitude is set below
    if stage.attitudes:
        # quaternions (4, waypoints): every target begins with the base's pose, as Q does
        q = stage.reference.points[:, space.attitude].T
        before = list(q[:, :-1])  # by component, as `product` takes them
        after = list(q[:, 1:])
        # rotation vectors about the body's axes: of two neighbouring quaternions `Trajectory` has the nearer signs
        changes[:, space.rotation] = np.transpose(log(product(conjugate(before), after)))
    rates = changes / np.diff(times)[:, None]
    has_target = np.isfinite(changes).all(axis=0)
    for i in np.flatnonzero(has_target).tolist():
        excess = np.maximum(rates[:, i] - high[i], low[i] - rates[:, i])
        worst = int(excess.argmax())
        if excess[worst] > SPEED_SLACK and is_asked_for(stage, [i]):
            name = labels(task.robot, "joint")[i]
            rate = _with_unit(task, i, rates[worst, i], "velocity")
            message = (
                f"found {name} to move at {rate} from {times[worst]:g} s to {times[worst + 1]:g} s, expected within "
                f"its velocity limits {_limits_in_words(task, i, stage, 'velocity')}: the robot falls behind"
            )
            yield Fault(_location(task, stage, i, worst + 1), message)


def _rows_out_of_bounds(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Return the rows whose values are below `low` or above `high` by more than `SLACK`."""
    return [int(row) for row in np.flatnonzero((values < low - SLACK) | (values > high + SLACK))]


def _out_of_bounds_message(task: Task, row: int, value: float, stage: Stage, kind: str = "position") -> str:
    """Return the message that a coordinate is out of a stage's bounds."""
    name = labels(task.robot, "joint")[row]
    value_text = _with_unit(task, row, value, kind)
    return f"found {name} at {value_text}, expected within its limits {_limits_in_words(task, row, stage, kind)}"


def _with_unit(task: Task, row: int, value: float, kind: str) -> str:
    """Write the position or velocity of a coordinate with its unit, angles in degrees."""
    written = f"{value:.6g} m" if units(task.robot)[row] == LENGTH else f"{np.degrees(value):.6g} deg"
    return written if kind == "position" else f"{written}/s"


def _limits_in_words(task: Task, row: int, stage: Stage, kind: str) -> str:
    """Write a stage's bounds of a coordinate with their unit."""
    low, high = (_with_unit(task, row, bound[row], kind) for bound in bounds_of(stage, kind))
    return f"[{low}, {high}]"


def _location(task: Task, of: Stage | Location, row: int, index: int = 0) -> Location:
    """Return where a coordinate is in numbers by part, of a stage's target at one of its waypoints."""
    names = labels(task.robot, "joint")
    part = names[row].rpartition(".")[0]
    before = sum(name.rpartition(".")[0] == part for name in names[:row])
    return (*_location_of_part(task, of, part, index), before)


def _location_of_part(task: Task, of: Stage | Location, part: str, index: int = 0) -> Location:
    """Return where the numbers of a part are, under its own name or under `arms`; of a trajectory at a waypoint."""
    parts = ("stages", of.index, "target") if isinstance(of, Stage) else of
    under_own_name = (*parts, part)
    path = under_own_name if under_own_name in task.source.origins or part == "base" else (*parts, "arms")
    return (*path, index) if isinstance(of, Stage) and of.reference.moves else path
