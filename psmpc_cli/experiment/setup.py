"""An experiment: a loaded task with its model, controller and plant, ready to run."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control import build_controller
from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.onset import OnsetObserver
from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.experiment.compiling import compiled_in_force
from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.plant import Plant, build_plant
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.robot.quantities import Quantities
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import LoadedTask
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything one run needs. Controller, observer and plant hold state: build a new experiment for every run.

    `compiled` says whether solver and plant run as compiled C.
    """

    loaded: LoadedTask
    model: RobotModel
    stages: tuple[Stage, ...]
    costs: StageCosts
    quantities: Quantities
    controller: SwitchingController
    aside: WindowsAside
    observer: OnsetObserver
    plant: Plant
    x0: np.ndarray
    compiled: bool

    @property
    def task(self) -> TaskSpec:
        """The task."""
        return self.loaded.spec


def build_experiment(loaded: LoadedTask) -> Experiment:
    """Return the experiment a task describes."""
    task, model = loaded.spec, build_model(loaded.robot)
    stages, costs = build_stages(task, loaded.robot, model), StageCosts(model)
    compiled = compiled_in_force(task, model, stages)
    solver = task.solver.model_copy(update={"compiled": compiled})
    windows = WindowSolver(task.model_copy(update={"solver": solver}), model, costs)
    controller = build_controller(task.controller, stages, windows)
    aside = WindowsAside(controller)
    Qdot = stack(task.initial_velocity, loaded.robot, "joint") if task.initial_velocity else np.zeros(model.n)
    return Experiment(
        loaded=loaded,
        model=model,
        stages=stages,
        costs=costs,
        quantities=Quantities(model),
        controller=controller,
        aside=aside,
        observer=OnsetObserver(aside, task.onset),
        plant=build_plant(task.plant, model, compiled),
        x0=np.r_[stack(task.initial, loaded.robot, "joint"), Qdot],
        compiled=compiled,
    )
