"""The robot as a MuJoCo model, for an independent engine and for drawing."""

from typing import TYPE_CHECKING, Any

from psmpc_cli.robot.rotations import exp
from psmpc_cli.specs.robot import Attachment, Body, RobotSpec

if TYPE_CHECKING:
    import mujoco


def mujoco_spec(spec: RobotSpec) -> "mujoco.MjSpec":
    """Describe a robot for MuJoCo, in SI units and radians.

    No gravity, damping, contact or joint limits. The base of a planar robot slides along x and y and turns, by joints
    `base.x`, `base.y` and `base.angle`; that of a spatial one has the free joint `base`. Other joints and bodies are
    named as in `RobotSpec.bodies`; the sites `base` and `<arm>` are the frames of poses. `qpos` and `qvel` are Q and v,
    but where an arm is mounted on another one MuJoCo orders the joints by depth. MuJoCo needs three moments of
    inertia: of a planar body all are the planar one, and the two about axes in the plane have no effect.
    """
    import mujoco

    robot = mujoco.MjSpec()
    robot.modelname = spec.name
    robot.option.gravity = [0, 0, 0]
    robot.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    added: list[Any] = []
    for body in spec.bodies:
        carrier = robot.worldbody if body.joint is None else added[body.joint.at.body]
        place = {} if body.joint is None else _place(body.joint.at)
        added.append(carrier.add_body(name=body.name, **place, **_inertial(body, spec.dimension)))
        if body.joint is not None:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if body.joint.prismatic else mujoco.mjtJoint.mjJNT_HINGE
            added[-1].add_joint(name=body.name, type=kind, axis=body.joint.axis)
        elif spec.dimension == 3:
            added[-1].add_freejoint(name="base")
        else:
            for name, axis in (("base.x", [1, 0, 0]), ("base.y", [0, 1, 0])):
                added[-1].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            added[-1].add_joint(name="base.angle", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    added[0].add_site(name="base")
    for name, tool in spec.tools.items():
        added[tool.body].add_site(name=name, **_place(tool))
    return robot


def _inertial(body: Body, dimension: int) -> dict[str, Any]:
    """Return the inertial parameters of a body."""
    given = {"mass": body.mass, "ipos": body.centre, "explicitinertial": True}
    if dimension == 2:
        return {**given, "inertia": [body.inertia[2]] * 3}
    return {**given, "fullinertia": body.inertia}


def _place(at: Attachment) -> dict[str, Any]:
    """Return position [m] and orientation of a frame in its parent."""
    return {"pos": at.position, "quat": exp(at.rotation)}
