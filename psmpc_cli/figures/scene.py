"""A run as a scene for MuJoCo's renderer: the robot's MJCF with bodies to look at, a lamp, a floor and a camera."""

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from matplotlib.colors import to_rgb

from psmpc_cli.figures.object_motion import object_pose
from psmpc_cli.figures.robot_drawing import FINGER, View, base_outline, reach, view_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import BODY, OBJECT, PALETTE
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.specs.robot import Arm

WIDTH = 640
"""Width of a frame [px]."""

ELEVATION, FIELD_OF_VIEW = 60.0, 14.0
"""How far above the plane the camera is, and its vertical angle of view [deg]."""

THICKNESS = 0.04
"""Radius of a link, in lengths of the longest arm."""

SQUARE = 1.0
"""Edge of a square of the floor [m]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What is to be drawn.

    Attributes:
        mjcf: The model.
        qpos: Q of every frame (K, n).
        mocap: Pose of the object in every frame (K, 3) [m, m, rad]; (K, 0) without one.
        camera: What it looks at [m], from how far [m], azimuth and elevation [deg], (6,).
        size: Height and width of a frame [px].
    """

    mjcf: str
    qpos: np.ndarray
    mocap: np.ndarray
    camera: np.ndarray
    size: tuple[int, int]


def scene_of(run: Run, times: np.ndarray) -> Scene:
    """Return the scene of a run at these times [s]."""
    poses = [object_pose(run, float(time)) for time in times]
    view = view_of(run, times)
    slope = np.sin(np.radians(ELEVATION))
    size = (2 * round(WIDTH * view.aspect * slope / 2), WIDTH)  # even, as video encoders want
    return Scene(
        mjcf=_model(run, view, size),
        qpos=np.array([run.coordinates_at(float(time)) for time in times]),
        mocap=np.array([[] if pose is None else pose for pose in poses], float),
        camera=camera_on(view, size),
        size=size,
    )


def camera_on(view: View, size: tuple[int, int]) -> np.ndarray:
    """Return the camera (6,) from whose nearest place a whole view is seen, x to the right."""
    corners = np.array([[x, y] for x in view.x for y in view.y])
    middle = corners.mean(axis=0)
    right, along = (corners - middle).T
    elevation = np.radians(ELEVATION)
    up, beyond = along * np.sin(elevation), along * np.cos(elevation)
    tall = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    wide = tall * size[1] / size[0]
    distance = max(np.max(np.abs(right) / wide - beyond), np.max(np.abs(up) / tall - beyond))
    return np.array([*middle, 0.0, distance, 90.0, -ELEVATION])


def _model(run: Run, view: View, size: tuple[int, int]) -> str:
    """Return the robot's MJCF with what is to be seen."""
    root, length = ElementTree.fromstring(mujoco_spec(run.model.spec).to_xml()), reach(run.model)
    world, base = _found(root, "worldbody"), _found(root, ".//body[@name='base']")
    thick = THICKNESS * length
    half = base_outline(run.model, np.zeros(run.model.n)).max(axis=0)
    _add_box(base, (0, 0, 0), (*half, 3 * thick), BODY)
    for index, (name, arm) in enumerate(run.model.spec.arms.items()):
        _dress_arm(root, name, arm, length, PALETTE[index % len(PALETTE)])
    if run.task.object is not None:
        body = ElementTree.SubElement(world, "body", name="target object", mocap="true")
        _add_box(body, (0, 0, 0), (*(side / 2 for side in run.task.object.shape), 0.9 * thick), OBJECT)
    _add_surroundings(root, world, run.model, view, size)
    return ElementTree.tostring(root, encoding="unicode")


def _dress_arm(root: ElementTree.Element, name: str, arm: Arm, length: float, color: str) -> None:
    """Give an arm's links, joints and gripper bodies of a colour."""
    thick, finger = THICKNESS * length, FINGER * length
    for number, link in enumerate(arm.links, start=1):
        body, end = _found(root, f".//body[@name='{name}.{number}']"), link.a + link.b
        _add(body, "capsule", color, fromto=_text(0, 0, 0, end, 0, 0), size=_text(0.7 * thick))
        _add(body, "cylinder", "white", size=_text(thick, 1.1 * thick))
    _add_box(body, (end, 0, 0), (0.2 * thick, 0.7 * finger, 0.7 * thick), color)
    for side in (-0.7, 0.7):
        _add_box(body, (end + finger / 2, side * finger, 0), (finger / 2, 0.2 * thick, 0.7 * thick), color)


def _add_surroundings(
    root: ElementTree.Element, world: ElementTree.Element, model: RobotModel, view: View, size: tuple[int, int]
) -> None:
    """Add a floor of squares, a lamp, and what the renderer has to know."""
    visual, assets = ElementTree.SubElement(root, "visual"), ElementTree.SubElement(root, "asset")
    middle, span = np.mean([view.x, view.y], axis=1), float(np.ptp([view.x, view.y], axis=1).max())
    screen = {"offheight": str(size[0]), "offwidth": str(size[1]), "fovy": _text(FIELD_OF_VIEW)}
    ElementTree.SubElement(visual, "global", screen)
    ElementTree.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.15 0.15 0.15", specular="0 0 0")
    ElementTree.SubElement(visual, "map", zfar="50", znear="0.01")
    ElementTree.SubElement(root, "statistic", extent=_text(span), center=_text(*middle, 0))
    look = {"type": "2d", "builtin": "flat", "mark": "edge", "width": "256", "height": "256"}
    ElementTree.SubElement(assets, "texture", look, name="squares", rgb1="0.97 0.98 0.99", markrgb="0.7 0.7 0.72")
    squares = 2 * int(np.ceil(5 * span / SQUARE))
    material = {"texture": "squares", "texrepeat": _text(squares, squares), "specular": "0"}
    ElementTree.SubElement(assets, "material", material, name="squares")
    place = _text(*np.round(middle / SQUARE) * SQUARE, -4 * THICKNESS * reach(model))
    half = squares * SQUARE / 2
    ElementTree.SubElement(world, "geom", type="plane", size=_text(half, half, 1), pos=place, material="squares")
    lamp = {"directional": "true", "castshadow": "false", "dir": "-0.4 0.3 -1", "specular": "0.1 0.1 0.1"}
    ElementTree.SubElement(world, "light", lamp, diffuse="0.45 0.45 0.45", pos=_text(*middle, span))


def _add_box(body: ElementTree.Element, place: tuple[float, ...], half: tuple[float, ...], color: str) -> None:
    """Add a box to a body, with half its edges [m]."""
    _add(body, "box", color, pos=_text(*place), size=_text(*half))


def _add(body: ElementTree.Element, kind: str, color: str, **attributes: str) -> None:
    """Add a body to look at; it touches nothing and weighs nothing beside the body's own inertia."""
    look = {"type": kind, "rgba": _text(*to_rgb(color), 1), "contype": "0", "conaffinity": "0"}
    ElementTree.SubElement(body, "geom", {**look, **attributes})


def _found(root: ElementTree.Element, path: str) -> ElementTree.Element:
    """Return the element a path leads to, which every robot's MJCF has."""
    (element,) = root.findall(path)
    return element


def _text(*numbers: float) -> str:
    """Numbers as MJCF has them."""
    return " ".join(f"{float(number):.9g}" for number in numbers)
