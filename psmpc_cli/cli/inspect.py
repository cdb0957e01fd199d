"""What a task or robot amounts to and what this machine can do: `psmpc check`, `init`, `schema` and `bench`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from psmpc_cli.cli import options
from psmpc_cli.cli.common import echo, ending_on_signals, live_line, validate
from psmpc_cli.errors import PsmpcError, SpecError


def check(
    files: Annotated[list[str], typer.Argument(help="Robots or tasks: YAML files or built-in names.")],
    changes: options.Changes = None,
    gradients: Annotated[bool, typer.Option("--gradients", help="Audit the gradients of the switch times.")] = False,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the robot or scenario (png, pdf, svg).")
    ] = None,
    force: options.Force = False,
) -> None:
    """Report every problem of robots and tasks by file, line and column; print valid ones as a table."""
    problems = []
    gradients_agree = True
    if figure is not None:
        from psmpc_cli.figures.registry import check_figure

        check_figure(figure, force, "--figure", files)
    for reference in files:
        try:
            gradients_agree &= _check_file(reference, changes or [], gradients, figure, force)
        except PsmpcError as error:
            problems.append(str(error))
    if problems:
        from psmpc_cli.specs.document import counted

        text = "\n".join(problems)
        count = sum(not line.startswith(" ") for line in text.splitlines())  # the others say more of the one before
        raise SpecError(f"{counted(count, 'problem', 'problems')}:\n{text}")
    if not gradients_agree:
        raise typer.Exit(1)


def _check_file(reference: str, changes: list[str], gradients: bool, figure: Path | None, force: bool) -> bool:
    """Print and draw one robot or task, and audit the gradients of a task.

    A task is validated from its text first, before anything heavy is imported, so that mistakes are reported at once.

    Args:
        reference: A YAML file or the name of a built-in robot or task.
        changes: Changes of a task, `PATH=VALUE` each.
        gradients: Whether the gradients of the switch times are audited.
        figure: Where the robot or the scenario of the task is drawn; None for no drawing.
        force: Replace that drawing.

    Returns:
        Whether the gradients agree with their references; True where they are not audited.

    Raises:
        PsmpcError: The robot or task is not valid, or the figure cannot be written.
    """
    from psmpc_cli.specs.load import kind_of_reference, load_robot

    agree = True
    drawn = "scenario"
    if kind_of_reference(reference) == "robot":
        subject: Any = load_robot(reference)
        drawn = "robot"
        from psmpc_cli.cli.descriptions import print_robot

        echo(f"OK: robot {subject.name}")
        print_robot(subject)
    else:
        validate(reference, changes)
        from psmpc_cli.cli.descriptions import print_task
        from psmpc_cli.cli.tables import print_gradients
        from psmpc_cli.ocp.feasibility.checks import load_task, remarks
        from psmpc_cli.ocp.feasibility.forecast import forecast_stages
        from psmpc_cli.specs.document import counted

        subject = load_task(reference, changes)
        forecasts = forecast_stages(subject)
        doubtful = remarks(subject, forecasts)
        found = f", but {counted(len(doubtful), 'remark', 'remarks')} below" if doubtful else ""
        echo(f"OK: task {subject.spec.name}{found}")
        print_task(subject, forecasts)
        if doubtful:
            echo(f"probably not meant:\n{subject.source.report(doubtful)}\n")
        agree = not gradients or print_gradients(subject)
    if figure is not None:
        from psmpc_cli.figures.registry import draw_file

        echo(f"{drawn}: {draw_file(drawn, subject, figure, force)}")
    return agree


def tasks() -> None:
    """List the built-in tasks and robots, with what each shows."""
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.specs.library import built_ins
    from psmpc_cli.specs.load import load_robot, load_task

    loaded = {name: load_task(name) for name in built_ins("task")}
    rows = [(name, task.robot.name, task.spec.description or "") for name, task in loaded.items()]
    print_table(("task", "robot", "what it shows"), rows, left_aligned=3)
    echo()
    robots = {name: load_robot(name) for name in built_ins("robot")}
    robot_rows = [
        (name, "plane" if robot.dimension == 2 else "space", ", ".join(robot.arms), str(len(robot.joints)))
        for name, robot in robots.items()
    ]
    print_table(("robot", "moves in", "arms", "joints"), robot_rows, left_aligned=3)
    echo("psmpc check NAME prints one; psmpc simulate TASK runs one; psmpc init DIR copies all")


def init(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to copy to; made if necessary.", show_default=False)
    ],
    force: options.Force = False,
) -> None:
    """Copy the built-in robots and tasks, to edit them."""
    from psmpc_cli.logs.files import STARTER, check_output, write_new
    from psmpc_cli.specs.library import starter_files, starter_sources

    files = starter_files(directory)
    for path in files:
        check_output(path, force, STARTER, "DIR", starter_sources())  # of all before any is written
    for path, text in files.items():
        write_new(path, text.encode(), force, STARTER, "DIR", starter_sources())
    for path in sorted(files):
        echo(str(path))


def schema(
    kind: Annotated[
        Literal["robot", "task"] | None, typer.Argument(help="Which of the two. Default: both.", show_default=False)
    ] = None,
) -> None:
    """Print the JSON Schema of robot and task descriptions, for editors."""
    from psmpc_cli.specs.library import KINDS, json_schema

    schemas = {each: json_schema(each) for each in KINDS} if kind is None else json_schema(kind)
    echo(json.dumps(schemas, indent=2))


def bench(
    task: options.Task = "transport",
    nodes: Annotated[
        str | None, typer.Option(metavar="N,...", help="Intervals of each stage. Default: 25,50,100,200,auto.")
    ] = None,
    solvers: Annotated[
        str, typer.Option(metavar="NAME,...", help="Back-ends; piqp is sqp without compiled code.")
    ] = "sqp,piqp,fatrop,ipopt",
    repeat: Annotated[int | None, typer.Option(min=1, metavar="N", help="Solves of each window. Default: 3.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Less than a minute: few windows, coarse meshes.")] = False,
    changes: options.Changes = None,
    quiet: options.Quiet = False,
) -> None:
    """Time the solves of windows recorded from real runs: every back-end, warm and cold, against CasADi with IPOPT."""
    validate(task, changes)
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.studies import bench as study

    tasks = study.load_bench(task, changes or [], nodes or ("25,50" if quick else study.NODES))
    repeat = repeat or (1 if quick else 3)
    appends = 2 if quick else None  # samples at which a stage enters the window, with a cold start; None: all of a run
    with ending_on_signals("no table was made") as interruption, live_line(quiet) as line:
        measured = study.run_bench(tasks, solvers, repeat, appends, line.show, interruption.raise_if_signalled)
    print_table(study.HEADINGS, list(study.bench_rows(measured)), left_aligned=3)
    echo(f"{study.NOTE}\n\n{study.describe_machine(measured)}")
