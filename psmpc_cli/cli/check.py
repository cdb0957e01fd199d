"""`psmpc check`: what is wrong with robots and tasks, and what a task amounts to."""

import typer

from psmpc_cli.errors import PsmpcError, SpecError


def check(
    files: list[str] = typer.Argument(..., help="Robots or tasks: YAML files or built-in names.", show_default=False),
) -> None:
    """Report every problem of robots and tasks by file, line and column; print what is right as a table."""
    complaints = []
    for reference in files:
        try:
            present(reference)
        except PsmpcError as error:
            complaints.append(str(error))
    if complaints:
        raise SpecError("\n".join(complaints))


def present(reference: str) -> None:
    """Print the table of one robot or task; SpecError if something is wrong with it."""
    from psmpc_cli.cli.tables import print_robot, print_task
    from psmpc_cli.ocp.feasibility import remarks, review
    from psmpc_cli.ocp.outlook import look_ahead
    from psmpc_cli.specs.load import kind_of_reference, load_robot, load_task
    from psmpc_cli.specs.report import refusal, report

    if kind_of_reference(reference) == "robot":
        print_robot(load_robot(reference).spec)
        return
    task = load_task(reference)
    outlooks = look_ahead(task)
    problems = review(task, outlooks)
    if problems:
        raise refusal(report(task.source, problems))
    print_task(task, outlooks)
    doubtful = remarks(task, outlooks)
    if doubtful:
        typer.echo(f"probably not meant:\n{report(task.source, doubtful)}\n")
