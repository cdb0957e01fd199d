"""What a solver or a controller cannot do."""

from collections.abc import Iterator

from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.task import ControllerSpec, SolverSpec


def check_mesh(task: Cursor) -> Iterator[Fault]:
    """Give an automatic mesh under a controller whose levels share one."""
    controller = task["controller"].valid(ControllerSpec) if task["controller"].exists else None
    if controller is not None and controller.kind == "htmpc" and controller.nodes == "auto":
        why = "whose levels are compared node by node"
        yield task["controller"]["nodes"].problem(f"found auto with controller htmpc, {why}; expected a whole number")


def check_solver(task: Cursor) -> Iterator[Fault]:
    """Give a deadline for a back-end that cannot stop early."""
    solver = task["solver"].valid(SolverSpec) if task["solver"].exists else SolverSpec()
    controller = task["controller"].valid(ControllerSpec) if task["controller"].exists else ControllerSpec()
    if solver is None or solver.deadline is None:
        return
    found = f"found {solver.deadline:g} s"
    if solver.kind == "fatrop":
        yield task["solver"]["deadline"].problem(
            f"{found} with solver fatrop, which cannot stop early; expected none, or kind: sqp or ipopt"
        )
    elif solver.kind == "sqp" and controller is not None and controller.kind == "htmpc":
        why = "whose levels fatrop solves, which cannot stop early"
        yield task["solver"]["deadline"].problem(f"{found} with controller htmpc, {why}; expected none, or kind: ipopt")
