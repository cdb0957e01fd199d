"""The plants by their name in a task file."""

from psmpc_cli.errors import InputError
from psmpc_cli.plant.base import Plant, Ticks
from psmpc_cli.plant.disturbance import DisturbedPlant, Resistance
from psmpc_cli.plant.disturbed_rk4 import DisturbedRk4Plant
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import PlantSpec

__all__ = ["DisturbedPlant", "Plant", "Ticks", "build_disturbed_plant", "build_plant", "seconds_and_substeps"]


def build_plant(spec: PlantSpec, model: RobotModel, native: bool = False) -> Plant:
    """Return the plant a task asks for, `native` as compiled C where there is that of it.

    Raises:
        InputError: Its package is not installed.
    """
    tick, substeps = seconds_and_substeps(spec)
    if spec.kind == "ideal":
        return IdealPlant(model, tick)
    return _mujoco_plant(model, tick, substeps) if spec.kind == "mujoco" else Rk4Plant(model, tick, substeps, native)


def build_disturbed_plant(
    spec: PlantSpec, model: RobotModel, resistance: Resistance, native: bool = False
) -> DisturbedPlant:
    """Return the plant a task asks for, of a robot that is not quite the one the controller knows.

    Raises:
        InputError: Its package is not installed.
    """
    tick, substeps = seconds_and_substeps(spec)
    if spec.kind == "rk4":
        return DisturbedRk4Plant(model, tick, resistance, substeps, native)
    try:
        from psmpc_cli.plant.disturbed_mujoco import DisturbedMujocoPlant
    except ImportError as error:
        raise _no_mujoco(error) from None
    return DisturbedMujocoPlant(model, tick, resistance, substeps)


def seconds_and_substeps(spec: PlantSpec) -> tuple[float, int]:
    """Return the length of a tick of the low-level loop [s], and the number of integrator steps in it."""
    tick = 1.0 / spec.low_level_rate
    return tick, round(tick / (spec.step or tick))


def _mujoco_plant(model: RobotModel, tick: float, substeps: int) -> Plant:
    """Return MuJoCo as the plant; its package is imported by no other task."""
    try:
        from psmpc_cli.plant.mujoco_plant import MujocoPlant
    except ImportError as error:
        raise _no_mujoco(error) from None
    return MujocoPlant(model, tick, substeps)


def _no_mujoco(error: ImportError) -> InputError:
    return InputError(
        f"plant mujoco: found no working package mujoco ({error}); "
        "install it with pip install 'psmpc[mujoco]', or choose plant rk4"
    )
