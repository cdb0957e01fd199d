"""The robot as a MuJoCo model, for an independent engine and for drawing."""

from typing import TYPE_CHECKING, Any

import numpy as np

from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.rotations import exp
from psmpc_cli.specs.robots.robot import Attachment, Body, RobotSpec

if TYPE_CHECKING:
    import mujoco


OBJECT = "the object"
"""Name of the body of an object, which no arm has."""

WHEEL_MASS = 1e-12
"""Mass of the body of a wheel, whose own is part of the base's [kg]."""

TINY = 1e-12
"""Inertia of a wheel about axes across its own, over that about it."""

TURNED_BACK = 1e-12
"""By so much the cosine of an axis may differ from -1 where it is opposite to z."""


def mujoco_spec(
    spec: RobotSpec, target_object: FreeBody | None = None, inertial: InertialParameters | None = None
) -> "mujoco.MjSpec":
    """Describe a robot for MuJoCo, in SI units and radians, without gravity, damping, contact or limits of joints.

    - Base: in the plane it has joints `base.x`, `base.y` and `base.angle`, in space the free joint `base`; a fixed base
      has none.
    - Bodies and other joints are named as in `RobotSpec.bodies`. The sites `base` and `<arm>` are the frames of poses.
    - State: `qpos` and `qvel` are Q and v, except that MuJoCo orders joints by depth if an arm is mounted on another.
    - Inertia: MuJoCo needs three moments. A planar body has its one moment about all axes; those about axes in the
      plane have no effect.
    - A reaction wheel is a body on a hinge at the base's centre of mass, `wheel.1` and so on, with `WHEEL_MASS`. Its
      inertia is the same about all axes here, because MuJoCo's compiler takes no body that is inert about one axis
      alone; `set_wheel_inertias` corrects the compiled model.
    - What a gripper holds is a body of its own in it.

    Args:
        spec: The robot.
        target_object: A further free body, with joints after the robot's; by default there is none.
        inertial: Inertial parameters, and what the grippers hold; by default those of the description.

    Returns:
        The model, to be compiled by MuJoCo.
    """
    import mujoco

    parameters = inertial or InertialParameters.nominal(spec)
    robot = mujoco.MjSpec()
    robot.modelname = spec.name
    robot.option.gravity = [0, 0, 0]
    robot.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    base, *links = spec.bodies
    moves = spec.moved_by.moves
    # a fixed base may have no mass, which MuJoCo only takes of a body that says nothing of it
    added: list[Any] = [
        robot.worldbody.add_body(name=base.name, **(_inertia_fields(base, parameters, 0) if moves else {}))
    ]
    if moves:
        _add_free_joints(added[0], "base", spec.dimension)
    added[0].add_site(name="base")
    for name, wheel in zip(wheel_names(spec), spec.wheels, strict=True):
        inertia_fields = {
            "inertia": [wheel.inertia] * 3,
            "mass": WHEEL_MASS,
            "ipos": [0, 0, 0],
            "explicitinertial": True,
        }
        wheel_body = added[0].add_body(name=name, pos=spec.bodies[0].centre, **inertia_fields)
        axis = wheel.direction if len(wheel.direction) == 3 else (0.0, 0.0, 1.0)
        wheel_body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    for number, (link, joint) in enumerate(zip(links, spec.joints, strict=True), start=1):
        carrier = added[joint.at.body]
        added.append(
            carrier.add_body(name=link.name, **_frame_fields(joint.at), **_inertia_fields(link, parameters, number))
        )
        kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.prismatic else mujoco.mjtJoint.mjJNT_HINGE
        added[-1].add_joint(name=link.name, type=kind, axis=joint.axis, armature=joint.armature)
    for number, (name, tool) in enumerate(spec.tools.items()):
        added[tool.body].add_site(name=name, **_frame_fields(tool))
        held = {
            "mass": parameters.held_mass[number],
            "ipos": [0, 0, 0],
            "inertia": [parameters.held_inertia[number]] * 3,
        }
        added[tool.body].add_body(pos=tool.position, explicitinertial=True, **held)
    if target_object is not None:
        body = robot.worldbody.add_body(
            name=OBJECT, mass=target_object.mass, inertia=target_object.moments, explicitinertial=True
        )
        _add_free_joints(body, OBJECT, spec.dimension)
    return robot


def wheel_names(spec: RobotSpec) -> list[str]:
    """Return the names of the bodies and joints of a robot's reaction wheels."""
    return [f"wheel.{number}" for number, _ in enumerate(spec.wheels, start=1)]


def set_wheel_inertias(engine: "mujoco.MjModel", spec: RobotSpec) -> None:
    """Make a compiled robot's wheels inert about their own axes alone; what else of them the base has already."""
    for name, wheel in zip(wheel_names(spec), spec.wheels, strict=True):
        body = engine.body(name).id
        axis = engine.jnt_axis[engine.body_jntadr[body]]
        engine.body_inertia[body] = [TINY * wheel.inertia, TINY * wheel.inertia, wheel.inertia]
        engine.body_iquat[body] = _turning_z_to(axis)
        engine.body_sameframe[body] = 0  # the axes of its inertia are no longer its own


def _turning_z_to(axis: np.ndarray) -> np.ndarray:
    """Return a unit quaternion that turns the z-axis to a unit axis (3,)."""
    x, y, z = axis
    if z < -1 + TURNED_BACK:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + z, -y, x, 0.0])
    return np.asarray(q / np.linalg.norm(q))


def _add_free_joints(body: Any, name: str, dimension: int) -> None:
    """Add the joints of a free body."""
    import mujoco

    if dimension == 3:
        body.add_freejoint(name=name)
        return
    for axis, along in (("x", [1, 0, 0]), ("y", [0, 1, 0])):
        body.add_joint(name=f"{name}.{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=along)
    body.add_joint(name=f"{name}.angle", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])


def _inertia_fields(body: Body, parameters: InertialParameters, number: int) -> dict[str, Any]:
    """Return the inertial parameters of a body."""
    offset = parameters.offset[number]
    moments = parameters.inertia[number]
    centre = np.array(body.centre) + np.pad(offset, (0, 3 - len(offset)))
    inertia = {"inertia": [moments[0]] * 3} if len(moments) == 1 else {"fullinertia": moments}
    return {"mass": parameters.mass[number], "ipos": centre, "explicitinertial": True, **inertia}


def _frame_fields(at: Attachment) -> dict[str, Any]:
    """Return position [m] and orientation of a frame in its parent."""
    return {"pos": at.position, "quat": exp(at.rotation)}
