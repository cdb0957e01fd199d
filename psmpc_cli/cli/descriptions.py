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
    """Print a task as `psmpc check` shows it before a run.

    First what runs it, its priorities and its uncertainty, then its stages part by part. Sections follow that a task
    has or not: postures of the arms, limits of forces, thrusters, turns of the base, drifts, clearance, and the object.
    """
    spec = task.spec
    controller = task.spec.controller
    echo(f"{spec.name}: {spec.description}" if spec.description else spec.name)
    echo(
        f"robot {task.robot.name}{_mobility(task.robot)}; "
        f"controller {controller.kind}, horizon {controller.horizon:g} s, {controller.nodes} nodes a stage, "
        f"sample time {controller.sample_time:g} s; "
        f"solver {spec.solver.kind}; plant {spec.plant.kind}"
    )
    if spec.priorities is not None:
        echo(_comparisons(spec.priorities, [stage.name for stage in spec.stages]))
    if spec.uncertainty.in_force:
        echo(f"uncertain, seed {spec.seed}, delay {_known_delay(task)}:")
        echo("\n".join(f"  {line}" for line in _changes(spec.uncertainty, "uncertainty")))
    headings = ("stage", "part", "target", "ends within", "distance of reach", "not before")
    print_table(headings, [row for forecast in forecasts for row in _stage(task, forecast)], left_aligned=len(headings))
    model = forecasts[0].model
    stages = [forecast.stage for forecast in forecasts]
    stops = forecast_configurations(task, forecasts)
    if rows := [_posture(task.robot, each) for each in arm_postures(model, stages, stops)]:
        echo()
        print_table(("at the target of", "arm", "joints", "end-effector"), rows, left_aligned=4)
    if limits := [(coordinate, force) for coordinate, *_, force in _limits(task.robot, spec.limits) if force]:
        echo()
        print_table(("coordinate", "limit of force, of robot and task"), limits, left_aligned=2)
    if spec.fires(task.robot):
        echo()
        echo(_thrusters(task.robot))
        if shut := shut_thrusters(task, model, stages, stops):
            echo(f"shut at the target, because of plumes: {'; '.join(starmap(_shut, shut.items()))}")
    if rows := list(_turns(task, model, stages)):
        echo()
        print_table(TURNS, rows, left_aligned=1)
    if sentences := list(_drifts(task, forecasts)):
        echo()
        echo("\n".join(sentences))
    if rows := [*_obstacles(spec), *_clearance(task)]:
        echo()
        print_table(("clearance", ""), rows)
    if spec.object is not None:
        echo()
        print_table(("object", ""), [*_object(spec.object), *_unknown_load(task, model, stops)])


def _drifts(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[str]:
    """Yield how far a robot drifts in stages in which nothing pushes it, where they want it at a place or last long."""
    for drift in drifts(task, forecasts):
        left = "the start" if drift.before is None else drift.before.name
        speed = f"{drift.stage.name}: the robot drifts at {drift.speed:.3g} m/s, with the momentum that {left} leaves"
        if not (drift.speed and np.isfinite(drift.spread)):
            continue
        if len(drift.displacement) and not drift.miss:
            after = drift.nearest_after
            yield f"{speed}; it is at its place after {after:.3g} s, give or take {drift.spread * after:.2g} m"
        elif drift.lasts:
            yield f"{speed}: by {drift.speed * drift.lasts:.3g} m in the {drift.lasts:g} s that it lasts at least"


def _known_delay(task: Task) -> str:
    """Write what the controller knows of the delay of commands."""
    delay = task.spec.controller.delay
    if delay != "auto":
        return f"known as {delay:g} s"
    if task.spec.finds_delay(task.robot):
        return "estimated"
    return "taken for none: pulses of thrusters cannot be told from one, so give it if there is one"


def _obstacles(task: TaskSpec) -> Iterator[Row]:
    """Yield a row for each obstacle: its shape, where it is and how it moves."""
    for obstacle in task.obstacles:
        drift = f", moves at {_listed(obstacle.velocity)} m/s" if any(obstacle.velocity) else ""
        yield f"obstacle {obstacle.name}", f"{_shape(obstacle.shape)} at {_pose(obstacle.pose)}{drift}"


def _shape(shape: ShapeSpec) -> str:
    """Write a shape with its sizes."""
    if shape.sphere is not None:
        return f"sphere of radius {shape.sphere:g} m"
    if shape.capsule is not None:
        radius, length = shape.capsule
        return f"capsule of radius {radius:g} m about {length:g} m"
    if shape.box is not None:
        return f"box of {' x '.join(f'{edge:g}' for edge in shape.box)} m"
    return f"half-space with normal {_listed(shape.half_space or ())}"


def _clearance(task: Task) -> Iterator[Row]:
    """Yield how far apart a task keeps what, in its stages too, and what its robot is made of for that."""
    spec = task.spec
    own = {f"in {stage.name}": stage.clearance for stage in spec.stages}
    for where, clearance in {"at least": spec.clearance, **own}.items():
        if clearance is not None:
            excepted = ", ".join(pair_name(*pair) for pair in clearance.excepted)
            but = f", but not {excepted}" if excepted else ""
            yield where, f"{1e3 * clearance.margin:g} mm, {'hard' if clearance.hard else 'soft'}{but}"
    if spec.keeps_clear:
        yield "robot", _geometry(task.robot)


def _geometry(robot: RobotSpec) -> str:
    """Write how many capsules the bodies of a robot have where distances count, and where they are from."""
    pieces = pieces_of(robot)
    counts = Counter(piece.part for piece in pieces)
    origin = "from its file" if robot.geometry else "fitted to its joints"
    by_body = ", ".join(f"{body} {n}" for body, n in counts.items())
    return f"{counted(len(pieces), 'capsule', 'capsules')} {origin}: {by_body}"


def _posture(robot: RobotSpec, posture: ArmPosture) -> Row:
    """Build the row of an arm at the target of a stage: its joints, and the pose of its end-effector."""
    joints = "none found"
    if posture.joints is not None:
        axes = axes_of(robot.parts, "joint", False)[posture.arm]
        joints = _target(posture.arm, list(zip(axes, posture.joints.tolist(), strict=True)), robot.sliding)
    return posture.stage, posture.arm, joints, _pose(posture.pose.tolist())


def _unknown_load(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> Iterator[Row]:
    """Yield how large a load is against the robot, where the low-level law does not know of it."""
    if task.spec.body.grasp.known:
        return
    largest = largest_load_ratio(task, model, stops)
    if largest is None:
        return
    where = f"in a motion mostly of {largest.coordinate}, where {largest.stage} leads"
    yield "load over the robot's inertia", f"{largest.ratio:.3g} {where}; expected at most {LARGEST_UNKNOWN_LOAD:g}"


def _mobility(robot: RobotSpec) -> str:
    """Write what moves the base, where it is not thrusters."""
    return "" if robot.moved_by.actuated else f", {robot.mobility}"


def print_robot(robot: RobotSpec) -> None:
    """Print a robot: its bodies, and the limits of its coordinates."""
    echo(f"{robot.name}: {robot.description}" if robot.description else robot.name)
    d = robot.dimension
    bodies = robot.bodies
    total = sum(body.mass for body in bodies)
    kind = "planar" if d == 2 else "spatial"
    echo(f"{kind}{_mobility(robot)}, {sum(robot.parts.values())} degrees of freedom, {total:.6g} kg")
    rows: list[Row] = []
    carried = [("", "", "")]
    for each in robot.joints:
        at = each.at
        kind = "prismatic along" if each.prismatic else "revolute about"
        turn = math.degrees(math.hypot(*at.rotation))
        carrier = f"{bodies[at.body].name} at {_listed(at.position[:d])} m{f', {turn:.4g} deg' if turn else ''}"
        armature = f"{each.armature:g} {'kg' if each.prismatic else 'kg m^2'}" if each.armature else ""
        carried.append(("revolute" if d == 2 else f"{kind} {_listed(each.axis)}", carrier, armature))
    for body, (joint, carrier, armature) in zip(bodies, carried, strict=True):
        inertia = body.inertia[2:3] if d == 2 else body.inertia
        row = (body.name, joint, carrier, f"{body.mass:g}", _listed(body.centre[:d]), _listed(inertia), armature)
        rows.append(row)
    headings = ("body", "joint", "on", "mass [kg]", "centre of mass [m]", "inertia [kg m^2]", "armature")
    print_table(headings, rows, left_aligned=len(headings))
    echo()
    print_table(("coordinate", *QUANTITIES), _limits(robot), left_aligned=1 + len(QUANTITIES))
    echo()
    echo(f"shape: {_geometry(robot)}")
    if robot.thrusters:
        echo(_thrusters(robot))
    if robot.wheels:
        echo(_wheels(robot))
    if isinstance(robot, SpatialRobot) and robot.assumed:
        echo("assumed:")
        echo("\n".join(f"  {note}" for note in robot.assumed))


def _wheels(robot: RobotSpec) -> str:
    """Write what the reaction wheels of a robot can give and store about each axis of the base, about it alone."""
    wheels = Wheels.of(robot)
    axes = ERROR_AXES[robot.dimension][robot.dimension :]
    of_axes = []
    for axis, direction in zip(axes, np.eye(len(axes)), strict=True):
        torque, momentum = wheels.along(direction)
        of_axes.append(f"{axis} {torque:.3g} N m, {momentum:.3g} N m s" if torque else f"{axis} alone nothing")
    return f"{counted(wheels.count, 'reaction wheel', 'reaction wheels')}: about {'; '.join(of_axes)}"


def _turns(task: Task, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Row]:
    """Yield what wheels give about each axis of the base, and how fast that turns the robot, its arms as at the start.

    The whole robot turns about its centre of mass, and wheels at rest store what it has then.
    """
    turned = [stage for stage in stages if stage.moved_by.is_turned and not stage.moved_by.is_pushed]
    wheels = Wheels.of(task.robot)
    if not (turned and wheels.count):
        return
    Q, _ = initial_state(task)
    rotation = model.space.rotation
    inertia = model.inertia_about_centre(Q)
    fastest = min((stage.limits.velocity_high[rotation] for stage in turned), key=lambda limits: float(limits.min()))
    for axis, direction, limit in zip(
        ERROR_AXES[model.dimension][rotation], np.eye(len(inertia)), fastest, strict=True
    ):
        torque, momentum = wheels.along(direction)
        _, rate = wheels.along(inertia @ direction)
        needs = ""
        if np.isfinite(limit):
            needs = f"{math.degrees(limit):.3g} deg/s, {limit * float(direction @ inertia @ direction):.3g} N m s"
        yield axis, f"{torque:.3g} N m", f"{momentum:.3g} N m s", f"{math.degrees(rate):.3g} deg/s", needs


TURNS = ("turn about", "wheels give", "wheels store", "so it turns at most at", "limit of velocity, takes")
"""Headings of what wheels give and store."""


def _thrusters(robot: RobotSpec) -> str:
    """Write what the thrusters of a robot give at most along each axis of the base, and whether they are used."""
    low, high = Thrusters.of(robot.thrusters).extent
    axes = ERROR_AXES[robot.dimension]
    units = [units_of("base", axis, ()).force for axis in axes]
    of_axes = (f"{axis} {-a:.4g} to {b:.4g} {unit}" for axis, a, b, unit in zip(axes, -low, high, units, strict=True))
    unused = "" if robot.moved_by.is_pushed else f", off where the base is {robot.mobility}"
    return f"{counted(len(robot.thrusters), 'thruster', 'thrusters')}{unused}, at most: {', '.join(of_axes)}"


def _shut(stage: str, numbers: Sequence[int] | None) -> str:
    """Write the numbers of the thrusters that are shut in a stage; None where they are not known before the run."""
    if numbers is None:
        return f"{stage} not known before the run"
    return f"{stage} {', '.join(map(str, numbers)) or 'none'}"


def _listed(numbers: Sequence[float]) -> str:
    """Write numbers in a row, none of them as -0."""
    return " ".join(f"{number + 0.0:.4g}" for number in numbers)


def _comparisons(priorities: PrioritiesSpec, stages: list[str]) -> str:
    """Write the number of comparisons behind the priorities, and how consistent they are."""
    weighed = weigh(priorities.compare, stages)
    count = len(priorities.compare)
    agreement = f"consistency ratio {weighed.ratio:.2g}, acceptable up to {ACCEPTABLE:g}"
    agreement = agreement if weighed.surplus > 0 else "as few as possible, so their consistency is not known"
    return f"priorities from {counted(count, 'comparison', 'comparisons')}: {agreement}"


def _stage(task: Task, forecast: StageForecast) -> list[Row]:
    """Build the rows of one stage, one for each part."""
    stage = forecast.stage
    spec = task.spec.stages[forecast.stage.index]
    sizes = task.robot.parts
    space = task.spec.skills[spec.skill].wanted_in
    about = [spec.name, f"{spec.skill} ({space})", f"priority {spec.priority:g}"]
    about += [f"follows {spec.target.times[-1]:g} s"] if isinstance(spec.target, TrajectorySpec) else []
    about += [stage.moved_by.name] if stage.moved_by != task.robot.moved_by else []
    about += ["plumes avoided"] if task.spec.avoids_plumes(stage.index, task.robot) else []
    about += [f"at least {spec.dwell:g} s"] if spec.dwell else []
    if spec.ends_when and spec.ends_when.object:
        about += [f"object within {_object_end(spec.ends_when.object)}"]
    if spec.ends_when and spec.ends_when.momentum:
        about += [f"momentum within {_momentum_end(spec.ends_when.momentum)}"]
    numbers = iter(stage.target)
    row = count()
    parts = []
    rests = [""] * len(stage.end.rows)
    if stage.end.rate_tolerance is not None:
        moving = stage.end.target_rates if len(stage.end.target_rates) else np.zeros(len(rests))
        bounds = zip(stage.end.rate_tolerance, moving, strict=True)
        rests = [f" ({f'{rate:g} +- ' if rate else ''}{each:g}/s)" for each, rate in bounds]
    asked_of = zip(stage.end.rows, stage.end.tolerance, rests, strict=True)
    tolerances = {row: f"{tolerance:g}{rest}" for row, tolerance, rest in asked_of}
    for (part, rows), axes in zip(axes_of(sizes, space).items(), axes_of(sizes, space, False).values(), strict=True):
        target = ("to " if stage.reference.moves else "") + _target(
            part, list(zip(axes, numbers, strict=False)), task.robot.sliding
        )
        if part == "base" and not (stage.moved_by.actuated or stage.relevant_rows[: len(rows)].any()):
            target = stage.moved_by.name
        asked = [tolerances.get(next(row), "-") for _ in rows]
        within = asked[0] if len(set(asked)) == 1 else ", ".join(asked)
        ends = f"at {spec.at:g} s" * (part == "base") if spec.at is not None else "" if within == "-" else within
        reach = forecast.reaches.get(part)
        parts.append((part, target, ends, f"{reach.distance:.3f} of {reach.full_reach:.3f} m" if reach else ""))
    earliest = [f"{math.floor(forecast.earliest_end * 100) / 100:g} s"]
    lines = zip_longest(about, parts, earliest)
    return [(left or "", *(middle or ("",) * 4), right or "") for left, middle, right in lines]


def _object_end(end: ObjectEndSpec) -> str:
    """Write what an end condition asks of the object."""
    lengths = ((end.position, "m"), (end.velocity, "m/s"))
    angles = ((end.angle, "deg"), (end.angular_velocity, "deg/s"))
    written = [f"{value:g} {unit}" for value, unit in lengths if value is not None]
    written += [f"{math.degrees(value):.4g} {unit}" for value, unit in angles if value is not None]
    return ", ".join(written)


def _momentum_end(end: MomentumEndSpec) -> str:
    """Write what an end condition asks of the momentum."""
    momenta = ((end.linear, "N s"), (end.angular, "N m s"))
    return ", ".join(f"{value:g} {unit}" for value, unit in momenta if value is not None)


def _target(part: str, values: Sequence[tuple[str, float]], sliding: Collection[str] = ()) -> str:
    """Write the target of a part, coordinates by axis in their order: lengths, angles in degrees, or an attitude.

    Args:
        part: The part.
        values: Its axes, and the numbers of them.
        sliding: Names of the joint coordinates that are lengths.
    """
    written = []
    for own, group in groupby(values, key=lambda each: units_of(part, each[0], sliding)):
        numbers = [value for _, value in group]
        if own == LENGTH:
            written.append(f"{', '.join(f'{value:g}' for value in numbers)} m")
        elif own == ANGLE:
            written.append(f"{', '.join(f'{math.degrees(value):.4g}' for value in numbers)} deg")
        else:
            turn = 2 * math.atan2(math.hypot(*numbers[1:]), abs(numbers[0]))
            written.append(f"turned by {math.degrees(turn):.4g} deg")
    return ", ".join(written)


def _object(target_object: ObjectSpec) -> Iterator[Row]:
    """Yield the rows of a task's object: what it is, how it moves, how it is grasped, and where it has to be."""
    yield "size", f"{' x '.join(f'{extent:g}' for extent in target_object.shape)} m"
    yield "pose at the start", _pose(target_object.pose)
    yield "taken", f"at the end of {target_object.taken_by}"
    let_go = target_object.let_go_by
    yield "let go", "never: it is held to the end" if let_go is None else f"at the beginning of {let_go}"
    body = target_object.body
    if body.mass == 0.0:
        return
    yield "mass", f"{body.mass:g} kg"
    yield "inertia", f"{_listed(body.inertia)} kg m^2"
    drift = f"{_listed(body.motion.linear)} m/s, {_listed_in_degrees(body.motion.angular)} deg/s"
    yield "drift", drift if body.motion.moves else "none"
    grasp = body.grasp
    for arm, pose in grasp.at.items():
        yield f"grasp of {arm}", _pose(pose)
    envelope = grasp.envelope
    position = f"{envelope.position:g} m, {math.degrees(envelope.angle):.4g} deg"
    velocity = f"{envelope.velocity:g} m/s, {math.degrees(envelope.angular_velocity):.4g} deg/s"
    yield "grippers close within", f"{position}, {velocity}"
    stiffness, angular_stiffness = grasp.stiffness
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
        d = len(target_object.shape)
        angles = _listed_in_degrees(destination.tolerance[d:])
        yield "destination", _pose(destination.pose)
        yield "destination within", f"{_listed(destination.tolerance[:d])} m, {angles} deg"
        yield "speed at the destination", f"at most {destination.speed:g} m/s"


def _pose(pose: Sequence[float]) -> str:
    """Write a pose in the plane or in space, there with the axis about which it is turned."""
    axes = next(axes for axes in TARGET_AXES.values() if len(axes) == len(pose))
    length = math.copysign(math.hypot(*pose[4:]), pose[3]) if len(pose) > 3 else 0.0
    about = f" about {_listed([each / length for each in pose[4:]])}" if length else ""
    return _target("base", list(zip(axes, pose, strict=True))) + about


def _listed_in_degrees(angles: Sequence[float]) -> str:
    """Write angles [rad] in a row, in degrees."""
    return _listed([math.degrees(angle) for angle in angles])


def _limits(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> list[Row]:
    """Build the rows of the limits of every coordinate, angles in degrees; empty where there is none.

    Args:
        robot: The robot.
        more: Limits that hold besides its own, such as a task's.
    """
    limits = resolve_limits(robot, *more)
    rows = list[Row]()
    for row, (label, own) in enumerate(zip(labels(robot, "joint"), units(robot), strict=True)):
        spans = [label]
        for quantity in QUANTITIES:
            unit = getattr(own, quantity)
            low, high = (float(getattr(limits, f"{quantity}_{end}")[row]) for end in ("low", "high"))
            if unit == "rad":
                unit = "deg"
                low = math.degrees(low)
                high = math.degrees(high)
            spans.append("" if math.isinf(low) and math.isinf(high) else f"{low:.4g} to {high:.4g} {unit}")
        rows.append(spans)
    return rows


def _changes(spec: Spec, path: str) -> Iterator[str]:
    """Yield a line for every key that differs from its default, with its description."""
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        if isinstance(value, Spec):
            yield from _changes(value, f"{path}.{name}")
        elif value != field.default:
            yield f"{path}.{name}: {dumps(plain(value))} ({field.description})"
