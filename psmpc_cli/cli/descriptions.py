"""What `psmpc check` prints of robots and tasks: their tables of parts, stages, limits, actuators and objects."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import count, groupby, starmap, zip_longest
from json import dumps

import numpy as np

from psmpc_cli.cli.common import echo
from psmpc_cli.cli.tables import Row, print_table
from psmpc_cli.ocp.feasibility.checks import LARGEST_UNKNOWN_LOAD
from psmpc_cli.ocp.feasibility.drift import drifts
from psmpc_cli.ocp.feasibility.forecast import StageForecast, forecast_configurations, initial_state
from psmpc_cli.ocp.feasibility.postures import ArmPosture, arm_postures, largest_load_ratio
from psmpc_cli.ocp.feasibility.targets import shut_thrusters
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.geometry import pieces_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.document import counted, plain
from psmpc_cli.specs.fields import Spec
from psmpc_cli.specs.geometry import ShapeSpec, pair_name
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.object import GRASP_LOADS, ObjectSpec
from psmpc_cli.specs.parts import ANGLE, ERROR_AXES, LENGTH, QUANTITIES, TARGET_AXES, axes_of, units_of
from psmpc_cli.specs.priorities import ACCEPTABLE, weigh
from psmpc_cli.specs.robots.robot import PartLimits, RobotSpec, SpatialRobot, labels, resolve_limits, units
from psmpc_cli.specs.stages import MomentumEndSpec, ObjectEndSpec, TrajectorySpec
from psmpc_cli.specs.task import PrioritiesSpec, TaskSpec


def print_task(task: Task, forecasts: Sequence[StageForecast]) -> None:
    """Print a task as `psmpc check` shows it before a run, so that its author sees how psmpc has understood it.

    The first lines name robot, controller, solver and plant, the priorities and the uncertainty. A table of the stages
    follows, with a row for each part of the robot, the base or an arm. The sections after it are printed only for tasks
    to which they apply: postures of the arms at targets, limits of forces, thrusters, turns of the base by reaction
    wheels, drifts of the base that nothing pushes, clearance, and the object.

    Args:
        task: The valid task.
        forecasts: What is known of each of its stages before the run, in their order.
    """
    spec = task.spec
    controller = spec.controller
    echo(f"{spec.name}: {spec.description}" if spec.description else spec.name)
    echo(
        f"robot {task.robot.name}{_describe_mobility(task.robot)}; "
        f"controller {controller.kind}, horizon {controller.horizon:g} s, {controller.nodes} nodes a stage, "
        f"sample time {controller.sample_time:g} s; "
        f"solver {spec.solver.kind}; plant {spec.plant.kind}"
    )
    if spec.priorities is not None:
        echo(_describe_priorities(spec.priorities, [stage.name for stage in spec.stages]))
    if spec.uncertainty.in_force:
        echo(f"uncertain, seed {spec.seed}, delay {_describe_known_delay(task)}:")
        echo("\n".join(f"  {line}" for line in _lines_of_changed_keys(spec.uncertainty, "uncertainty")))
    headings = ("stage", "part", "target", "ends within", "distance of reach", "not before")
    stage_rows = [row for forecast in forecasts for row in _stage_rows(task, forecast)]
    print_table(headings, stage_rows, left_aligned=len(headings))
    model = forecasts[0].model
    stages = [forecast.stage for forecast in forecasts]
    configurations = forecast_configurations(task, forecasts)  # at the start, then at the end of each stage
    if rows := [_posture_row(task.robot, posture) for posture in arm_postures(model, stages, configurations)]:
        echo()
        print_table(("at the target of", "arm", "joints", "end-effector"), rows, left_aligned=4)
    # of the limits only those of forces, the last column; coordinates without such a limit have an empty cell
    if limits := [(coordinate, force) for coordinate, *_, force in _limit_rows(task.robot, spec.limits) if force]:
        echo()
        print_table(("coordinate", "limit of force, of robot and task"), limits, left_aligned=2)
    if spec.fires(task.robot):
        echo()
        echo(_describe_thrusters(task.robot))
        if shut := shut_thrusters(task, model, stages, configurations):
            echo(f"shut at the target, because of plumes: {'; '.join(starmap(_describe_shut_thrusters, shut.items()))}")
    if rows := list(_wheel_turn_rows(task, model, stages)):
        echo()
        print_table(TURN_HEADINGS, rows, left_aligned=1)
    if sentences := list(_describe_drifts(task, forecasts)):
        echo()
        echo("\n".join(sentences))
    if rows := [*_obstacle_rows(spec), *_clearance_rows(task)]:
        echo()
        print_table(("clearance", ""), rows)
    if spec.object is not None:
        echo()
        print_table(("object", ""), [*_object_rows(spec.object), *_unknown_load_rows(task, model, configurations)])


def _describe_drifts(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[str]:
    """Yield a sentence for each stage in which the robot drifts without thrusters: how fast, and what that leads to.

    The robot has the momentum that an earlier stage has left. If the stage wants the base at a place that the drift
    reaches, the sentence says when it is there; of another stage with a shortest duration, how far it drifts in that.
    There is no sentence for stages in which the robot stands still or its speed is not known before the run. That a
    drift misses its place is a remark of `psmpc check`, besides.
    """
    for drift in drifts(task, forecasts):
        left = "the start" if drift.before is None else drift.before.name
        speed = f"{drift.stage.name}: the robot drifts at {drift.speed:.3g} m/s, with the momentum that {left} leaves"
        if not (drift.speed and np.isfinite(drift.spread)):  # the spread is how uncertain the speed is
            continue
        if len(drift.displacement) and not drift.miss:
            after = drift.nearest_after
            yield f"{speed}; it is at its place after {after:.3g} s, give or take {drift.spread * after:.2g} m"
        elif drift.lasts:
            yield f"{speed}: by {drift.speed * drift.lasts:.3g} m in the {drift.lasts:g} s that it lasts at least"


def _describe_known_delay(task: Task) -> str:
    """Write what the controller knows of the delay of commands."""
    delay = task.spec.controller.delay
    if delay != "auto":
        return f"known as {delay:g} s"
    if task.spec.finds_delay(task.robot):  # whether it can be estimated with the actuators of this robot
        return "estimated"
    return "taken for none: pulses of thrusters cannot be told from one, so give it if there is one"


def _obstacle_rows(task: TaskSpec) -> Iterator[Row]:
    """Yield a row for each obstacle: its shape, where it is and how it moves."""
    for obstacle in task.obstacles:
        drift = f", moves at {_spaced(obstacle.velocity)} m/s" if any(obstacle.velocity) else ""
        yield (
            f"obstacle {obstacle.name}",
            f"{_describe_shape(obstacle.shape)} at {_describe_pose(obstacle.pose)}{drift}",
        )


def _describe_shape(shape: ShapeSpec) -> str:
    """Write a shape with its sizes."""
    if shape.sphere is not None:
        return f"sphere of radius {shape.sphere:g} m"
    if shape.capsule is not None:
        radius, length = shape.capsule
        return f"capsule of radius {radius:g} m about {length:g} m"
    if shape.box is not None:
        return f"box of {' x '.join(f'{edge:g}' for edge in shape.box)} m"
    return f"half-space with normal {_spaced(shape.half_space or ())}"


def _clearance_rows(task: Task) -> Iterator[Row]:
    """Yield the rows of the distances that a task and its stages keep, and of the capsules that stand for the robot."""
    spec = task.spec
    of_stages = {f"in {stage.name}": stage.clearance for stage in spec.stages}
    for where, clearance in {"at least": spec.clearance, **of_stages}.items():
        if clearance is not None:
            excepted = ", ".join(pair_name(*pair) for pair in clearance.excepted)
            but = f", but not {excepted}" if excepted else ""
            yield where, f"{1e3 * clearance.margin:g} mm, {'hard' if clearance.hard else 'soft'}{but}"
    if spec.keeps_clear:
        yield "robot", _describe_capsules(task.robot)


def _describe_capsules(robot: RobotSpec) -> str:
    """Write how many capsules the bodies of a robot have where distances count, and where they are from."""
    pieces = pieces_of(robot)
    counts = Counter(piece.part for piece in pieces)
    origin = "from its file" if robot.geometry else "fitted to its joints"
    by_body = ", ".join(f"{body} {n}" for body, n in counts.items())
    return f"{counted(len(pieces), 'capsule', 'capsules')} {origin}: {by_body}"


def _posture_row(robot: RobotSpec, posture: ArmPosture) -> Row:
    """Build the row of an arm at the target of a stage: its joints, and the pose of its end-effector."""
    joints = "none found"
    if posture.joints is not None:
        axes = axes_of(robot.parts, "joint", False)[posture.arm]
        joints = _describe_target(posture.arm, list(zip(axes, posture.joints.tolist(), strict=True)), robot.sliding)
    return posture.stage, posture.arm, joints, _describe_pose(posture.pose.tolist())


def _unknown_load_rows(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> Iterator[Row]:
    """Yield the row on how large the object is against the robot, if the low-level law does not know of that load."""
    if task.spec.body.grasp.known:
        return
    largest = largest_load_ratio(task, model, stops)
    if largest is None:
        return
    where = f"in a motion mostly of {largest.coordinate}, where {largest.stage} leads"
    yield "load over the robot's inertia", f"{largest.ratio:.3g} {where}; expected at most {LARGEST_UNKNOWN_LOAD:g}"


def _describe_mobility(robot: RobotSpec) -> str:
    """Write what moves the base, where it is not thrusters."""
    return "" if robot.moved_by.actuated else f", {robot.mobility}"


def print_robot(robot: RobotSpec) -> None:
    """Print a robot as `psmpc check` shows it.

    A table has its bodies with the joint by which each is carried, a second one the limits of its coordinates. Lines on
    its shape, thrusters and wheels follow, and what psmpc has assumed where a URDF file says nothing.
    """
    echo(f"{robot.name}: {robot.description}" if robot.description else robot.name)
    d = robot.dimension
    bodies = robot.bodies
    total = sum(body.mass for body in bodies)
    kind = "planar" if d == 2 else "spatial"
    echo(f"{kind}{_describe_mobility(robot)}, {sum(robot.parts.values())} degrees of freedom, {total:.6g} kg")
    rows: list[Row] = []
    carried = [("", "", "")]  # joint, carrier and armature of each body; the base, which is the first, has none
    for joint in robot.joints:  # in the order of the bodies that they move
        at = joint.at
        kind = "prismatic along" if joint.prismatic else "revolute about"
        turn = math.degrees(math.hypot(*at.rotation))
        carrier = f"{bodies[at.body].name} at {_spaced(at.position[:d])} m{f', {turn:.4g} deg' if turn else ''}"
        armature = f"{joint.armature:g} {'kg' if joint.prismatic else 'kg m^2'}" if joint.armature else ""
        carried.append(("revolute" if d == 2 else f"{kind} {_spaced(joint.axis)}", carrier, armature))
    for body, (motion, carrier, armature) in zip(bodies, carried, strict=True):
        inertia = body.inertia[2:3] if d == 2 else body.inertia  # in the plane only that about z counts
        row = (body.name, motion, carrier, f"{body.mass:g}", _spaced(body.centre[:d]), _spaced(inertia), armature)
        rows.append(row)
    headings = ("body", "joint", "on", "mass [kg]", "centre of mass [m]", "inertia [kg m^2]", "armature")
    print_table(headings, rows, left_aligned=len(headings))
    echo()
    print_table(("coordinate", *QUANTITIES), _limit_rows(robot), left_aligned=1 + len(QUANTITIES))
    echo()
    echo(f"shape: {_describe_capsules(robot)}")
    if robot.thrusters:
        echo(_describe_thrusters(robot))
    if robot.wheels:
        echo(_describe_wheels(robot))
    if isinstance(robot, SpatialRobot) and robot.assumed:
        echo("assumed:")
        echo("\n".join(f"  {note}" for note in robot.assumed))


def _describe_wheels(robot: RobotSpec) -> str:
    """Write what the reaction wheels of a robot can give and store about each axis of the base, about it alone."""
    wheels = Wheels.of(robot)
    axes = ERROR_AXES[robot.dimension][robot.dimension :]
    of_axes = []
    for axis, direction in zip(axes, np.eye(len(axes)), strict=True):
        torque, momentum = wheels.along(direction)
        of_axes.append(f"{axis} {torque:.3g} N m, {momentum:.3g} N m s" if torque else f"{axis} alone nothing")
    return f"{counted(wheels.count, 'reaction wheel', 'reaction wheels')}: about {'; '.join(of_axes)}"


def _wheel_turn_rows(task: Task, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Row]:
    """Yield a row for each axis of the base about which reaction wheels alone turn the robot in some stage.

    It compares how fast the wheels can turn the robot with the limit of that velocity. The robot is taken as one rigid
    body that turns about its centre of mass, with its arms as at the start. Wheels that were at rest then store the
    opposite of its angular momentum I omega.

    Yields:
        The cells below `TURN_HEADINGS`: the axis; the largest torque and momentum of the wheels about it; the rate at
        which the momentum I omega fills the wheels; the tightest limit of velocity in these stages, with the momentum
        that it takes, or nothing without a limit.
    """
    turned = [stage for stage in stages if stage.moved_by.is_turned and not stage.moved_by.is_pushed]
    wheels = Wheels.of(task.robot)
    if not (turned and wheels.count):
        return
    Q, _ = initial_state(task)
    rotation = model.space.rotation
    inertia = model.inertia_about_centre(Q)
    tightest = min((stage.limits.velocity_high[rotation] for stage in turned), key=lambda limits: float(limits.min()))
    for axis, direction, limit in zip(
        ERROR_AXES[model.dimension][rotation], np.eye(len(inertia)), tightest, strict=True
    ):
        torque, momentum = wheels.along(direction)
        _, rate = wheels.along(inertia @ direction)  # the multiple of I e that the wheels store is a rate [rad/s]
        needs = ""
        if np.isfinite(limit):
            needs = f"{math.degrees(limit):.3g} deg/s, {limit * float(direction @ inertia @ direction):.3g} N m s"
        yield axis, f"{torque:.3g} N m", f"{momentum:.3g} N m s", f"{math.degrees(rate):.3g} deg/s", needs


TURN_HEADINGS = ("turn about", "wheels give", "wheels store", "so it turns at most at", "limit of velocity, takes")
"""Headings of what wheels give and store."""


def _describe_thrusters(robot: RobotSpec) -> str:
    """Write what the thrusters of a robot give at most along each axis of the base, and whether they are used."""
    low, high = Thrusters.of(robot.thrusters).extent
    axes = ERROR_AXES[robot.dimension]
    units = [units_of("base", axis, ()).force for axis in axes]
    of_axes = (f"{axis} {-a:.4g} to {b:.4g} {unit}" for axis, a, b, unit in zip(axes, -low, high, units, strict=True))
    unused = "" if robot.moved_by.is_pushed else f", off where the base is {robot.mobility}"
    return f"{counted(len(robot.thrusters), 'thruster', 'thrusters')}{unused}, at most: {', '.join(of_axes)}"


def _describe_shut_thrusters(stage: str, numbers: Sequence[int] | None) -> str:
    """Write the numbers of the thrusters that are shut in a stage; None where they are not known before the run."""
    if numbers is None:
        return f"{stage} not known before the run"
    return f"{stage} {', '.join(map(str, numbers)) or 'none'}"


def _spaced(numbers: Sequence[float]) -> str:
    """Write numbers in a row, none of them as -0."""
    return " ".join(f"{number + 0.0:.4g}" for number in numbers)


def _describe_priorities(priorities: PrioritiesSpec, stages: list[str]) -> str:
    """Write the number of comparisons behind the priorities, and how consistent they are."""
    weighed = weigh(priorities.compare, stages)
    count = len(priorities.compare)
    agreement = f"consistency ratio {weighed.ratio:.2g}, acceptable up to {ACCEPTABLE:g}"
    agreement = agreement if weighed.surplus > 0 else "as few as possible, so their consistency is not known"
    return f"priorities from {counted(count, 'comparison', 'comparisons')}: {agreement}"


def _stage_rows(task: Task, forecast: StageForecast) -> list[Row]:
    """Build the rows of one stage in the table of stages.

    The first column lists what holds for the whole stage, below each other. The next four columns have a row for each
    part of the robot: its name, target, tolerances at the end of the stage, and distance of the target against reach.
    The last column has one entry, the earliest end. Columns that are shorter than others are filled with empty cells.
    """
    stage = forecast.stage
    spec = task.spec.stages[stage.index]
    sizes = task.robot.parts
    space = task.spec.skills[spec.skill].wanted_in
    about = [spec.name, f"{spec.skill} ({space})", f"priority {spec.priority:g}"]
    about += [f"follows {spec.target.times[-1]:g} s"] if isinstance(spec.target, TrajectorySpec) else []
    about += [stage.moved_by.name] if stage.moved_by != task.robot.moved_by else []
    about += ["plumes avoided"] if task.spec.avoids_plumes(stage.index, task.robot) else []
    about += [f"at least {spec.dwell:g} s"] if spec.dwell else []
    if spec.ends_when and spec.ends_when.object:
        about += [f"object within {_describe_object_end(spec.ends_when.object)}"]
    if spec.ends_when and spec.ends_when.momentum:
        about += [f"momentum within {_describe_momentum_end(spec.ends_when.momentum)}"]
    parts = []
    rates = [""] * len(stage.end.rows)
    if stage.end.rate_tolerance is not None:
        wanted_rates = stage.end.target_rates if len(stage.end.target_rates) else np.zeros(len(rates))
        bounds = zip(wanted_rates, stage.end.rate_tolerance, strict=True)
        rates = [f" ({f'{rate:g} +- ' if rate else ''}{tolerance:g}/s)" for rate, tolerance in bounds]
    bounded = zip(stage.end.rows, stage.end.tolerance, rates, strict=True)
    tolerances = {row: f"{tolerance:g}{rate}" for row, tolerance, rate in bounded}
    # numbers of the target and rows of the error stand part after part, so each part takes the next ones;
    # there are more numbers than rows where an attitude is a quaternion, with an error of three rows
    numbers = iter(stage.target)
    next_row = count()
    error_axes = axes_of(sizes, space)
    target_axes = axes_of(sizes, space, of_error=False)
    for (part, rows), axes in zip(error_axes.items(), target_axes.values(), strict=True):
        target = ("to " if stage.reference.moves else "") + _describe_target(
            part, list(zip(axes, numbers, strict=False)), task.robot.sliding
        )
        # a base that the stage does not ask for, and that cannot be moved at will, has no target: its mobility is said
        if part == "base" and not (stage.moved_by.actuated or stage.relevant_rows[: len(rows)].any()):
            target = stage.moved_by.name
        asked = [tolerances.get(next(next_row), "-") for _ in rows]
        within = asked[0] if len(set(asked)) == 1 else ", ".join(asked)
        if spec.at is not None:  # a stage that ends at a fixed time, which is said once
            ends = f"at {spec.at:g} s" if part == "base" else ""
        else:
            ends = "" if within == "-" else within
        reach = forecast.reaches.get(part)
        parts.append((part, target, ends, f"{reach.distance:.3f} of {reach.full_reach:.3f} m" if reach else ""))
    earliest = [f"{math.floor(forecast.earliest_end * 100) / 100:g} s"]  # a lower bound, so rounded down
    lines = zip_longest(about, parts, earliest)
    return [(left or "", *(middle or ("",) * 4), right or "") for left, middle, right in lines]


def _describe_object_end(end: ObjectEndSpec) -> str:
    """Write what an end condition asks of the object."""
    lengths = ((end.position, "m"), (end.velocity, "m/s"))
    angles = ((end.angle, "deg"), (end.angular_velocity, "deg/s"))
    written = [f"{value:g} {unit}" for value, unit in lengths if value is not None]
    written += [f"{math.degrees(value):.4g} {unit}" for value, unit in angles if value is not None]
    return ", ".join(written)


def _describe_momentum_end(end: MomentumEndSpec) -> str:
    """Write what an end condition asks of the momentum."""
    momenta = ((end.linear, "N s"), (end.angular, "N m s"))
    return ", ".join(f"{value:g} {unit}" for value, unit in momenta if value is not None)


def _describe_target(part: str, values: Sequence[tuple[str, float]], sliding: Collection[str] = ()) -> str:
    """Write the target of a part of the robot as people read it, such as `1, 0.5 m, turned by 30 deg`.

    Neighbours of the same unit share it: lengths in m, angles in deg. A quaternion is written as its angle.

    Args:
        part: The part, `base` or the name of an arm.
        values: Pairs of an axis and its number, in their order [m, rad, or components w x y z of a quaternion].
        sliding: Names of the joint coordinates that are lengths.
    """
    written = []
    for kind, group in groupby(values, key=lambda axis_and_value: units_of(part, axis_and_value[0], sliding)):
        numbers = [value for _, value in group]
        if kind == LENGTH:
            written.append(f"{', '.join(f'{value:g}' for value in numbers)} m")
        elif kind == ANGLE:
            written.append(f"{', '.join(f'{math.degrees(value):.4g}' for value in numbers)} deg")
        else:
            turn = 2 * math.atan2(math.hypot(*numbers[1:]), abs(numbers[0]))  # of the shorter of the two turns
            written.append(f"turned by {math.degrees(turn):.4g} deg")
    return ", ".join(written)


def _object_rows(target_object: ObjectSpec) -> Iterator[Row]:
    """Yield the rows of a task's object, pairs of a property and its value.

    Every object has a size, a pose, and stages in which it is taken and let go. An object without mass is only drawn,
    and has no more. One with mass also moves by itself, is held by grasps, and may have a destination.
    """
    yield "size", f"{' x '.join(f'{extent:g}' for extent in target_object.shape)} m"
    yield "pose at the start", _describe_pose(target_object.pose)
    yield "taken", f"at the end of {target_object.taken_by}"
    let_go = target_object.let_go_by
    yield "let go", "never: it is held to the end" if let_go is None else f"at the beginning of {let_go}"
    body = target_object.body
    if body.mass == 0.0:
        return
    yield "mass", f"{body.mass:g} kg"
    yield "inertia", f"{_spaced(body.inertia)} kg m^2"
    drift = f"{_spaced(body.motion.linear)} m/s, {_spaced_in_degrees(body.motion.angular)} deg/s"
    yield "drift", drift if body.motion.moves else "none"
    grasp = body.grasp
    for arm, pose in grasp.at.items():
        yield f"grasp of {arm}", _describe_pose(pose)
    envelope = grasp.envelope
    position = f"{envelope.position:g} m, {math.degrees(envelope.angle):.4g} deg"
    velocity = f"{envelope.velocity:g} m/s, {math.degrees(envelope.angular_velocity):.4g} deg/s"
    yield "grippers close within", f"{position}, {velocity}"
    stiffness, angular_stiffness = grasp.stiffness  # of the bushing between gripper and object
    yield (
        "stiffness of a grasp",
        f"{stiffness:g} N/m, {angular_stiffness:g} N m/rad, damping ratio {grasp.damping_ratio:g}",
    )
    strength = grasp.strength
    largest = dict(zip(GRASP_LOADS, grasp.largest_loads, strict=True))
    bounds = (f"{load} {largest[load]:g} {unit}" for load, unit in GRASP_LOADS.items() if math.isfinite(largest[load]))
    holds = "any load" if strength is None else f"{', '.join(bounds)}, filtered over {strength.filter:g} s"
    yield "a grasp holds", holds
    yield "load known to the low-level law", "estimated" if grasp.is_estimated else "yes" if grasp.known else "no"
    destination = body.destination
    if destination is not None:
        d = len(target_object.shape)  # 2 or 3; of tolerances, the first d are lengths and the others angles
        angles = _spaced_in_degrees(destination.tolerance[d:])
        yield "destination", _describe_pose(destination.pose)
        yield "destination within", f"{_spaced(destination.tolerance[:d])} m, {angles} deg"
        yield "speed at the destination", f"at most {destination.speed:g} m/s"


def _describe_pose(pose: Sequence[float]) -> str:
    """Write a pose in the plane or in space, there with the axis about which it is turned.

    Args:
        pose: Position [m], then an angle [rad] or a quaternion w x y z.
    """
    axes = next(axes for axes in TARGET_AXES.values() if len(axes) == len(pose))
    # the sign of w: q and -q are the same attitude, and the angle that is written is that of w >= 0
    length = math.copysign(math.hypot(*pose[4:]), pose[3]) if len(pose) > 3 else 0.0
    about = f" about {_spaced([component / length for component in pose[4:]])}" if length else ""
    return _describe_target("base", list(zip(axes, pose, strict=True))) + about


def _spaced_in_degrees(angles: Sequence[float]) -> str:
    """Write angles [rad] in a row, in degrees."""
    return _spaced([math.degrees(angle) for angle in angles])


def _limit_rows(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> list[Row]:
    """Build a row for each coordinate of a robot: its label, then its limits, `low to high unit`.

    There is a column of limits for each of `QUANTITIES`: position, velocity, acceleration, jerk and force. Angles
    are in degrees, and a cell is empty where neither side has a limit.

    Args:
        robot: The robot.
        more: Limits that hold besides its own, such as a task's; of several the tightest counts.
    """
    limits = resolve_limits(robot, *more)
    rows = list[Row]()
    for row, (label, units_of_row) in enumerate(zip(labels(robot, "joint"), units(robot), strict=True)):
        spans = [label]
        for quantity in QUANTITIES:
            unit = getattr(units_of_row, quantity)
            low, high = (float(getattr(limits, f"{quantity}_{end}")[row]) for end in ("low", "high"))
            if unit == "rad":  # positions of joints; limits of rates are printed as they are
                unit = "deg"
                low = math.degrees(low)
                high = math.degrees(high)
            spans.append("" if math.isinf(low) and math.isinf(high) else f"{low:.4g} to {high:.4g} {unit}")
        rows.append(spans)
    return rows


def _lines_of_changed_keys(spec: Spec, path: str) -> Iterator[str]:
    """Yield a line for every key that differs from its default, with its description."""
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        if isinstance(value, Spec):
            yield from _lines_of_changed_keys(value, f"{path}.{name}")
        elif value != field.default:
            yield f"{path}.{name}: {dumps(plain(value))} ({field.description})"
