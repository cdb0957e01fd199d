"""Simulated physics of a robot under its low-level controller, and what disturbs them.

A plant is the module here that its `kind` names, with a function `build`.
"""

from collections.abc import Callable
from dataclasses import replace
from pkgutil import resolve_name

from psmpc_cli.errors import InputError
from psmpc_cli.plant.base import Disturbance, ForceLimits, JointFriction, Plant, Setpoints, Ticks
from psmpc_cli.plant.grasp import Capture, PlantSetup
from psmpc_cli.plant.mount import MountedPlant
from psmpc_cli.plant.thrusters import ThrusterFiring
from psmpc_cli.plant.wheels import WheelDrive, WheelTicks
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.controller import PlantSpec

__all__ = [
    "Disturbance",
    "ForceLimits",
    "JointFriction",
    "Plant",
    "PlantSetup",
    "Setpoints",
    "Ticks",
    "WheelDrive",
    "WheelTicks",
    "build_plant",
    "require_plant",
    "ticks_of",
]


def build_plant(
    spec: PlantSpec,
    model: RobotModel,
    native: bool = False,
    friction: JointFriction | None = None,
    capture: Capture | None = None,
    force_limits: ForceLimits | None = None,
    firing: ThrusterFiring | None = None,
    drive: WheelDrive | None = None,
    is_held: bool = False,
) -> Plant:
    """Build the plant of a task: the simulated physics that takes the place of the real robot.

    Args:
        spec: Which plant, and its steps.
        model: The robot as its controller knows it.
        native: Whether to run as compiled C, where the plant can.
        friction: Friction of joints of a disturbed plant; None for an undisturbed one.
        capture: An object with a mass and its grasps.
        force_limits: Limits at which the force of the low-level law is cut; None where nothing limits it.
        firing: Thrusters that give the force on the base; None where the plant applies the law's force itself. With
            thrusters there are force limits.
        drive: Drive of the reaction wheels; None of a robot without any.
        is_held: Whether a mount holds the base, which moves otherwise, in some stages of the task.

    Returns:
        The plant. Where a mount holds the base at times, it consists of two: one of the robot with a moving base, and
        one with a fixed base.

    Raises:
        InputError: A package that the plant needs is not installed, or does not work.
    """
    tick, substeps = ticks_of(spec)
    setup = PlantSetup(model, tick, substeps, native, friction, capture, force_limits, firing, drive)
    build = require_plant(spec)
    plant = build(setup)
    if is_held:
        held = build(replace(setup, model=model.mounted, firing=None))
        return MountedPlant(model, plant, held, firing)
    return plant


def require_plant(spec: PlantSpec) -> Callable[[PlantSetup], Plant]:
    """Import the module of a kind of plant and return its function `build`, or say which package is missing.

    Plants are imported only when they are used: MuJoCo is an optional package.

    Args:
        spec: Names the kind, which is also the name of the module in this folder.

    Raises:
        InputError: A package that the plant needs is not installed, or does not work.
    """
    try:
        build: Callable[[PlantSetup], Plant] = resolve_name(f"{__name__}.{spec.kind}:build")
    except Exception as error:  # a package that is installed may fail in any way, such as by a library it cannot load
        package = (error.name if isinstance(error, ImportError) else None) or spec.kind
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"plant {spec.kind}: found no working package {package} ({reason}); "
            f"install it with pip install 'psmpc[{spec.kind}]', or choose plant rk4"
        ) from None
    return build


def ticks_of(spec: PlantSpec) -> tuple[float, int]:
    """Return the length of a tick of the low-level loop [s], and the number of integrator steps in it."""
    tick = 1.0 / spec.low_level_rate
    return tick, round(tick / (spec.step or tick))
