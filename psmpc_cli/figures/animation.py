"""The robot moving: an animated drawing, and a film in three dimensions by MuJoCo's offscreen renderer."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures import style
from psmpc_cli.figures.robot_drawing import FINGER, Scene, View, base_half, reach, scene_of
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.specs.robot import RobotSpec

if TYPE_CHECKING:
    import mujoco

RATE, LONGEST = 15, 150
"""Frames a second; most frames of motion."""

WIDTH, DPI = 4.0, 120
"""Width [in] and resolution of a frame of the drawing."""

FILM_WIDTH, TITLE = 640, 36
"""Width of a frame of the film, and height of the title above it [px]."""

ELEVATION, FIELD_OF_VIEW = 60.0, 14.0
"""How far above the plane the camera is, and its vertical angle of view [deg]."""

SURROUNDINGS = """
<mujoco>
  <option gravity="0 0 0"><flag contact="disable"/></option>
  <visual>
    <global offheight="{height}" offwidth="{width}" fovy="{fovy}"/>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.15 0.15 0.15" specular="0 0 0"/>
    <map zfar="50" znear="0.01"/>
  </visual>
  <statistic extent="{span}" center="{x} {y} 0"/>
  <asset>
    <texture name="squares" type="2d" builtin="flat" mark="edge" width="256" height="256" rgb1="0.97 0.98 0.99"
             markrgb="0.7 0.7 0.72"/>
    <material name="squares" texture="squares" texrepeat="{squares} {squares}" specular="0"/>
  </asset>
  <worldbody>
    <geom type="plane" size="{half} {half} 1" pos="{floor_x} {floor_y} {floor}" material="squares"/>
    <light directional="true" castshadow="false" dir="-0.4 0.3 -1" specular="0.1 0.1 0.1" diffuse="0.45 0.45 0.45"
           pos="{x} {y} {span}"/>
  </worldbody>
</mujoco>
"""
"""Light, and a floor of squares with edges of 1 m."""


@dataclass(frozen=True)
class Film:
    """What a film shows, as plain values for another process.

    Attributes:
        robot: The robot.
        half: Half the length and half the width of its base (2,) [m].
        reach: Length of its longest arm [m].
        shape: Length and width of the object [m]; None if there is none.
        view: What is visible of the plane.
        Q: Coordinates of the robot in every frame (K, n) [m, rad].
        poses: Poses of the object in every frame (K, 3) [m, m, rad].
    """

    robot: RobotSpec
    half: np.ndarray
    reach: float
    shape: tuple[float, float] | None
    view: View
    Q: np.ndarray
    poses: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame [px], even, as video encoders want."""
        return 2 * round(FILM_WIDTH * self.view.aspect * np.sin(np.radians(ELEVATION)) / 2), FILM_WIDTH


def film_files(directory: Path, name: str) -> list[Path]:
    """Return the files of an animation or film: a GIF, and an MP4 where ffmpeg is there."""
    return [directory / f"{name}.{ending}" for ending in ("gif", "mp4")[: 1 + mp4_possible()]]


def mp4_possible() -> bool:
    """Return whether an MP4 can be written: whether ffmpeg is there."""
    return bool(FFMpegWriter.isAvailable())


def write_animation(run: Run, paths: Iterable[Path]) -> None:
    """Write the robot's motion as animations, GIF or MP4 by the files' endings.

    Raises:
        RunError: One could not be encoded or written.
    """
    scene, times = scene_of(run), frame_times(run)
    view = scene.view(times)
    height = round((WIDTH * view.aspect + 0.6) * DPI / 2) * 2 / DPI  # even in pixels, as video encoders want
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _draw_frame(axes, scene, run.motion.end, view)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # laid out anew, the axes would move from frame to frame

    def draw_frame(time: float) -> None:
        axes.clear()
        _draw_frame(axes, scene, time, view)

    for path in paths:
        _encode(figure, path, times.tolist(), draw_frame)


def _draw_frame(axes: Axes, scene: Scene, time: float, view: View) -> None:
    scene.draw(axes, time, since=max(time - 3.0, float(scene.run.motion.time[0])), width=1.6)
    view.show(axes)
    axes.set_title(f"t = {time:.1f} s: {', '.join(events_at(scene, time))}", loc="left")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def frame_times(run: Run) -> np.ndarray:
    """Return the time of each frame [s]: evenly spread, no more than there are samples."""
    return np.linspace(run.motion.time[0], run.motion.end, min(LONGEST, len(run.motion.time)))


def events_at(scene: Scene, time: float) -> list[str]:
    """Return what happens at a time [s]: the current stage, those that already act, whether the object is lost."""
    spans = scene.run.spans
    current = [span for span in spans if span.start <= time]
    early = [span for span in spans if span.early is not None and span.early <= time < span.start]
    events = [style.readable(current[-1].name), *(f"{style.readable(span.name)} already acts" for span in early)]
    return events + ["object lost"] * (scene.lost and time >= scene.left)


def _encode(figure: Figure, path: Path, times: Sequence[float], draw_frame: Callable[[float], None]) -> None:
    """Write a figure as it is drawn at each of these times [s], the last one held, GIF or MP4 by the file's ending."""
    writer = PillowWriter(fps=RATE) if path.suffix == ".gif" else FFMpegWriter(fps=RATE)
    try:
        with writer.saving(figure, str(path), DPI):
            for time in [*times, *[times[-1]] * 15]:
                draw_frame(time)
                writer.grab_frame()
    except (OSError, subprocess.CalledProcessError) as error:
        raise RunError(f"{path} could not be written: {error}") from None


def write_film(run: Run, paths: Iterable[Path]) -> None:
    """Write the robot's motion in three dimensions as films, GIF or MP4 by the files' endings.

    Raises:
        InputError: There is no offscreen renderer here.
        RunError: It failed, or a film could not be encoded or written.
    """
    scene, times = scene_of(run), frame_times(run)
    try:
        frames = _in_process(offscreen_driver(), render, film_of(scene, times))
    except _DriverError as error:
        raise RunError(f"MuJoCo's renderer failed: {error}") from None
    height, width = frames.shape[1:3]
    figure = Figure(figsize=(width / DPI, (height + TITLE) / DPI))
    FigureCanvasAgg(figure)
    shown = figure.add_axes((0, 0, 1, height / (height + TITLE))).imshow(frames[0])
    shown.axes.set_axis_off()
    title = figure.text(8 / width, 1 - TITLE / 2 / (height + TITLE), "", va="center")

    def draw_frame(time: float) -> None:
        shown.set_data(frames[np.searchsorted(times, time)])
        title.set_text(f"t = {time:.1f} s: {', '.join(events_at(scene, time))}")

    for path in paths:
        _encode(figure, path, times.tolist(), draw_frame)


def film_of(scene: Scene, times: np.ndarray) -> Film:
    """Return what a film of a scene shows at these times [s]."""
    model, spec = scene.run.problem.model, scene.run.task.spec.object
    Q = np.array([scene.run.motion.coordinates_at(time) for time in times])
    poses = np.zeros((len(times), 3)) if spec is None else np.array([scene.object_pose(time) for time in times])
    shape = None if spec is None else spec.shape
    return Film(model.spec, base_half(model), reach(model), shape, scene.view(times), Q, poses)


def film_model(film: Film) -> "mujoco.MjSpec":
    """Describe robot, object and surroundings of a film for MuJoCo; `qpos` is Q, the object's body is a mocap one."""
    import mujoco

    view, (height, width) = film.view, film.size
    x, y = (view.x[0] + view.x[1]) / 2, (view.y[0] + view.y[1]) / 2
    span = max(view.x[1] - view.x[0], view.y[1] - view.y[0])
    squares, thick, finger = 2 * int(np.ceil(5 * span)), 0.04 * film.reach, FINGER * film.reach
    numbers = {"height": height, "width": width, "fovy": FIELD_OF_VIEW, "span": span, "x": x, "y": y}
    numbers |= {"squares": squares, "half": squares / 2, "floor": -4 * thick}
    world = mujoco.MjSpec.from_string(SURROUNDINGS.format(**numbers, floor_x=round(x), floor_y=round(y)))
    robot = mujoco_spec(film.robot)
    _add_box(robot.body("base"), (*film.half, 3 * thick), style.BODY)
    for index, (name, arm) in enumerate(film.robot.arms.items()):
        color = style.PALETTE[index % len(style.PALETTE)]
        for number, link in enumerate(arm.links, start=1):
            body, tip = robot.body(f"{name}.{number}"), link.a + link.b
            line: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "fromto": [0, 0, 0, tip, 0, 0]}
            body.add_geom(size=[0.7 * thick, 0, 0], rgba=[*to_rgb(color), 1], **line)
            disc: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [thick, 1.1 * thick, 0]}
            body.add_geom(rgba=[1, 1, 1, 1], **disc)
        _add_box(body, (0.2 * thick, 0.7 * finger, 0.7 * thick), color, (tip, 0, 0))
        for side in (-0.7, 0.7):
            _add_box(body, (finger / 2, 0.2 * thick, 0.7 * thick), color, (tip + finger / 2, side * finger, 0))
    if film.shape is not None:
        held = world.worldbody.add_body(name="object", mocap=True)
        _add_box(held, (film.shape[0] / 2, film.shape[1] / 2, 0.9 * thick), style.OBJECT)
    world.attach(robot, prefix="robot.", frame=world.worldbody.add_frame())
    return world


def _add_box(body: Any, half: Sequence[float], color: str, place: Sequence[float] = (0, 0, 0)) -> None:
    """Add a box of half edges (3,) [m] to a body."""
    import mujoco

    kind, rgba = mujoco.mjtGeom.mjGEOM_BOX, [*to_rgb(color), 1]
    body.add_geom(type=kind, size=list(half), rgba=rgba, pos=list(place))


def render(film: Film) -> np.ndarray:
    """Render the frames (K, height, width, 3) of a film with MuJoCo."""
    import mujoco

    model = film_model(film).compile()
    data, camera, frames = mujoco.MjData(model), mujoco.MjvCamera(), []
    *camera.lookat, camera.distance, camera.azimuth, camera.elevation = camera_on(film.view, film.size)
    with mujoco.Renderer(model, *film.size) as renderer:
        for Q, (x, y, angle) in zip(film.Q, film.poses, strict=True):
            data.qpos = Q
            data.mocap_pos[:], data.mocap_quat[:] = [x, y, 0], [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frames.append(renderer.render())
    return np.array(frames)


def camera_on(view: View, size: tuple[int, int]) -> np.ndarray:
    """Return place (3,) [m], distance [m], azimuth and elevation [deg] of the nearest camera that sees a whole view."""
    corners = np.array([[x, y] for x in view.x for y in view.y])
    middle = corners.mean(axis=0)
    right, along = (corners - middle).T
    elevation = np.radians(ELEVATION)
    up, beyond = along * np.sin(elevation), along * np.cos(elevation)
    tall = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    wide = tall * size[1] / size[0]
    distance = max(np.max(np.abs(right) / wide - beyond), np.max(np.abs(up) / tall - beyond))
    return np.array([*middle, 0.0, distance, 90.0, -ELEVATION])


@cache
def offscreen_driver() -> str:
    """Return the driver with which MuJoCo draws off screen here, as MUJOCO_GL names it.

    Raises:
        InputError: There is none, or no MuJoCo.
    """
    if find_spec("mujoco") is None:
        raise InputError("--render: found no package mujoco; install it with pip install 'psmpc[mujoco]'")
    wanted = os.environ.get("MUJOCO_GL")
    drivers = (wanted,) if wanted else ("egl", "osmesa") if sys.platform == "linux" else ("",)
    failures = []
    for driver in drivers:
        try:
            _in_process(driver, _render_nothing)
        except _DriverError as error:
            failures.append(f"{driver or 'the default driver'}: {error}")
        else:
            return driver
    raise InputError(
        f"--render: found no driver with which MuJoCo draws off screen ({'; '.join(failures)}); install EGL or OSMesa, "
        "name a driver that works in MUJOCO_GL, or leave --render out"
    )


def _render_nothing() -> None:
    """Render an empty scene, to try a driver with."""
    import mujoco

    with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16) as renderer:
        renderer.render()


class _DriverError(Exception):
    """Rendering failed; the message is the last line of what MuJoCo or the driver said."""


def _in_process(driver: str, call: Callable[..., Any], *arguments: object) -> Any:
    """Make a call in a process of its own: MuJoCo chooses its driver once, when it is imported, and it may crash."""
    with ProcessPoolExecutor(1, env={"MUJOCO_GL": driver}, initializer=_silence) as pool:
        try:
            return pool.submit(call, *arguments).result()
        except Exception as error:
            said = str(error).strip().splitlines() or [type(error).__name__]
            raise _DriverError(said[-1]) from None


def _silence() -> None:
    """Discard what drivers write to standard error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
