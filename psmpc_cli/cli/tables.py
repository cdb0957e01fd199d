"""Robots and tasks as tables: in a terminal as wide as it is, elsewhere plain."""

from collections.abc import Iterable, Sequence
from itertools import zip_longest
from math import degrees, floor, isinf

import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.cli.uncertainty import uncertainty_in_words
from psmpc_cli.ocp.feasibility import Outlook
from psmpc_cli.specs.coordinates import AXES, Space, labels, resolve_limits, target_axes
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.messages import counted
from psmpc_cli.specs.priorities import ACCEPTABLE, weigh_stages
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import PrioritiesSpec, StageSpec

PLAIN_WIDTH = 160
"""Columns of a table that goes into a file."""

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
    for line in uncertainty_in_words(spec):
        typer.echo(line)
    sections = [_stage(task, outlook) for outlook in outlooks]
    _print(("stage", "part", "target", "ends within", "distance of reach", "not before"), sections)


def print_robot(robot: RobotSpec) -> None:
    """Print a robot: its bodies, and the limits of its coordinates."""
    typer.echo(f"{robot.name}: {robot.description}" if robot.description else robot.name)
    sections: list[Rows] = [[("base", "", f"{robot.base.mass:g}", f"{robot.base.inertia:g}", "")]]
    for name, arm in robot.arms.items():
        mount = (name, f"at {arm.mount.position[0]:g}, {arm.mount.position[1]:g} m, {degrees(arm.mount.angle):g} deg")
        links = ((f"{link.mass:g}", f"{link.inertia:g}", f"{link.a:g} + {link.b:g}") for link in arm.links)
        sections.append([(*(mount if i == 0 else ("", "")), *link) for i, link in enumerate(links)])
    _print(("part", "mount", "mass [kg]", "inertia [kg m^2]", "a + b [m]"), sections)
    _print(("coordinate", "position", "velocity", "acceleration"), [_limits(robot)])


def _comparisons(priorities: PrioritiesSpec, stages: list[str]) -> str:
    """Say what the priorities are from, and how well that agrees."""
    found, count = weigh_stages(priorities, stages), len(priorities.compare)
    if found.surplus > 0:
        agreement = f"consistency ratio {found.ratio:.2g}, acceptable up to {ACCEPTABLE:g}"
    else:
        agreement = "no more than they need, so nothing tells whether they are consistent"
    return f"priorities from {counted(count, 'comparison', 'comparisons')}: {agreement}"


def _stage(task: Task, outlook: Outlook) -> Rows:
    """Return the rows of one stage, one a part."""
    spec = task.spec.stages[outlook.stage.index]
    space = task.spec.skills[spec.skill].space
    about = [spec.name, f"{spec.skill} ({space})", f"priority {spec.priority:g}"]
    about += [f"follows {outlook.stage.trajectory.times[-1]:g} s"] if outlook.stage.trajectory else []
    about += [f"at least {spec.dwell:g} s"] if spec.dwell else []
    values, ends = _targets(task.robot, outlook, space), _ends(task.robot, outlook, spec, space)
    parts = [(part, values[part], ends[part], _reach(outlook, part)) for part in task.robot.parts]
    earliest = [f"{floor(outlook.earliest_end * 100) / 100:g} s"]
    lines = zip_longest(about, parts, earliest)
    return [(left or "", *(middle or ("",) * 4), right or "") for left, middle, right in lines]


def _targets(robot: RobotSpec, outlook: Outlook, space: Space) -> dict[str, str]:
    """Return the target of every part, of a trajectory its last row, angles in degrees."""
    lengths: dict[str, list[str]] = {part: [] for part in robot.parts}
    angles: dict[str, list[str]] = {part: [] for part in robot.parts}
    numbers = [(part, axis) for part, axes in target_axes(robot.parts, space).items() for axis in axes]
    for (part, axis), value in zip(numbers, outlook.stage.target, strict=True):
        if axis in AXES[:2]:
            lengths[part].append(f"{value:g}")
        else:
            angles[part].append(f"{degrees(value):.4g}")
    to = "to " if outlook.stage.trajectory else ""
    return {
        part: to
        + ", ".join(
            f"{', '.join(found[part])} {unit}" for found, unit in ((lengths, "m"), (angles, "deg")) if found[part]
        )
        for part in robot.parts
    }


def _ends(robot: RobotSpec, outlook: Outlook, spec: StageSpec, space: Space) -> dict[str, str]:
    """Return what ends a stage, by part: a fixed time, or the tolerances of its coordinates."""
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


def _reach(outlook: Outlook, part: str) -> str:
    """Write how far a target is and how far the arm goes."""
    reach = outlook.reaches.get(part)
    return "" if reach is None else f"{reach.distance:.3f} of {reach.full_reach:.3f} m"


def _limits(robot: RobotSpec) -> Rows:
    """Return the limits of every coordinate."""
    limits, rows = resolve_limits(robot), Rows()
    quantities = (
        (limits.position_low, limits.position_high, ""),
        (limits.velocity_low, limits.velocity_high, "/s"),
        (limits.acceleration_low, limits.acceleration_high, "/s^2"),
    )
    for row, label in enumerate(labels(robot, "joint")):
        unit = "m" if label in ("base.x", "base.y") else "rad"
        spans = (_span(float(low[row]), float(high[row]), unit + per) for low, high, per in quantities)
        rows.append((label, *spans))
    return rows


def _span(low: float, high: float, unit: str) -> str:
    """Write a pair of bounds, angles in degrees; nothing where there is none."""
    if isinf(low) and isinf(high):
        return ""
    if unit == "rad":
        low, high, unit = degrees(low), degrees(high), "deg"
    return f"{low:.4g} to {high:.4g} {unit}"


def _print(header: Iterable[str], sections: Iterable[Rows]) -> None:
    """Print a table in sections."""
    terminal = Console().is_terminal
    table = Table(box=box.SIMPLE_HEAD if terminal else None, pad_edge=False)
    for name in header:
        table.add_column(Text(name), overflow="fold")
    for section in sections:
        for row in section:
            table.add_row(*(Text(cell) for cell in row))
        table.add_section()
    if terminal:
        Console().print(table)
        return
    console = Console(width=PLAIN_WIDTH)
    with console.capture() as capture:
        console.print(table)
    typer.echo("\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n")
