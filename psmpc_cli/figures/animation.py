"""The robot moving: an animated drawing, and a film in three dimensions by MuJoCo's offscreen renderer."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures import style
from psmpc_cli.figures.scene import FINGER, Scene, View, base_half, reach, scene_of, view_around
from psmpc_cli.figures.snapshots import draw_scene, show
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.mujoco_model import mujoco_spec

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
    view = view_around(scene.extent(times))
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
    draw_scene(axes, scene, time, since=max(time - 3.0, float(scene.run.motion.time[0])), width=1.6)
    show(axes, view)
    axes.set_title(_title(scene, time), loc="left")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def frame_times(run: Run) -> np.ndarray:
    """Return the time of each frame [s]: evenly spread, no more than there are samples."""
    return np.linspace(run.motion.time[0], run.motion.end, min(LONGEST, len(run.motion.time)))


def _title(scene: Scene, time: float) -> str:
    return f"t = {time:.1f} s: {', '.join(scene.events(time))}"


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
    view = view_around(scene.extent(times))
    Q = [run.motion.coordinates_at(time) for time in times]
    poses = [scene.object_pose(time) for time in times]
    frames = _in_process(offscreen_driver(), render, film_model(scene, view), Q, poses, camera_on(view))
    height, width = frames.shape[1:3]
    figure = Figure(figsize=(width / DPI, (height + TITLE) / DPI))
    FigureCanvasAgg(figure)
    shown = figure.add_axes((0, 0, 1, height / (height + TITLE))).imshow(frames[0])
    shown.axes.set_axis_off()
    title = figure.text(8 / width, 1 - TITLE / 2 / (height + TITLE), "", va="center")

    def draw_frame(time: float) -> None:
        shown.set_data(frames[np.searchsorted(times, time)])
        title.set_text(_title(scene, time))

    for path in paths:
        _encode(figure, path, times.tolist(), draw_frame)


def film_model(scene: Scene, view: View) -> str:
    """Describe robot, object and surroundings as MJCF; `qpos` is Q, the object's body is a mocap one."""
    import mujoco

    model, spec, (height, width) = scene.run.problem.model, scene.run.task.spec.object, frame_size(view)
    x, y = (view.x[0] + view.x[1]) / 2, (view.y[0] + view.y[1]) / 2
    span = max(view.x[1] - view.x[0], view.y[1] - view.y[0])
    squares, thick, finger = 2 * int(np.ceil(5 * span)), 0.04 * reach(model), FINGER * reach(model)
    numbers = {"height": height, "width": width, "fovy": FIELD_OF_VIEW, "span": span, "x": x, "y": y}
    numbers |= {"squares": squares, "half": squares / 2, "floor": -4 * thick}
    world = mujoco.MjSpec.from_string(SURROUNDINGS.format(**numbers, floor_x=round(x), floor_y=round(y)))
    robot = mujoco_spec(model.spec)
    _add_box(robot.body("base"), (*base_half(model), 3 * thick), style.BODY)
    for index, name in enumerate(model.spec.arms):
        color = style.PALETTE[index % len(style.PALETTE)]
        for number, end in enumerate(model.spec.link_ends(name), start=1):
            body, tip = robot.body(f"{name}.{number}"), end[0]
            line: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "fromto": [0, 0, 0, *end]}
            body.add_geom(size=[0.7 * thick, 0, 0], rgba=[*to_rgb(color), 1], **line)
            disc: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [thick, 1.1 * thick, 0]}
            body.add_geom(rgba=[1, 1, 1, 1], **disc)
        _add_box(body, (0.2 * thick, 0.7 * finger, 0.7 * thick), color, (tip, 0, 0))
        for side in (-0.7, 0.7):
            _add_box(body, (finger / 2, 0.2 * thick, 0.7 * thick), color, (tip + finger / 2, side * finger, 0))
    if spec is not None:
        held = world.worldbody.add_body(name="object", mocap=True)
        _add_box(held, (spec.shape[0] / 2, spec.shape[1] / 2, 0.9 * thick), style.OBJECT)
    world.attach(robot, prefix="robot.", frame=world.worldbody.add_frame())
    world.compile()
    return str(world.to_xml())


def _add_box(body: Any, half: Sequence[float], color: str, place: Sequence[float] = (0, 0, 0)) -> None:
    """Add a box of half edges (3,) [m] to a body."""
    import mujoco

    kind, rgba = mujoco.mjtGeom.mjGEOM_BOX, [*to_rgb(color), 1]
    body.add_geom(type=kind, size=list(half), rgba=rgba, pos=list(place))


def render(
    description: str, Q: Sequence[np.ndarray], poses: Sequence[np.ndarray | None], camera: np.ndarray
) -> np.ndarray:
    """Render the frames (K, height, width, 3) of a model with the robot at K coordinates and the object at K poses."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(description)
    data, eye, frames = mujoco.MjData(model), mujoco.MjvCamera(), []
    *eye.lookat, eye.distance, eye.azimuth, eye.elevation = camera
    with mujoco.Renderer(model, model.vis.global_.offheight, model.vis.global_.offwidth) as renderer:
        for data.qpos, pose in zip(Q, poses, strict=True):
            if pose is not None:
                data.mocap_pos[0, :2] = pose[:2]
                data.mocap_quat[0] = [np.cos(pose[2] / 2), 0, 0, np.sin(pose[2] / 2)]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, eye)
            frames.append(renderer.render())
    return np.array(frames)


def frame_size(view: View) -> tuple[int, int]:
    """Return height and width of a frame of the film [px], even, as video encoders want."""
    return 2 * round(FILM_WIDTH * view.aspect * np.sin(np.radians(ELEVATION)) / 2), FILM_WIDTH


def camera_on(view: View) -> np.ndarray:
    """Return place (3,) [m], distance [m], azimuth and elevation [deg] of the nearest camera that sees a whole view."""
    corners = np.array([[x, y] for x in view.x for y in view.y])
    middle, (height, width) = corners.mean(axis=0), frame_size(view)
    right, along = (corners - middle).T
    elevation = np.radians(ELEVATION)
    up, beyond = along * np.sin(elevation), along * np.cos(elevation)
    tall = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    wide = tall * width / height
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
        except RunError as error:
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


def _in_process(driver: str, call: Callable[..., Any], *arguments: object) -> Any:
    """Make a call in a process of its own: MuJoCo chooses its driver once, when it is imported, and it may crash.

    Raises:
        RunError: The call failed; the message has the last line of what MuJoCo or the driver said.
    """
    with ProcessPoolExecutor(1, env={"MUJOCO_GL": driver}, initializer=_silence) as pool:
        try:
            return pool.submit(call, *arguments).result()
        except Exception as error:
            said = str(error).strip().splitlines() or [type(error).__name__]
            raise RunError(f"MuJoCo's renderer failed: {said[-1]}") from None


def _silence() -> None:
    """Discard what drivers write to standard error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
