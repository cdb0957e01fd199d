"""The robot as a MuJoCo model, for an independent engine and for drawing."""

from typing import TYPE_CHECKING, Any

from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.rotations import exp
from psmpc_cli.specs.robot import Attachment, Body, RobotSpec

if TYPE_CHECKING:
    import mujoco


OBJECT = "the object"
"""Name of the body of an object, which no arm has."""


def mujoco_spec(spec: RobotSpec, thing: FreeBody | None = None) -> "mujoco.MjSpec":
    """Describe a robot for MuJoCo, in SI units and radians.

    No gravity, damping, contact or joint limits. The base of a planar robot slides along x and y and turns, by joints
    `base.x`, `base.y` and `base.angle`; that of a spatial one has the free joint `base`. Other joints and bodies are
    named as in `RobotSpec.bodies`; the sites `base` and `<arm>` are the frames of poses. `qpos` and `qvel` are Q and v,
    but where an arm is mounted on another one MuJoCo orders the joints by depth. MuJoCo needs three moments of
    inertia: of a planar body all are the planar one, and the two about axes in the plane have no effect. A `thing` is a
    further free body, its joints after the robot's.
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
            _add_planar_joints(added[-1], "base")
    added[0].add_site(name="base")
    for name, tool in spec.tools.items():
        added[tool.body].add_site(name=name, **_place(tool))
    if thing is not None:
        moments = [*thing.inertia] * (3 if spec.dimension == 2 else 1)
        body = robot.worldbody.add_body(name=OBJECT, mass=thing.mass, inertia=moments, explicitinertial=True)
        if spec.dimension == 3:
            body.add_freejoint(name=OBJECT)
        else:
            _add_planar_joints(body, OBJECT)
    return robot


def _add_planar_joints(body: Any, name: str) -> None:
    """Let a body move in the plane."""
    import mujoco

    for axis, along in (("x", [1, 0, 0]), ("y", [0, 1, 0])):
        body.add_joint(name=f"{name}.{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=along)
    body.add_joint(name=f"{name}.angle", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])


def _inertial(body: Body, dimension: int) -> dict[str, Any]:
    """Return the inertial parameters of a body."""
    given = {"mass": body.mass, "ipos": body.centre, "explicitinertial": True}
    if dimension == 2:
        return {**given, "inertia": [body.inertia[2]] * 3}
    return {**given, "fullinertia": body.inertia}


def _place(at: Attachment) -> dict[str, Any]:
    """Return position [m] and orientation of a frame in its parent."""
    return {"pos": at.position, "quat": exp(at.rotation)}
