"""Whether a task can be done, as far as can be decided before anything is solved: limits, reach, order of events."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.forecast import (
    StageForecast,
    bounds_of,
    coordinates_of,
    counts,
    forecast_configurations,
    forecast_stages,
    initial_state,
    reaches_of,
    tolerances_of,
)
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.posing import posing_remarks
from psmpc_cli.ocp.postures import largest_load_ratio, unforeseen
from psmpc_cli.ocp.problem import in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.targets import clearance_remarks, cone_remarks, monitor_faults
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import configuration_space
from psmpc_cli.robot.dynamics import LARGEST_CONDITION
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import furthest_centre
from psmpc_cli.robot.rotations import conjugate, log, product, rotate
from psmpc_cli.specs.arguments import require
from psmpc_cli.specs.document import Changes, Fault, Location, dotted, quoted
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.load import load_task as load_valid_task
from psmpc_cli.specs.parts import ERROR_AXES, LENGTH
from psmpc_cli.specs.robot import labels, units
from psmpc_cli.specs.task import TrajectorySpec
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
    """Load a task and its robot, and make sure that nothing stands against it: what `psmpc check` rejects is an error.

    Args:
        reference: The name of a built-in task, the path of a file, or the task itself as a mapping of its keys.
        set: Keys of the task to change: a mapping of paths to values, such as `{"controller.nodes": "auto"}` or
            `{"stages.capture.priority": 10}`, or a sequence of texts `path=value` and options short for them.
        feasibility: Whether start and targets within limits, poses within reach and the order of events count too,
            which takes up to a second for long tasks of spatial robots. Without it a task that no run can complete
            is loaded, and runs as it is.

    Raises:
        InputError: The reference or the changes are of another type.
        SpecError: Something is wrong with the task, the robot's file or a change, or stands against the task; the
            message lists all of it, located in the task's file.
    """
    require("feasibility", feasibility, bool, "True or False")
    task = load_valid_task(reference, set)
    return ensure_feasible(task) if feasibility else task


def ensure_feasible(task: Task) -> Task:
    """Return a task if nothing stands against it.

    Raises:
        SpecError: Something does; the message has all of it, located in the task's file.
    """
    if problems := review(task):
        raise SpecError(task.source.report(problems))
    return task


def review(task: Task) -> list[Fault]:
    """Return everything that stands against a task."""
    forecasts = forecast_stages(task)
    return [
        *_initial(task, forecasts[0].stage),
        *(problem for forecast in forecasts for problem in _targets(task, forecast.stage)),
        *(problem for forecast in forecasts for problem in _beyond_momentum(task, forecast)),
        *(problem for forecast in forecasts for problem in _out_of_reach(task, forecast, certain=True)),
        *(problem for now, then in pairwise(forecasts) for problem in _handover(task, now.stage, then.stage)),
        *_times(task, forecasts),
        *_singular_postures(task, forecasts),
        *_grasps(task, forecasts),
        *monitor_faults(task, forecasts[0].model),
    ]


def _grasps(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Yield faults of a capture whose end condition or targets do not guarantee the grippers' envelope."""
    target_object = task.spec.body
    stage = forecasts[task.spec.held_stages.start - 1].stage
    poses = stage.poses_of_arms
    if not (target_object.mass and stage.end.rows and set(target_object.grippers) <= set(poses)):
        return
    envelope = target_object.grasp.envelope

    def norms(motion: np.ndarray) -> list[float]:
        return [float(np.linalg.norm(part)) for part in np.split(motion, [task.robot.dimension])]

    space = configuration_space(task.robot)
    tolerance = np.full(len(stage.weights), np.inf)
    tolerance[list(stage.end.rows)] = stage.end.tolerance
    rate = np.full(len(stage.weights), np.inf)
    if stage.end.rate_tolerance is not None:
        rate[list(stage.end.rows)] = stage.end.rate_tolerance
    widths = dict[str, list[float]]()
    for arm, at in target_object.grasp.at.items():
        rows = stage.parts[arm].rows
        widths[arm] = norms(tolerance[rows]) + norms(rate[rows])
        metres, angle = norms(space.pose_error(poses[arm], space.composed(target_object.pose, at)))
        fixed = not (target_object.motion.moves or arm in stage.on_object)
        if fixed and (metres > envelope.position or angle > envelope.angle):
            far = f"{metres:.3g} m and {np.degrees(angle):.3g} deg"
            message = f"found a pose {far} from where {quoted(stage.name)} leads {arm}, expected it there"
            yield Fault(("object", "grasp", "at", arm), message)
    for row, (key, unit) in enumerate(ENVELOPE.items()):
        width, arm = max((values[row], arm) for arm, values in widths.items())
        allowed = getattr(envelope, key)
        if width > allowed * (1 + SLACK):
            arrives = f"lets {arm} arrive within {width:.3g} {unit}" if np.isfinite(width) else f"does not bound {arm}"
            message = (
                f"found {allowed:.3g} {unit}, expected no less than {quoted(stage.name)} ends with, which {arrives}"
            )
            yield Fault(("object", "grasp", "envelope", key), message)


def _initial(task: Task, first: Stage) -> Iterator[Fault]:
    """Give what of the initial state the first stage does not allow."""
    Q, v = initial_state(task)
    space = configuration_space(task.robot)
    position = coordinates_of(space, first, Q)
    for key, kind, values in (("initial", "position", position), ("initial_velocity", "velocity", v)):
        for row in _outside(values, *bounds_of(first, kind)):
            yield Fault(_place(task, (key,), row), _beyond(task, row, values[row], first, kind))


def _targets(task: Task, stage: Stage) -> Iterator[Fault]:
    """Give what of a stage's target, or of any row of its trajectory, lies outside its limits."""
    space = configuration_space(task.robot)
    for index, waypoint in enumerate(stage.reference.points):
        values = coordinates_of(space, stage, waypoint)
        for row in _rows_outside(stage, values):
            yield Fault(_place(task, stage, row, index), _beyond(task, row, values[row], stage))


def _rows_outside(stage: Stage, values: np.ndarray) -> list[int]:
    """Return the coordinates whose values (n,) the stage asks for but its limits forbid."""
    return [row for row in _outside(values, *bounds_of(stage, "position")) if counts(stage, [row])]


def _out_of_reach(task: Task, forecast: StageForecast, certain: bool) -> Iterator[Fault]:
    """Give the poses that an arm is_proven cannot take, or those that it perhaps can, though it was not found how.

    Where joint coordinates were looked for and none were found, that is certain of short planar arms alone.
    """
    robot = task.robot
    for index, (waypoint, reaches) in enumerate(zip(forecast.stage.reference.points, forecast.along, strict=True)):
        base = f"with the base at {configuration_space(robot).format_pose(waypoint)}"
        for arm, reach in reaches.items():
            is_proven = True
            far = f"{reach.distance:.4g} m from"
            if reach.reachable:
                continue
            if reach.distance > reach.full_reach:
                message = (
                    f"a pose {far} the shoulder of {arm} {base}, expected at most its reach of {reach.full_reach:.4g} m"
                )
            elif not reach.within_annulus:
                message = (
                    f"a pose that puts the last joint {reach.wrist_distance:.4g} m from the shoulder of {arm} {base}, "
                    f"expected between {reach.inner:.4g} and {reach.outer:.4g} m, the reach of the links before the "
                    "last"
                )
            elif is_proven := robot.dimension == 2 and len(robot.arms[arm].links) <= ALL_KNOWN:
                message = (
                    f"a pose that {arm} can take only beyond its joint limits {base} ({far} its shoulder, within its "
                    f"reach of {reach.full_reach:.4g} m), expected one within them"
                )
            else:
                metres = reach.missed[0]
                angle = np.degrees(reach.missed[1])
                message = (
                    f"no joint coordinates of {arm} within their limits that take the pose {base}: the nearest misses "
                    f"it by {metres:.2g} m and {angle:.2g} deg, expected a pose within reach, or weights and an end "
                    "condition that do not ask for all of it"
                )
            if is_proven == certain:
                yield Fault(_place_of_part(task, forecast.stage, arm, index), f"found {message}")


def _beyond_momentum(task: Task, forecast: StageForecast) -> Iterator[Fault]:
    """Give where an end condition wants a floating base, though no posture and no momentum of the start lead there.

    The common centre of mass moves at p / M, from when the stage can end to when the run does. Only differences along
    each axis are compared, so that what is given is certain. After a stage in which the base is pushed nothing is.
    """
    model = forecast.model
    stage = forecast.stage
    pushed = any(task.spec.moved_by(index, task.robot).is_pushed for index in range(stage.index + 1))
    if pushed or not task.robot.moved_by.moves or task.spec.uncertainty.changes_the_plant or task.spec.body.mass:
        return
    d = task.robot.dimension
    Q, v = initial_state(task)
    masses = np.array([body.mass for body in task.robot.bodies])
    rate = model.momentum(Q, v)[:d] / masses.sum()
    times = np.array([forecast.earliest_end, max(task.spec.time_limit, forecast.earliest_end)])
    centre = model.centre_of_mass(Q) + times[:, None] * rate
    within = {row: tolerance for row, tolerance in tolerances_of(model.space, stage).items() if row < d}
    asked = list(within)
    wanted = stage.target[asked]
    below = centre.min(axis=0)[asked] - wanted
    above = wanted - centre.max(axis=0)[asked]
    distance = float(np.linalg.norm(np.maximum(np.maximum(below, above) - list(within.values()), 0.0)))
    most = furthest_centre(task.robot, stage.limits)
    if distance > most * (1 + SLACK) + SLACK:
        message = (
            f"found the base at least {distance:.4g} m from the common centre of mass, which momentum keeps, expected "
            f"at most {most:.4g} m, with all arms stretched"
        )
        yield Fault(_place_of_part(task, stage, "base", len(stage.reference.points) - 1), message)


def _handover(task: Task, stage: Stage, then: Stage) -> Iterator[Fault]:
    """Give the coordinates that a stage leaves where the limits of the next one do not allow them."""
    space = configuration_space(task.robot)
    values = coordinates_of(space, stage, stage.target)
    tolerances = tolerances_of(space, stage)
    rows = np.array(sorted(tolerances.keys() - {len(values), *_rows_outside(stage, values)}), int)
    within = np.array([tolerances[row] for row in rows])
    low, high = bounds_of(then, "position")
    for row in rows[_outside(values[rows], low[rows] - within, high[rows] + within)]:
        message = f"{_beyond(task, row, values[row], then)}, where {quoted(then.name)} keeps it"
        yield Fault(("stages", stage.index, "ends_when"), message)


def _singular_postures(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Give the nearly singular postures in which a stage begins or ends whose control is the acceleration of poses."""
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
    """Give rates at which a stage is to end that its limits of velocity do not allow."""
    space = configuration_space(task.robot)
    low, high = bounds_of(stage, "velocity")
    names = labels(task.robot, "joint")
    for row, wanted, within in _ends_in_motion(stage):
        is_of_velocity = row < space.n_twist or stage.space == "joint"
        if is_of_velocity and not low[row] - within <= wanted <= high[row] + within:
            limits = _span(task, row, stage, "velocity")
            message = f"found {names[row]} at {wanted:g} at the end, expected within its limits of velocity, {limits}"
            yield Fault(("stages", stage.index, "ends_when", "moving"), message)


def _ends_in_motion(stage: Stage) -> Iterator[tuple[int, float, float]]:
    """Yield the rows of an end condition that are to move at the end, their rates, and how near these must be."""
    if len(stage.end.target_rates) and stage.end.rate_tolerance is not None:
        rates = stage.end.target_rates.tolist(), stage.end.rate_tolerance.tolist()
        yield from zip(stage.end.rows, *rates, strict=True)


def _times(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Give end conditions that can never be met, and times that are too early for what comes before them."""
    before = 0.0
    for forecast in forecasts:
        stage = forecast.stage
        path = ("stages", forecast.stage.index)
        yield from _rates_beyond_limits(task, stage)
        for row in forecast.stuck:
            names = (*labels(task.robot, "joint"), "the attitude of base")
            is_of_base = row < task.robot.parts["base"] or row == len(names) - 1
            if is_of_base and not task.robot.moved_by.moves:
                yield Fault(
                    (*path, "ends_when"), f"found {names[row]} to be moved, expected it where it is: it is fixed"
                )
                continue
            limits = _span(task, row if row < len(names) - 1 else 3, stage, "velocity")
            message = f"found {names[row]} to be moved, expected velocity limits that allow it, not {limits}"
            yield Fault((*path, "ends_when"), message)
        if stage.end.latest < before + stage.end.dwell:
            since = dotted(("stages", stage.index - 1))
            message = f"found {stage.end.latest:g} s, expected later: {since} cannot end before {before:.4g} s"
            yield Fault((*path, "at"), f"{message} under the velocity limits")
        before = max(before, forecast.earliest_end)


def remarks(task: Task, forecasts: Sequence[StageForecast]) -> list[Fault]:
    """Return what is probably not meant.

    A base kept where it is not left, poses out of reach, trajectories the robot cannot follow, a time limit no run can
    keep, tolerances below the noise, a load that outweighs a robot which does not know of it, grippers that may open
    while they carry, commands that arrive in bunches, weights of what nothing acts on, more momentum than wheels store,
    parts that are nearer than the task keeps them, arms that could be posed for the next stage.
    """
    stages = [forecast.stage for forecast in forecasts]
    model = forecasts[0].model
    stops = forecast_configurations(task, forecasts)
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
        *_not_routed(task, stages),
        *cone_remarks(task, model, stages),
        *clearance_remarks(task, model, stages, stops),
        *posing_remarks(task, model, stages, stops),
    ]


def _idle_weights(task: Task) -> Iterator[Fault]:
    """Yield weights of a base that nothing turns, or pushes, in any stage of their skill: they have no effect.

    One number for all coordinates means those that something acts on.
    """
    axes = ERROR_AXES[task.robot.dimension]
    for name, skill in task.spec.skills.items():
        stages = [index for index, stage in enumerate(task.spec.stages) if stage.skill == name]
        moved_by = [task.spec.moved_by(index, task.robot) for index in stages]
        if not moved_by or any(traits.is_pushed for traits in moved_by):
            continue
        is_turned = any(traits.is_turned for traits in moved_by)
        idle = slice(task.robot.dimension if is_turned else len(axes))
        mobilities = " or ".join(dict.fromkeys(traits.name for traits in moved_by))
        for key in ("control", "force", "rate"):
            by_part = getattr(skill.weights, key)
            given = by_part.get("base", ()) if isinstance(by_part, Mapping) else ()
            if any(given[idle]):
                wanted = (
                    f"0 for {', '.join(axes[idle])}, or none: nothing {'pushes' if is_turned else 'moves'} the base"
                )
                found = f"found weights without effect, expected {wanted} where it is {mobilities}"
                yield Fault(("skills", name, "weights", key, "base"), found)
        given = skill.weights.parts.get("base", ())
        if is_turned and any(given[: task.robot.dimension]):
            found = (
                f"found weights of the base's position, expected 0 for {', '.join(axes[idle])}, or arms that follow it"
            )
            yield Fault(
                ("skills", name, "weights", "base"), f"{found}: nothing pushes the base where it is {mobilities}"
            )


def _full_wheels(task: Task, model: RobotModel) -> Iterator[Fault]:
    """Yield an angular momentum of the start that wheels cannot store: a robot that nothing pushes keeps turning."""
    wheels = Wheels.of(task.robot)
    first = task.spec.moved_by(0, task.robot)
    if not wheels.count or first.is_pushed or not first.is_turned:
        return
    Q, v = initial_state(task)
    linear, angular = np.split(model.momentum(Q, v), [model.dimension])
    of_drift = np.cross([*model.centre_of_mass(Q), 0.0][:3], [*linear, 0.0][:3])
    about_centre = [0.0, 0.0, *angular][-3:] - of_drift
    _, quaternion = model.space.to_3d(Q[model.space.base_coordinates])
    along_base = np.array(rotate(conjugate(quaternion), about_centre))[-len(angular) :] + wheels.at_first
    stored = np.abs(wheels.allocation @ along_base)
    worst = int((stored / wheels.momentum).argmax())
    most = wheels.momentum[worst]
    if stored[worst] > most:
        found = f"found a start with {stored[worst]:.3g} N m s for wheel {worst + 1} to store, once the base is at rest"
        yield Fault(("initial_velocity",), f"{found}, expected at most {most:g} N m s: what else would stop its turn?")


def _not_routed(task: Task, stages: Sequence[Stage]) -> Iterator[Fault]:
    """Yield stages that have no route since places of theirs are not known before the run."""
    for stage, reason in unforeseen(task.spec, stages).items() if task.spec.routes else ():
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
    """Yield a load that outweighs the robot in some motion, where the low-level law does not know of it."""
    target_object = task.spec.body
    if target_object.grasp.known:
        return
    largest = largest_load_ratio(task, forecasts[0].model, forecast_configurations(task, forecasts))
    if largest is None or largest.ratio <= LARGEST_UNKNOWN_LOAD:
        return
    has_armature = not largest.coordinate.startswith("base.")
    message = (
        f"found false, and an object of {target_object.mass:g} kg that has {largest.ratio:.3g} times the inertia of "
        f"the robot in a motion mostly of {largest.coordinate}, where {quoted(largest.stage)} "
        f"leads: {100 / (1 + largest.ratio):.2g} % of an acceleration commanded there are left, and it settles up to "
        f"{1 + largest.ratio:.3g} times as slowly; expected true, estimated, or a ratio of at most "
        f"{LARGEST_UNKNOWN_LOAD:g}"
        f"{', with the armatures of its joints in the robot file' if has_armature else ''}"
    )
    yield Fault(("object", "grasp", "known"), message)


LARGEST_PRIORITY_OF_RELEASE = 0.01
"""Largest priority of a stage that lets go, over that of the one before it, at which no run opened grippers early.

docs/limits.md has the runs, of horizons from 2 to 12 s.
"""


def _early_release(task: Task) -> Iterator[Fault]:
    """Yield a priority at which grippers may open while they carry: of an object that is a picture, held by a monitor.

    Hands that hold an object with a mass keep their relative pose, whatever the priorities.
    """
    spec = task.spec
    traits = spec.controller.traits
    names = [stage.name for stage in spec.stages]
    last = spec.held_stages.stop
    if not 0 < last < len(names) or spec.body.mass or traits.one_stage:
        return
    carrying, letting_go = (
        stage.priority if traits.has_priorities else 1.0 for stage in spec.stages[last - 1 : last + 1]
    )
    if letting_go <= LARGEST_PRIORITY_OF_RELEASE * carrying * (1 + SLACK):
        return
    message = (
        f"found a priority of {letting_go:g}, and of {carrying:g} for {quoted(names[last - 1])}, which carries the "
        f"object; expected at most {LARGEST_PRIORITY_OF_RELEASE:g} times that: above, "
        f"{quoted(names[last])} may open the grippers while they carry"
    )
    yield Fault(("stages", last, "priority") if traits.has_priorities else ("controller", "kind"), message)


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
    """Yield end conditions that measurements meet or miss by chance: a tolerance below 3 sigma of its row.

    The noise is that which the controller counts with; its effect on a row is that at the stage's target.
    """
    noise = task.spec.measurement_noise
    if not noise.of_state:
        return
    model = forecasts[0].model
    costs = StageCosts(model)
    deviations = standard_deviations(noise, task.robot)
    at_rest = np.zeros(model.n)
    for stage, Q in zip(
        [forecast.stage for forecast in forecasts], forecast_configurations(task, forecasts)[1:], strict=True
    ):
        if not stage.end.rows:
            continue
        placed, x = in_own_chart(model, stage, Q, at_rest)
        least = 3 * costs.end_deviations(placed, x, deviations)[: len(stage.end.rows)]
        worst = int(np.argmax(least / stage.end.tolerance))
        if stage.end.tolerance[worst] < least[worst]:
            name = labels(task.robot, stage.space)[stage.end.rows[worst]]
            message = (
                f"found a tolerance of {stage.end.tolerance[worst]:.3g} for {name}, "
                f"expected at least {least[worst]:.2g}, three standard deviations of its measurement: "
                "when the stage ends depends on the noise"
            )
            yield Fault(("stages", stage.index, "ends_when"), message)


def _too_short(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Fault]:
    """Give a time limit that stops every run before its last stage can end."""
    earliest = max(forecast.earliest_end for forecast in forecasts)
    if earliest > task.spec.time_limit:
        message = (
            f"found {task.spec.time_limit:g} s, expected at least {earliest:.4g} s: "
            f"{quoted(forecasts[-1].stage.name)} cannot end before under the velocity limits"
        )
        yield Fault(("time_limit",), message)


def _far_base(task: Task, before: Stage, then: StageForecast) -> Iterator[Fault]:
    """Give a base that a stage in task space wants elsewhere than the stage before leaves it.

    And so far that an arm does not reach its first pose from there: one of the two may be a misprint. Not of a base
    that the arms or its momentum move in the stage.
    """
    d = task.robot.dimension
    stage = then.stage
    if stage.moved_by.reacts:
        return
    first = stage.reference.points[0]
    left = before.target[configuration_space(task.robot).base_coordinates]
    if not set(range(task.robot.parts["base"])) <= set(before.end.rows):
        return
    begins_at = then.along[0]
    moved = reaches_of(stage, then.model, first, left)
    far = [arm for arm, reach in moved.items() if reach.distance > reach.full_reach and not reach.reachable]
    for arm in (arm for arm in far[:1] if begins_at[arm].reachable):
        message = (
            f"found the base {np.linalg.norm(first[:d] - left[:d]):.4g} m from where {quoted(before.name)} leaves it, "
            f"expected it there: the target of {arm} is then {moved[arm].distance:.4g} m from its shoulder, "
            f"its reach is {moved[arm].full_reach:.4g} m"
        )
        yield Fault(_place_of_part(task, stage, "base", 0), message)


def _too_fast(task: Task, stage: Stage) -> Iterator[Fault]:
    """Remark on coordinates of Q that a trajectory moves faster than their velocity limits, each where it is worst.

    The robot then falls behind and catches up, which is allowed. Between its times a trajectory moves at a constant
    rate; an attitude turns at a constant rate about a fixed axis. Coordinates without a target, such as joints under a
    target in task space, are NaN and left out. So are those that neither the stage's weights nor its end condition ask
    for.
    """
    target = task.spec.stages[stage.index].target
    if not isinstance(target, TrajectorySpec):
        return
    times = np.array(target.times)
    low, high = bounds_of(stage, "velocity")
    space = configuration_space(task.robot)
    at_times = np.array([coordinates_of(space, stage, waypoint) for waypoint in stage.reference.points])
    changes = np.diff(at_times, axis=0)  # of position and joints; a spatial base's attitude is set below
    if stage.attitudes:
        q = stage.reference.points[:, space.attitude].T  # every target begins with the base's pose, as Q does
        before = list(q[:, :-1])
        after = list(q[:, 1:])
        # rotation vectors about the body's axes: of two neighbouring quaternions `Trajectory` has the nearer signs
        changes[:, space.rotation] = np.transpose(log(product(conjugate(before), after)))
    rates = changes / np.diff(times)[:, None]
    for i in np.flatnonzero(np.isfinite(changes).all(axis=0)).tolist():
        excess = np.maximum(rates[:, i] - high[i], low[i] - rates[:, i])
        worst = int(excess.argmax())
        if excess[worst] > SPEED_SLACK and counts(stage, [i]):
            name = labels(task.robot, "joint")[i]
            rate = _number(task, i, rates[worst, i], "velocity")
            message = (
                f"found {name} to move at {rate} from {times[worst]:g} s to {times[worst + 1]:g} s, expected within "
                f"its velocity limits {_span(task, i, stage, 'velocity')}: the robot falls behind"
            )
            yield Fault(_place(task, stage, i, worst + 1), message)


def _outside(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Return the rows whose values are out of bounds."""
    return [int(row) for row in np.flatnonzero((values < low - SLACK) | (values > high + SLACK))]


def _beyond(task: Task, row: int, value: float, stage: Stage, kind: str = "position") -> str:
    """Say that a coordinate is out of a stage's bounds."""
    name = labels(task.robot, "joint")[row]
    value_text = _number(task, row, value, kind)
    return f"found {name} at {value_text}, expected within its limits {_span(task, row, stage, kind)}"


def _number(task: Task, row: int, value: float, kind: str) -> str:
    """Write the position or velocity of a coordinate with its unit, angles in degrees."""
    written = f"{value:.6g} m" if units(task.robot)[row] == LENGTH else f"{np.degrees(value):.6g} deg"
    return written if kind == "position" else f"{written}/s"


def _span(task: Task, row: int, stage: Stage, kind: str) -> str:
    """Write a stage's bounds of a coordinate with their unit."""
    low, high = (_number(task, row, bound[row], kind) for bound in bounds_of(stage, kind))
    return f"[{low}, {high}]"


def _place(task: Task, of: Stage | Location, row: int, index: int = 0) -> Location:
    """Return where a coordinate is in numbers by part, of a stage's target at one of its waypoints."""
    names = labels(task.robot, "joint")
    part = names[row].rpartition(".")[0]
    before = sum(name.rpartition(".")[0] == part for name in names[:row])
    return (*_place_of_part(task, of, part, index), before)


def _place_of_part(task: Task, of: Stage | Location, part: str, index: int = 0) -> Location:
    """Return where the numbers of a part are, under its own name or under `arms`; of a trajectory at a waypoint."""
    parts = ("stages", of.index, "target") if isinstance(of, Stage) else of
    under_own_name = (*parts, part)
    path = under_own_name if under_own_name in task.source.origins or part == "base" else (*parts, "arms")
    return (*path, index) if isinstance(of, Stage) and of.reference.moves else path
