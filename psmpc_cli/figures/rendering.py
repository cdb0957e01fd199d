"""The robot moving in three dimensions, drawn by MuJoCo's offscreen renderer."""

import os
import subprocess
import sys
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures.animation import DPI, encode, events_at, frame_times
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.scene import Scene, scene_of

TITLE = 36
"""Height of the title above a frame [px]."""

PATIENCE = 60.0
"""Seconds the renderer may take to start, and as many more for every thirty frames."""

TRIAL = Scene("<mujoco/>", np.empty((1, 0)), np.empty((1, 0)), np.array([0, 0, 0, 1, 0, 0.0]), (16, 16))
"""The smallest scene."""


def write_rendering(run: Run, paths: list[Path]) -> None:
    """Write the robot's motion as films, GIF or MP4 by the files' endings.

    Raises:
        InputError: There is no offscreen renderer here.
        RunError: It failed, or a film could not be encoded or written.
    """
    driver, times = offscreen_driver(), frame_times(run)
    scene = scene_of(run, times)
    with tempfile.TemporaryDirectory() as folder:
        try:
            frames = _draw(scene, driver, Path(folder))
        except _DriverError as error:
            raise RunError(f"MuJoCo's renderer failed: {error}") from None
        for path in paths:
            _write(run, dict(zip(times, frames, strict=True)), path)


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
                _draw(TRIAL, driver, Path(folder))
            except _DriverError as error:
                failures.append(f"{driver or 'the default driver'}: {error}")
            else:
                return driver
    raise InputError(
        f"--render: found no driver with which MuJoCo draws off screen ({'; '.join(failures)}); install EGL or OSMesa, "
        "name a driver that works in MUJOCO_GL, or leave --render out"
    )


class _DriverError(Exception):
    """Drawing failed; the message is the last thing the renderer said."""


def _draw(scene: Scene, driver: str, folder: Path) -> np.ndarray:
    """Return the frames (K, height, width, 3) of a scene, drawn by a program of its own; files go to `folder`."""
    given, drawn = folder / "scene.npz", folder / "frames.npy"
    np.savez(given, mjcf=scene.mjcf, qpos=scene.qpos, mocap=scene.mocap, camera=scene.camera, size=scene.size)
    command = [sys.executable, "-P", str(Path(__file__).with_name("offscreen.py")), str(given), str(drawn)]
    environment, patience = {**os.environ, "MUJOCO_GL": driver}, PATIENCE * (1 + len(scene.qpos) / 30)
    try:
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=patience, check=False)
    except subprocess.TimeoutExpired:
        raise _DriverError(f"no answer within {patience:.0f} s") from None
    if ran.returncode:
        said = ran.stderr.strip().splitlines() or [f"it ended with code {ran.returncode}"]
        raise _DriverError(said[-1])
    return np.asarray(np.load(drawn))


def _write(run: Run, frames: dict[float, np.ndarray], path: Path) -> None:
    """Write frames by their time [s], each below a title that says what goes on."""
    height, width = next(iter(frames.values())).shape[:2]
    figure = Figure(figsize=(width / DPI, (height + TITLE) / DPI))
    FigureCanvasAgg(figure)
    shown = figure.add_axes((0, 0, 1, height / (height + TITLE))).imshow(next(iter(frames.values())))
    shown.axes.set_axis_off()
    title = figure.text(8 / width, 1 - TITLE / 2 / (height + TITLE), "", va="center")

    def show(time: float) -> None:
        shown.set_data(frames[time])
        title.set_text(f"t = {time:.1f} s: {', '.join(events_at(run, time))}")

    encode(figure, path, list(frames), show)
