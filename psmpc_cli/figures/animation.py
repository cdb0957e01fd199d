"""The robot moving: an animated drawing, and a film in three dimensions by MuJoCo's offscreen renderer."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures import style
from psmpc_cli.figures.robot_drawing import FINGER, Scene, View, base_half, reach, scene_of
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.model import arm_points

RATE, LONGEST = 15, 150
"""Frames a second; most frames of motion."""

WIDTH, DPI = 4.0, 120
"""Width [in] and resolution of a frame of the drawing."""

FILM_WIDTH, TITLE = 640, 36
"""Width of a frame of the film, and height of the title above it [px]."""

ELEVATION, FIELD_OF_VIEW = 60.0, 14.0
"""How far above the plane the camera is, and its vertical angle of view [deg]."""


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
    with tempfile.TemporaryDirectory() as folder:
        try:
            frames = _render(film_arrays(scene, times), offscreen_driver(), Path(folder))
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


def film_arrays(scene: Scene, times: np.ndarray) -> dict[str, Any]:
    """Return what the program in offscreen.py needs to draw a scene at these times [s]."""
    model, spec, view = scene.run.problem.model, scene.run.task.spec.object, scene.view(times)
    length = reach(model)
    thick, finger = 0.04 * length, FINGER * length
    bodies: list[tuple[str, tuple[float, ...], str]] = [("box", (*map(float, base_half(model)), 3 * thick), style.BODY)]
    for index, arm in enumerate(model.spec.arms.values()):
        color = style.PALETTE[index % len(style.PALETTE)]
        for link in arm.links:
            bodies += [
                ("capsule", (0.7 * thick, link.a + link.b, 0), color),
                ("cylinder", (thick, 1.1 * thick, 0), "white"),
            ]
        bodies += [("box", (0.2 * thick, 0.7 * finger, 0.7 * thick), color)]
        bodies += [("box", (finger / 2, 0.2 * thick, 0.7 * thick), color)] * 2
    if spec is not None:
        bodies.append(("box", (spec.shape[0] / 2, spec.shape[1] / 2, 0.9 * thick), style.OBJECT))
    size = (2 * round(FILM_WIDTH * view.aspect * np.sin(np.radians(ELEVATION)) / 2), FILM_WIDTH)  # even, as for MP4
    return {
        "kinds": np.array([kind for kind, _, _ in bodies]),
        "sizes": np.array([half for _, half, _ in bodies], float),
        "colors": np.array([to_rgb(color) for _, _, color in bodies]),
        "poses": np.array([_body_poses(scene, float(time)) for time in times]),
        "view": np.array([*view.x, *view.y]),
        "floor": np.array(-4 * thick),
        "camera": camera_on(view, size),
        "size": np.array(size),
    }


def _body_poses(scene: Scene, time: float) -> list[np.ndarray]:
    """Return the pose (3,) [m, m, rad] of every body of the film at a time [s]."""
    model, Q, pose = scene.run.problem.model, scene.configuration(time), scene.object_pose(time)
    finger, poses = FINGER * reach(model), [Q[:3]]
    for points in arm_points(model, Q).values():
        for start, end in pairwise(points):
            angle = np.arctan2(*(end - start)[::-1])
            poses += [np.array([*(start + end) / 2, angle]), np.array([*start, angle])]
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        poses.append(np.array([*points[-1], angle]))
        poses += [np.array([*points[-1] + (along / 2 + side * across) * finger, angle]) for side in (-0.7, 0.7)]
    return poses if pose is None else [*poses, pose]


def camera_on(view: View, size: tuple[int, int]) -> np.ndarray:
    """Return the camera (7,) from whose nearest place a whole view is visible, x to the right."""
    corners = np.array([[x, y] for x in view.x for y in view.y])
    middle = corners.mean(axis=0)
    right, along = (corners - middle).T
    elevation = np.radians(ELEVATION)
    up, beyond = along * np.sin(elevation), along * np.cos(elevation)
    tall = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    wide = tall * size[1] / size[0]
    distance = max(np.max(np.abs(right) / wide - beyond), np.max(np.abs(up) / tall - beyond))
    return np.array([*middle, 0.0, distance, 90.0, -ELEVATION, FIELD_OF_VIEW])


SMALLEST = {
    "kinds": np.array(["box"]),
    "sizes": np.ones((1, 3)),
    "colors": np.ones((1, 3)),
    "poses": np.zeros((1, 1, 3)),
    "view": np.array([-1.0, 1.0, -1.0, 1.0]),
    "floor": np.array(-1.0),
    "camera": np.array([0, 0, 0, 1, 0, 0, FIELD_OF_VIEW]),
    "size": np.array([16, 16]),
}
"""The smallest film, to try a driver with."""


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
        with tempfile.TemporaryDirectory() as folder:
            try:
                _render(SMALLEST, driver, Path(folder))
            except _DriverError as error:
                failures.append(f"{driver or 'the default driver'}: {error}")
            else:
                return driver
    raise InputError(
        f"--render: found no driver with which MuJoCo draws off screen ({'; '.join(failures)}); install EGL or OSMesa, "
        "name a driver that works in MUJOCO_GL, or leave --render out"
    )


class _DriverError(Exception):
    """Drawing failed; the message is the last line the renderer wrote."""


def _render(film: dict[str, Any], driver: str, folder: Path) -> np.ndarray:
    """Return the frames (K, height, width, 3) of a film, drawn by a program of its own; its files go to `folder`."""
    given, drawn = folder / "scene.npz", folder / "frames.npy"
    np.savez(given, **film)
    command = [sys.executable, "-P", str(Path(__file__).with_name("offscreen.py")), str(given), str(drawn)]
    environment, patience = {**os.environ, "MUJOCO_GL": driver}, 60.0 * (1 + len(film["poses"]) / 30)
    try:
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=patience, check=False)
    except subprocess.TimeoutExpired:
        raise _DriverError(f"no answer within {patience:.0f} s") from None
    if ran.returncode:
        said = ran.stderr.strip().splitlines() or [f"it ended with code {ran.returncode}"]
        raise _DriverError(said[-1])
    return np.asarray(np.load(drawn))
