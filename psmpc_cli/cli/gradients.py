"""The audit of a task's gradients as a table."""

from psmpc_cli.simulation.gradient_audit import AD_TOLERANCE, DIFFERENCE_TOLERANCE, audit_gradients
from psmpc_cli.simulation.setup import build_experiment, converging
from psmpc_cli.specs.load import Task


def print_gradients(task: Task) -> bool:
    """Audit the gradient at every switch of a task, print it, and return whether it holds."""
    from rich.console import Console
    from rich.table import Table

    audits = audit_gradients(build_experiment(converging(task)))
    nodes = task.spec.controller.uniform_nodes
    table = Table(box=None, pad_edge=False, title="Gradient of the cost by the switching instant", title_justify="left")
    table.add_column("switch")
    for heading in (
        "dJ/dt_s [1/s]",
        "adjoint - AD",
        "adjoint - differences",
        f"costate gap, N_s = {nodes}",
        f"N_s = {2 * nodes}",
        "holds",
    ):
        table.add_column(heading, justify="right")
    for audit in audits:
        table.add_row(
            " to ".join(audit.switch),
            f"{audit.gradient:.4f}",
            f"{audit.to_differentiation:.1e}",
            f"{audit.to_differences:.1e}",
            *(f"{gap:.1e}" for gap in audit.costate_gaps),
            "yes" if audit.holds else "NO",
        )
    console = Console(highlight=False)
    console.print(table)
    console.print(
        f"Differences are relative; asked for: {AD_TOLERANCE:g} and {DIFFERENCE_TOLERANCE:g}. The costate formula's "
        "gap, taken at an optimum without limits and end conditions, halves with twice the nodes.",
        soft_wrap=True,
    )
    return all(audit.holds for audit in audits)
