"""A task made computable: the robot's model, the stages as numbers, the functions of the skills."""

from dataclasses import dataclass

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Problem:
    """What controllers and solvers need of a task.

    Attributes:
        task: The task.
        model: Its robot as CasADi functions.
        stages: Its stages, resolved for the robot.
        costs: Errors, costs and end conditions of the stages on arrays.
    """

    task: Task
    model: RobotModel
    stages: tuple[Stage, ...]
    costs: StageCosts

    @property
    def spec(self) -> TaskSpec:
        """The task as validated data."""
        return self.task.spec


def build_problem(task: Task) -> Problem:
    """Build the problem of a task."""
    model = build_model(task.robot)
    return Problem(task, model, build_stages(task.spec, task.robot, model), StageCosts(model))
