"""The plants by their name in a task file."""

from psmpc_cli.plant.base import Plant, Ticks
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import PlantSpec

__all__ = ["Plant", "Ticks", "build_plant"]


def build_plant(spec: PlantSpec, model: RobotModel) -> Plant:
    """Return the plant a task asks for."""
    tick = 1.0 / spec.low_level_rate
    if spec.kind == "ideal":
        return IdealPlant(model, tick)
    return Rk4Plant(model, tick, round(tick / (spec.step or tick)))
