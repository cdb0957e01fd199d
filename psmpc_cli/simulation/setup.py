"""An experiment: a loaded task with its model, controller and plant, ready to run."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.controller import Controller
from psmpc_cli.ocp.problem import Problem, Stage, StageCosts, build_problem
from psmpc_cli.plant import Plant, build_plant
from psmpc_cli.plant.uncertainty import Uncertainty
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.compiling import compile_for
from psmpc_cli.simulation.counterfactual import Counterfactuals
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything one run needs. Controller, counterfactuals and plant hold state: build a new experiment for every run.

    `compiled` says whether solver and plant run as compiled C.
    """

    problem: Problem
    controller: Controller
    counterfactuals: Counterfactuals
    plant: Plant
    uncertainty: Uncertainty
    x0: np.ndarray
    compiled: bool

    @property
    def loaded(self) -> Task:
        """The task with its robot and their texts."""
        return self.problem.task

    @property
    def task(self) -> TaskSpec:
        """The task."""
        return self.problem.spec

    @property
    def model(self) -> RobotModel:
        """The robot."""
        return self.problem.model

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages."""
        return self.problem.stages

    @property
    def costs(self) -> StageCosts:
        """Errors, costs and end conditions of the stages on arrays."""
        return self.problem.costs


def build_experiment(loaded: Task) -> Experiment:
    """Return the experiment a task describes."""
    problem = build_problem(loaded)
    task, model = problem.spec, problem.model
    compiled = compile_for(task, model, problem.stages)
    controller, uncertainty = Controller(problem), Uncertainty(task, model)
    Qdot = stack(task.initial_velocity, loaded.robot, "joint") if task.initial_velocity else np.zeros(model.n)
    return Experiment(
        problem=problem,
        controller=controller,
        counterfactuals=Counterfactuals(controller),
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
