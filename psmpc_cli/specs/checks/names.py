"""Names that a task speaks of exist: skills, stages, coordinates, controllers."""

from collections.abc import Iterator, Sequence

from psmpc_cli.specs.checks.parts import joints, space_of_stage
from psmpc_cli.specs.coordinates import Space, labels, names, rows
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, choice, dotted, quoted
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import ControllerSpec, SolverSpec

CONTROLLERS = ("psmpc", "smpc", "hard", "htmpc")
"""Controllers that published runs may be of."""

_JOINT_INPUT_ONLY = {
    "fatrop": "which does not come back from its windows",
    "sqp": "whose unknowns are the velocities between constant accelerations of Q",
}
"""Why solvers cannot do with task-space input."""


def stage_names(task: Cursor) -> list[str]:
    """Return the names of the stages that have one."""
    return [name for stage in task["stages"].entries() if (name := stage["name"].text) is not None]


def check_names(task: Cursor) -> Iterator[Fault]:
    """Give names of skills, stages and controllers that mean nothing, and names that are taken."""
    stages = stage_names(task)
    yield from _taken(task["stages"])
    yield from _taken(task["monitors"])
    for stage in task["stages"].entries():
        yield from _unknown(stage["skill"], [name for name, _ in task["skills"].items()])
    for key in ("taken_by", "let_go_by"):
        yield from _unknown(task["object"][key], stages)
    for monitor in task["monitors"].entries():
        yield from _unknown(monitor["during"], stages)
    for controller, run in task["published"].items():
        if controller not in CONTROLLERS:
            yield run.problem(f"found no such controller{choice(controller, CONTROLLERS)}", at_key=True)
        for key in ("switch_time", "actual_start"):
            for name, instant in run[key].items():
                if name not in stages:
                    yield instant.problem(f"found no such stage{choice(name, stages)}", at_key=True)


def check_input(task: Cursor) -> Iterator[Fault]:
    """Give skills in task-space input where solver or controller cannot do with them."""
    solver = task["solver"].valid(SolverSpec) if task["solver"].exists else SolverSpec()
    controller = task["controller"].valid(ControllerSpec) if task["controller"].exists else ControllerSpec()
    for _, skill in task["skills"].items():
        if skill["input"].text != "task":
            continue
        if solver is not None and solver.kind in _JOINT_INPUT_ONLY:
            found = f'found "task" with solver {solver.kind}, {_JOINT_INPUT_ONLY[solver.kind]}'
            yield skill["input"].problem(f'{found}; expected "joint", or solver: ipopt')
        if controller is not None and controller.kind == "htmpc":
            found = 'found "task" with controller htmpc, whose levels share the acceleration of Q'
            yield skill["input"].problem(f'{found}; expected "joint"')


def check_coordinates(task: Cursor, robot: RobotSpec) -> Iterator[Fault]:
    """Give names of coordinates and frames that the robot does not have."""
    for stage in task["stages"].entries():
        space = space_of_stage(task, stage)
        if space is not None:
            yield from _unknown_entries(stage["ends_when"]["coordinates"], names(robot, space))
            yield from _without_tolerance(stage["ends_when"], robot, space)
        yield from _unknown_entries(stage["onset"], names(robot, "joint"))
    for monitor in task["monitors"].entries():
        yield from _unknown_entries(monitor["of"], tuple(robot.parts))


def _without_tolerance(condition: Cursor, robot: RobotSpec, space: Space) -> Iterator[Fault]:
    """Give the parts that a condition speaks of but a tolerance by part leaves out."""
    valid = names(robot, space)
    chosen = [name.text for name in condition["coordinates"].entries() if name.text in valid]
    labelled = labels(robot, space)
    parts = {labelled[row].rpartition(".")[0] for row in rows([name for name in chosen if name], robot, space)}
    given = {part for key, _ in condition["tolerance"].items() for part in joints(key, robot.parts)}
    if given and parts - given:
        missing = ", ".join(part for part in robot.parts if part in parts - given)
        yield condition["tolerance"].problem(f"found {', '.join(sorted(given))}, expected also {missing}", True)


def _taken(places: Cursor) -> Iterator[Fault]:
    """Give names of entries that an earlier entry has."""
    first: dict[str, Cursor] = {}
    for place in places.entries():
        name = place["name"].text
        if name is None:
            continue
        if name in first:
            earlier = dotted(first[name].path)
            yield place["name"].problem(f"found {quoted(name)} again (first at {earlier}), expected a name of its own")
        first.setdefault(name, place)


def _unknown(place: Cursor, valid: Sequence[str]) -> Iterator[Fault]:
    """Give a text that is none of the valid ones."""
    if place.text is not None and valid and place.text not in valid:
        yield place.problem(f"found {place.found}{choice(place.text, valid)}")


def _unknown_entries(places: Cursor, valid: Sequence[str]) -> Iterator[Fault]:
    for place in places.entries():
        yield from _unknown(place, valid)
