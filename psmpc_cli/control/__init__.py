"""Controllers: the moving sequence, warm starts, and what each sample decides."""

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.htmpc import HierarchicalController
from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.specs.task import ControllerSpec


def build_controller(spec: ControllerSpec, stages: tuple[Stage, ...], windows: WindowSolver) -> SwitchingController:
    """Return the controller a task asks for."""
    if spec.kind == "htmpc":
        return HierarchicalController(spec, spec.htmpc, stages, windows)
    return SwitchingController(spec, stages, windows)
