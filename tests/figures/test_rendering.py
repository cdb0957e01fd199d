import importlib.util
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

Load = Callable[..., Run]


@pytest.fixture(autouse=True)
def tried_anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever the machine's own choice is, each test looks for a driver itself."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    offscreen_driver.cache_clear()
    yield
    offscreen_driver.cache_clear()


def test_a_film_shows_the_robot_in_every_frame(tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        offscreen_driver()
    except InputError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    run = load(last=1.0)
    (path,) = draw(run.log, tmp_path / "out", only=(), render=True)
    assert path == tmp_path / "out" / "render.gif"
    with Image.open(path) as film:
        frames = [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(film)]
    assert len(frames) == len(run.time)
    for blue in ((frame[..., 2] - frame[..., 0] > 60) for frame in frames):
        assert blue.sum() > 100
    assert np.abs(frames[-1] - frames[0]).max() > 60


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
