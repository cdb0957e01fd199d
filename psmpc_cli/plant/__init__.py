"""Simulated physics of a robot under its low-level controller: ideal, rk4, mujoco, and what disturbs them."""

from psmpc_cli.errors import InputError
from psmpc_cli.plant.base import Disturbance, Plant, Resistance, Ticks
from psmpc_cli.plant.grasp import Capture, CapturePlant
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.rk4 import Rk4Plant, Rk4Step
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import PlantSpec

__all__ = ["Disturbance", "Plant", "Resistance", "Ticks", "build_plant", "ticks_of"]


def build_plant(
    spec: PlantSpec,
    model: RobotModel,
    native: bool = False,
    resistance: Resistance | None = None,
    capture: Capture | None = None,
) -> Plant:
    """Build the plant of a task.

    Args:
        spec: Which plant.
        model: The robot as its controller knows it.
        native: Whether to run as compiled C, where the plant can.
        resistance: Friction and force limits of a disturbed plant; None for an undisturbed one.
        capture: An object with a mass and its grasps.

    Raises:
        InputError: The plant's package is not installed.
    """
    tick, substeps = ticks_of(spec)
    if spec.kind == "ideal":
        return IdealPlant(model, tick)
    if spec.kind == "rk4" and capture is not None:
        return CapturePlant(capture, Rk4Step(capture.law, capture.body, tick, substeps, native, resistance), resistance)
    if spec.kind == "rk4":
        return Rk4Plant(model, tick, substeps, native, resistance)
    try:
        from psmpc_cli.plant.mujoco_plant import MujocoPlant, MujocoStep
    except ImportError as error:
        raise InputError(
            f"plant mujoco: found no working package mujoco ({error}); "
            "install it with pip install 'psmpc[mujoco]', or choose plant rk4"
        ) from None
    if capture is not None:
        return CapturePlant(capture, MujocoStep(capture.law, capture.body, tick, substeps, resistance), resistance)
    return MujocoPlant(model, tick, substeps, resistance)


def ticks_of(spec: PlantSpec) -> tuple[float, int]:
    """Return the length of a tick of the low-level loop [s], and the number of integrator steps in it."""
    tick = 1.0 / spec.low_level_rate
    return tick, round(tick / (spec.step or tick))
