import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image, ImageSequence

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures import rendering
from psmpc_cli.figures.draw import draw
from psmpc_cli.figures.rendering import offscreen_driver
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.scene import Scene

Load = Callable[..., Run]


@pytest.fixture(autouse=True)
def tried_anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever the machine's own choice is, each test looks for a driver itself."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    offscreen_driver.cache_clear()
    yield
    offscreen_driver.cache_clear()


def mujoco_draws() -> bool:
    """Whether MuJoCo itself makes an image off screen here, by any driver and without a line of ours."""
    alone = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 16, 16).render()"
    drivers = ("egl", "osmesa") if sys.platform == "linux" else ("",)
    tried = (
        subprocess.run([sys.executable, "-c", alone], env={**os.environ, "MUJOCO_GL": driver}, capture_output=True)
        for driver in drivers
    )
    return any(ran.returncode == 0 for ran in tried)


def frames_of(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        return [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(film)]


def test_a_film_shows_the_robot_in_every_frame_or_is_refused_where_mujoco_cannot_draw(
    tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    run = load(last=1.0)
    if not mujoco_draws():
        with pytest.raises(InputError, match="found no driver with which MuJoCo draws off screen"):
            draw(run.log, tmp_path / "out", only=(), render=True)
        assert not (tmp_path / "out").exists()
        return
    (path,) = draw(run.log, tmp_path / "out", only=(), render=True)
    assert path == tmp_path / "out" / "render.gif"
    frames = frames_of(path)
    assert len(frames) == len(run.time)
    for blue in ((frame[..., 2] - frame[..., 0] > 60) for frame in frames):
        assert blue.sum() > 100
    assert np.abs(frames[-1] - frames[0]).max() > 60


def test_a_film_has_every_frame_that_was_drawn_below_its_title(
    tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever draws: each frame gets one shade, by which it is found again in the film."""

    def shaded(scene: Scene, driver: str, folder: Path) -> np.ndarray:
        height, width = scene.size
        shades = np.linspace(0, 255, len(scene.qpos)).astype(np.uint8)
        return np.broadcast_to(shades[:, None, None, None], (len(shades), height, width, 3))

    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    monkeypatch.setattr(rendering, "_draw", shaded)
    run = load(last=1.0)
    (path,) = draw(run.log, tmp_path / "out", only=(), render=True)
    frames = frames_of(path)
    middle = [frame[frame.shape[0] // 2 + 20, frame.shape[1] // 2].mean() for frame in frames]
    np.testing.assert_allclose(middle, np.linspace(0, 255, len(run.time)), atol=6)
    assert all(frame[:30].min() < 100 < 250 < frame[:30].max() for frame in frames)


def test_a_driver_that_does_not_exist_is_refused_with_what_helps(
    tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "crayons")
    with pytest.raises(InputError, match=r"crayons: .*; install EGL or OSMesa, name a driver .* or leave --render out"):
        draw(load(last=1.0).log, tmp_path / "out", render=True)
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MuJoCo has one driver")
def test_the_first_driver_that_works_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    def draw_with(scene: object, driver: str, folder: Path) -> None:
        if driver == "egl":
            raise rendering._DriverError("no EGL here")

    monkeypatch.setattr(rendering, "_draw", draw_with)
    assert offscreen_driver() == "osmesa"


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "find_spec", lambda name: importlib.util.find_spec("no_such_package"))
    with pytest.raises(InputError, match=r"pip install 'psmpc\[mujoco\]'"):
        offscreen_driver()


def test_a_renderer_that_dies_says_how(tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "offscreen_driver", lambda: "crayons")
    with pytest.raises(RunError, match=r"MuJoCo's renderer failed: .*crayons"):
        rendering.write_rendering(load(last=1.0), [tmp_path / "render.gif"])
    assert not (tmp_path / "render.gif").exists()
