"""An experiment: a loaded task with its model, controller and plant, ready to run."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control import build_controller
from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.onset import OnsetObserver
from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.plant import Plant, build_plant
from psmpc_cli.plant.uncertainty import Uncertainty
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.simulation.compiling import compile_for
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import SolverSpec, TaskSpec

COMPARED = 30
"""Iterations of `sqp` where windows are solved from several guesses: it rarely needs as many."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything one run needs. Controller, observer and plant hold state: build a new experiment for every run.

    `compiled` says whether solver and plant run as compiled C.
    """

    loaded: Task
    model: RobotModel
    stages: tuple[Stage, ...]
    costs: StageCosts
    controller: SwitchingController
    aside: WindowsAside
    observer: OnsetObserver
    plant: Plant
    uncertainty: Uncertainty
    x0: np.ndarray
    compiled: bool

    @property
    def task(self) -> TaskSpec:
        """The task."""
        return self.loaded.spec


def build_experiment(loaded: Task) -> Experiment:
    """Return the experiment a task describes."""
    task, model = loaded.spec, build_model(loaded.robot)
    stages, costs = build_stages(task, loaded.robot, model), StageCosts(model)
    compiled = compile_for(task, model, stages)
    windows = WindowSolver(task.model_copy(update={"solver": _solver_in_force(task, compiled)}), model, costs)
    controller = build_controller(task.controller, stages, windows)
    aside, uncertainty = WindowsAside(controller), Uncertainty(task, model)
    Qdot = stack(task.initial_velocity, loaded.robot, "joint") if task.initial_velocity else np.zeros(model.n)
    return Experiment(
        loaded=loaded,
        model=model,
        stages=stages,
        costs=costs,
        controller=controller,
        aside=aside,
        observer=OnsetObserver(aside, task.onset),
        plant=build_plant(task.plant, model, compiled, uncertainty.resistance),
        uncertainty=uncertainty,
        x0=np.r_[stack(task.initial, loaded.robot, "joint"), Qdot],
        compiled=compiled,
    )


def converging(loaded: Task) -> Task:
    """Return the task with a solver that solves each window to its optimum, however long that takes.

    What is asked of single windows, such as a front, is about their optima; in closed loop one iteration a sample is
    enough because the next sample goes on from there.
    """
    solver = loaded.spec.solver
    kind = "fatrop" if solver.kind == "sqp" else solver.kind
    solver = solver.model_copy(update={"kind": kind, "deadline": None})
    return replace(loaded, spec=loaded.spec.model_copy(update={"solver": solver}))


def _solver_in_force(task: TaskSpec, compiled: bool) -> SolverSpec:
    """Return the solver of a run: objectives of several guesses can be compared at their optima alone."""
    solver = task.solver.model_copy(update={"compiled": compiled})
    if solver.kind != "sqp" or (task.controller.multistart or 1) == 1:
        return solver
    return solver.model_copy(update={"iterations": max(solver.iterations, COMPARED)})
