"""`psmpc check`: what is wrong with robots and tasks, and what a task amounts to."""

from pathlib import Path

import typer

from psmpc_cli.errors import PsmpcError, SpecError


def check(
    files: list[str] = typer.Argument(..., help="Robots or tasks: YAML files or built-in names.", show_default=False),
    changes: list[str] = typer.Option(
        [], "--set", metavar="PATH=VALUE", help="Change any key of the tasks; repeatable."
    ),
    gradients: bool = typer.Option(False, "--gradients", help="Audit the gradients of the tasks' switching instants."),
    figure: Path | None = typer.Option(
        None, "--figure", metavar="FILE", help="Draw the task's scenario (png, pdf, svg)."
    ),
    force: bool = typer.Option(False, "--force", help="Overwrite the figure."),
) -> None:
    """Report every problem of robots and tasks by file, line and column; print what is right as a table."""
    complaints = []
    for reference in files:
        try:
            present(reference, changes, gradients)
            if figure is not None:
                draw(reference, changes, figure, force)
        except PsmpcError as error:
            complaints.append(str(error))
    if complaints:
        raise SpecError("\n".join(complaints))


def draw(reference: str, changes: list[str], figure: Path, force: bool) -> None:
    """Draw the scenario of a task; InputError where there is no task or the file cannot be written."""
    from psmpc_cli.errors import InputError
    from psmpc_cli.figures.registry import FORMATS, draw_file
    from psmpc_cli.specs.load import kind_of_reference, load_task

    if figure.suffix[1:] not in FORMATS:
        raise InputError(f"--figure {figure}: found the ending '{figure.suffix}', expected one of {', '.join(FORMATS)}")
    if kind_of_reference(reference) == "robot":
        raise InputError(f"--figure draws the scenario of a task, and {reference} is a robot")
    typer.echo(f"scenario: {draw_file('scenario', load_task(reference, changes), figure, force)}")


def present(reference: str, changes: list[str], gradients: bool) -> None:
    """Print the table of one robot or task, and its gradients if asked for; SpecError if something is wrong with it."""
    from psmpc_cli.cli.gradients import print_gradients
    from psmpc_cli.cli.tables import print_robot, print_task
    from psmpc_cli.ocp.feasibility import look_ahead, remarks, review
    from psmpc_cli.specs.load import kind_of_reference, load_robot, load_task

    if kind_of_reference(reference) == "robot":
        print_robot(load_robot(reference).spec)
        return
    task = load_task(reference, changes)
    outlooks = look_ahead(task)
    problems = review(task, outlooks)
    if problems:
        raise SpecError(task.source.report(problems))
    print_task(task, outlooks)
    doubtful = remarks(task, outlooks)
    if doubtful:
        typer.echo(f"probably not meant:\n{task.source.report(doubtful)}\n")
    if gradients and not print_gradients(task):
        raise typer.Exit(1)
