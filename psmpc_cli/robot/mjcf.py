"""The robot as a MuJoCo model (MJCF text), for an independent engine; its coordinates `qpos`, `qvel` are Q, Qdot."""

from xml.etree import ElementTree

from psmpc_cli.specs.robot import Arm, RobotSpec


def mjcf(spec: RobotSpec) -> str:
    """Write a planar robot as MJCF, in SI units and radians.

    No gravity, damping, contact or joint limits. The base slides along x and y and turns; joints are named
    `<part>.<coordinate>` (`base.x`, `base.y`, `base.angle`, `arm_1.1`, ...), end-effector frames are the sites `<arm>`,
    the base frame is the site `base`, and every arm joint has a motor of its name; a force on the base is the user's to
    apply. MuJoCo wants three moments of inertia; all are the planar one, and the two about axes in the plane never act.
    MuJoCo takes a tool angle of less than about 1e-5 rad for none.
    """
    root = ElementTree.Element("mujoco", model=spec.name)
    ElementTree.SubElement(root, "compiler", angle="radian")
    option = ElementTree.SubElement(root, "option", gravity="0 0 0")
    ElementTree.SubElement(option, "flag", contact="disable")
    world = ElementTree.SubElement(root, "worldbody")
    base = ElementTree.SubElement(world, "body", name="base")
    for name, kind, axis in (("x", "slide", "1 0 0"), ("y", "slide", "0 1 0"), ("angle", "hinge", "0 0 1")):
        _add_joint(base, f"base.{name}", kind, axis)
    _add_inertia(base, spec.base.mass, spec.base.inertia, 0.0)
    ElementTree.SubElement(base, "site", name="base")
    motors = ElementTree.SubElement(root, "actuator")
    for name, arm in spec.arms.items():
        _add_arm(base, name, arm)
        for number in range(1, len(arm.links) + 1):
            ElementTree.SubElement(motors, "motor", name=f"{name}.{number}", joint=f"{name}.{number}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_arm(base: ElementTree.Element, name: str, arm: Arm) -> None:
    """Hang an arm's links into each other, the first one into the base."""
    parent, place = base, _place(*arm.mount.position, arm.mount.angle)
    for number, link in enumerate(arm.links, start=1):
        parent = ElementTree.SubElement(parent, "body", {"name": f"{name}.{number}", **place})
        _add_joint(parent, f"{name}.{number}", "hinge", "0 0 1")
        _add_inertia(parent, link.mass, link.inertia, link.a)
        place = _place(link.a + link.b, 0.0, 0.0)
    tip = arm.links[-1].a + arm.links[-1].b
    ElementTree.SubElement(parent, "site", {"name": name, **_place(tip, 0.0, arm.tool.angle)})


def _add_joint(body: ElementTree.Element, name: str, kind: str, axis: str) -> None:
    """Add an undamped, unlimited joint."""
    ElementTree.SubElement(
        body, "joint", name=name, type=kind, axis=axis, damping="0", armature="0", frictionloss="0", limited="false"
    )


def _add_inertia(body: ElementTree.Element, mass: float, inertia: float, x: float) -> None:
    """Give a body its mass [kg] and inertia [kg m^2] at (x, 0) [m] of its frame."""
    ElementTree.SubElement(
        body, "inertial", pos=_text(x, 0, 0), mass=_text(mass), diaginertia=_text(inertia, inertia, inertia)
    )


def _place(x: float, y: float, angle: float) -> dict[str, str]:
    """Attributes that place a frame at (x, y) [m], turned by `angle` [rad], in its parent."""
    return {"pos": _text(x, y, 0), "axisangle": _text(0, 0, 1, angle)}


def _text(*numbers: float) -> str:
    """Numbers as MJCF has them, in all their digits."""
    return " ".join(repr(float(number)) for number in numbers)
