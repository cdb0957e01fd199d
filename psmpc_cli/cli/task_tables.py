"""Robots and tasks as tables: what `psmpc check` prints."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from json import dumps
from math import atan2, degrees, floor, hypot, isinf

import typer

from psmpc_cli.cli.tables import print_table
from psmpc_cli.ocp.feasibility import Outlook
from psmpc_cli.simulation.gradient_audit import AD_TOLERANCE, DIFFERENCE_TOLERANCE, audit_gradients
from psmpc_cli.simulation.run import build_experiment, converging
from psmpc_cli.specs.document import counted, plain
from psmpc_cli.specs.fields import Spec
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import POSITION_AXES, Space, target_axes
from psmpc_cli.specs.priorities import ACCEPTABLE, weigh
from psmpc_cli.specs.robot import RobotSpec, SpatialRobot, labels, resolve_limits
from psmpc_cli.specs.task import PrioritiesSpec, StageSpec

Rows = list[Sequence[str]]


def print_task(task: Task, outlooks: Sequence[Outlook]) -> None:
    """Print a task: what runs it, and its stages part by part."""
    spec, controller = task.spec, task.spec.controller
    typer.echo(f"{spec.name}: {spec.description}" if spec.description else spec.name)
    typer.echo(
        f"robot {task.robot.name}; controller {controller.kind}, horizon {controller.horizon:g} s, "
        f"{controller.nodes} nodes a stage, sample time {controller.sample_time:g} s; "
        f"solver {spec.solver.kind}; plant {spec.plant.kind}"
    )
    if spec.priorities is not None:
        typer.echo(_comparisons(spec.priorities, [stage.name for stage in spec.stages]))
    if spec.uncertainty.in_force:
        typer.echo(f"uncertain, seed {spec.seed}, known delay {spec.controller.known_delay}:")
        typer.echo("\n".join(f"  {line}" for line in _changes(spec.uncertainty, "uncertainty")))
    headings = ("stage", "part", "target", "ends within", "distance of reach", "not before")
    print_table(headings, [row for outlook in outlooks for row in _stage(task, outlook)], left=len(headings))


def print_robot(robot: RobotSpec) -> None:
    """Print a robot: its bodies, and the limits of its coordinates."""
    typer.echo(f"{robot.name}: {robot.description}" if robot.description else robot.name)
    d, bodies = robot.dimension, robot.bodies
    total = sum(body.mass for body in bodies)
    typer.echo(f"{'planar' if d == 2 else 'spatial'}, {sum(robot.parts.values())} degrees of freedom, {total:.6g} kg")
    rows: Rows = []
    for body in bodies:
        joint, carrier = "", ""
        if body.joint is not None:
            at = body.joint.at
            turn = degrees(hypot(*at.rotation))
            carrier = f"{bodies[at.body].name} at {_listed(at.position[:d])} m{f', {turn:.4g} deg' if turn else ''}"
            kind = "prismatic along" if body.joint.prismatic else "revolute about"
            joint = "revolute" if d == 2 else f"{kind} {_listed(body.joint.axis)}"
        inertia = body.inertia[2:3] if d == 2 else body.inertia
        rows.append((body.name, joint, carrier, f"{body.mass:g}", _listed(body.centre[:d]), _listed(inertia)))
    print_table(("body", "joint", "on", "mass [kg]", "centre of mass [m]", "inertia [kg m^2]"), rows, left=6)
    typer.echo()
    print_table(("coordinate", "position", "velocity", "acceleration"), _limits(robot), left=4)
    typer.echo()
    if isinstance(robot, SpatialRobot) and robot.assumed:
        typer.echo("assumed:")
        typer.echo("\n".join(f"  {note}" for note in robot.assumed))


def _listed(numbers: Iterable[float]) -> str:
    """Write numbers in a row."""
    return " ".join(f"{number:.4g}" for number in numbers)


def _comparisons(priorities: PrioritiesSpec, stages: list[str]) -> str:
    """Write the number of comparisons behind the priorities, and how consistent they are."""
    found, count = weigh(priorities.compare, stages), len(priorities.compare)
    if found.surplus > 0:
        agreement = f"consistency ratio {found.ratio:.2g}, acceptable up to {ACCEPTABLE:g}"
    else:
        agreement = "as few as possible, so their consistency is not known"
    return f"priorities from {counted(count, 'comparison', 'comparisons')}: {agreement}"


def _stage(task: Task, outlook: Outlook) -> Rows:
    """Build the rows of one stage, one for each part."""
    spec = task.spec.stages[outlook.stage.index]
    space = task.spec.skills[spec.skill].space
    about = [spec.name, f"{spec.skill} ({space})", f"priority {spec.priority:g}"]
    about += [f"follows {outlook.stage.trajectory.times[-1]:g} s"] if outlook.stage.trajectory else []
    about += [f"at least {spec.dwell:g} s"] if spec.dwell else []
    values, ends = _targets(task.robot, outlook, space), _ends(task.robot, outlook, spec, space)
    reaches = {part: f"{each.distance:.3f} of {each.full_reach:.3f} m" for part, each in outlook.reaches.items()}
    parts = [(part, values[part], ends[part], reaches.get(part, "")) for part in task.robot.parts]
    earliest = [f"{floor(outlook.earliest_end * 100) / 100:g} s"]
    lines = zip_longest(about, parts, earliest)
    return [(left or "", *(middle or ("",) * 4), right or "") for left, middle, right in lines]


def _targets(robot: RobotSpec, outlook: Outlook, space: Space) -> dict[str, str]:
    """Write the target of every part, of a trajectory its last row; angles in degrees."""
    numbers, found = iter(outlook.stage.target), {}
    for part, axes in target_axes(robot.parts, space).items():
        values = list(zip(axes, numbers, strict=False))
        lengths = ", ".join(f"{value:g}" for axis, value in values if axis in POSITION_AXES)
        angles = ", ".join(f"{degrees(value):.4g}" for axis, value in values if axis == "theta" or axis.isdigit())
        attitude = [value for axis, value in values if axis.startswith("q")]
        if attitude:
            turn = 2 * atan2(hypot(*attitude[1:]), abs(attitude[0]))
            angles = f"turned by {degrees(turn):.4g}{', ' if angles else ''}{angles}"
        texts = (f"{text} {unit}" for text, unit in ((lengths, "m"), (angles, "deg")) if text)
        found[part] = ("to " if outlook.stage.trajectory else "") + ", ".join(texts)
    return found


def _ends(robot: RobotSpec, outlook: Outlook, spec: StageSpec, space: Space) -> dict[str, str]:
    """Write what ends a stage, by part: a fixed time, or the tolerances of its coordinates."""
    if spec.at is not None:
        return dict.fromkeys(robot.parts, "") | {"base": f"at {spec.at:g} s"}
    names, found = labels(robot, space), {}
    asked = dict(zip(outlook.stage.end_rows, outlook.stage.tolerance, strict=True))
    for part in robot.parts:
        rows = [row for row, label in enumerate(names) if label.rpartition(".")[0] == part]
        numbers = [f"{asked[row]:g}" if row in asked else "-" for row in rows]
        text = "" if set(numbers) == {"-"} else numbers[0] if len(set(numbers)) == 1 else ", ".join(numbers)
        rest = spec.ends_when.velocity if spec.ends_when else None
        found[part] = f"{text} ({rest:g}/s)" if text and rest is not None else text
    return found


def _limits(robot: RobotSpec) -> Rows:
    """Build the rows of the limits of every coordinate, angles in degrees; empty where there is none."""
    limits, rows = resolve_limits(robot), Rows()
    for row, label in enumerate(labels(robot, "joint")):
        length, spans = label.rpartition(".")[2] in POSITION_AXES, [label]
        for quantity, unit in (("position", "deg"), ("velocity", "rad/s"), ("acceleration", "rad/s^2")):
            ends = (float(getattr(limits, f"{quantity}_{end}")[row]) for end in ("low", "high"))
            low, high = (degrees(end) if unit == "deg" and not length else end for end in ends)
            shown = unit.replace("deg", "m").replace("rad", "m") if length else unit
            spans.append("" if isinf(low) and isinf(high) else f"{low:.4g} to {high:.4g} {shown}")
        rows.append(spans)
    return rows


def print_gradients(task: Task) -> bool:
    """Audit the gradient at every switch of a task, print it, and tell whether it agrees with both references."""
    audits = audit_gradients(build_experiment(converging(task)))
    nodes = task.spec.controller.uniform_nodes
    typer.echo("Gradient of the cost by the switching instant")
    gaps = (f"costate gap, N_s = {nodes}", f"N_s = {2 * nodes}")
    rows = [
        (
            " to ".join(audit.switch),
            f"{audit.gradient:.4f}",
            f"{audit.to_differentiation:.1e}",
            f"{audit.to_differences:.1e}",
            *(f"{gap:.1e}" for gap in audit.costate_gaps),
            "yes" if audit.holds else "NO",
        )
        for audit in audits
    ]
    print_table(("switch", "dJ/dt_s [1/s]", "adjoint - AD", "adjoint - differences", *gaps, "agrees"), rows, left=1)
    typer.echo(
        f"Differences are relative; expected: at most {AD_TOLERANCE:g} and {DIFFERENCE_TOLERANCE:g}. The costate "
        "formula's gap, taken at an optimum without limits and end conditions, halves with twice the nodes."
    )
    return all(audit.holds for audit in audits)


def _changes(spec: Spec, path: str) -> Iterator[str]:
    """Yield a line for every key that differs from its default, with its description."""
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        if isinstance(value, Spec):
            yield from _changes(value, f"{path}.{name}")
        elif value != field.default:
            yield f"{path}.{name}: {dumps(plain(value))} ({field.description})"
