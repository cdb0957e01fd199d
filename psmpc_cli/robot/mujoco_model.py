"""The robot as a MuJoCo model, for an independent engine and for drawing; `qpos` and `qvel` are Q and Qdot."""

from math import cos, sin
from typing import TYPE_CHECKING, Any

from psmpc_cli.specs.robot import Arm, RobotSpec

if TYPE_CHECKING:
    import mujoco


def mujoco_spec(spec: RobotSpec) -> "mujoco.MjSpec":
    """Describe a planar robot for MuJoCo, in SI units and radians.

    No gravity, damping, contact or joint limits. The base slides along x and y and turns; joints are named
    `<part>.<coordinate>` (`base.x`, `base.y`, `base.angle`, `arm_1.1`, ...) and bodies as in `body_names`; the sites
    `base` and `<arm>` are the frames of xi. MuJoCo needs three moments of inertia; all are the planar one, and the two
    about axes in the plane have no effect.
    """
    import mujoco

    robot = mujoco.MjSpec()
    robot.modelname = spec.name
    robot.option.gravity = [0, 0, 0]
    robot.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    base = robot.worldbody.add_body(name="base", **_inertial(spec.base.mass, spec.base.inertia, 0.0))
    for name, axis in (("base.x", [1, 0, 0]), ("base.y", [0, 1, 0])):
        base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    _add_hinge(base, "base.angle")
    base.add_site(name="base")
    for name, arm in spec.arms.items():
        _add_arm(base, name, arm)
    return robot


def _add_arm(base: Any, name: str, arm: Arm) -> None:
    """Add the links of an arm, the first one to the base and each further one to the one before."""
    parent, place = base, _place(*arm.mount.position, arm.mount.angle)
    for number, link in enumerate(arm.links, start=1):
        parent = parent.add_body(name=f"{name}.{number}", **place, **_inertial(link.mass, link.inertia, link.a))
        _add_hinge(parent, f"{name}.{number}")
        place = _place(link.a + link.b, 0.0, 0.0)
    parent.add_site(name=name, **_place(arm.links[-1].a + arm.links[-1].b, 0.0, arm.tool.angle))


def _add_hinge(body: Any, name: str) -> None:
    """Add a joint about the plane's normal, undamped and unlimited."""
    import mujoco

    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])


def _inertial(mass: float, inertia: float, x: float) -> dict[str, Any]:
    """Return the inertial parameters of a body: mass [kg], inertia [kg m^2], centre of mass (x, 0) [m]."""
    return {"mass": mass, "inertia": [inertia] * 3, "ipos": [x, 0, 0], "explicitinertial": True}


def _place(x: float, y: float, angle: float) -> dict[str, Any]:
    """Return position (x, y) [m] and orientation [rad] of a frame in its parent."""
    return {"pos": [x, y, 0], "quat": [cos(angle / 2), 0, 0, sin(angle / 2)]}
