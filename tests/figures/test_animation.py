"""The robot in motion: drawn, and filmed by MuJoCo."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.figure import Figure
from PIL import Image, ImageSequence

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.figures import animation
from psmpc_cli.figures.animation import film_model, offscreen_driver
from psmpc_cli.figures.registry import draw
from psmpc_cli.figures.scene import scene_of
from psmpc_cli.logs.run import Run

from ..limited_disk import files_of_at_most

pytestmark = pytest.mark.slow

Load = Callable[..., Run]


@pytest.fixture(autouse=True)
def without_ffmpeg_and_with_no_driver_chosen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    offscreen_driver.cache_clear()
    yield
    offscreen_driver.cache_clear()


def frames_of(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        return [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(film)]


def mujoco_draws() -> bool:
    """Whether MuJoCo draws off screen here by its usual driver."""
    alone = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 16, 16).render()"
    driver = {"MUJOCO_GL": "egl"} if sys.platform == "linux" else {}
    ended = subprocess.run([sys.executable, "-c", alone], env={**os.environ, **driver}, capture_output=True)
    return not ended.returncode


def test_an_animation_shows_every_frame_beside_the_chosen_figures(tmp_path: Path, load: Load) -> None:
    run = load(last=1.0)
    files = draw("run", run, tmp_path, ["svg"], only=["states"], films=["animation"])
    assert [path.name for path in files] == ["states.svg", "animation.gif"]
    frames = frames_of(files[1])
    assert len(frames) == len(run.motion.time)
    assert frames[0].shape[0] % 2 == frames[0].shape[1] % 2 == 0


def test_every_frame_has_the_names_of_its_axes(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    labels: list[tuple[str, bool]] = []

    def look(figure: Figure, draw_frame: Callable[[int], object], count: int, paths: object) -> None:
        for number in range(2):
            draw_frame(number)
            figure.draw_without_rendering()
            for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis):
                place = axis.label.get_window_extent()
                labels.append((axis.label.get_text(), figure.bbox.contains(place.x0, place.y0)))

    monkeypatch.setattr(animation, "_write_frames", look)
    animation.write_animation(load(last=1.0), [])
    assert labels == 2 * [("x (m)", True), ("y (m)", True)]


def test_beside_existing_figures_only_the_animation_is_made(tmp_path: Path, load: Load) -> None:
    (tmp_path / "errors.png").write_text("mine")
    files = draw("run", load(last=0.5), tmp_path, films=["animation"])
    assert [path.name for path in files] == ["animation.gif"]
    assert (tmp_path / "errors.png").read_text() == "mine"
    with pytest.raises(InputError, match=r"animation\.gif exists already"):
        draw("run", load(last=0.5), tmp_path, films=["animation"])
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".h5") == ["animation.gif", "errors.png"]


def test_an_animation_that_cannot_be_written_is_named(tmp_path: Path, load: Load) -> None:
    (tmp_path / "animation.gif").mkdir()
    with pytest.raises(InputError, match=r"animation\.gif is a directory"):
        draw("run", load(last=0.2), tmp_path, only=(), force=True, films=["animation"])


def test_an_animation_is_written_whole_or_not_at_all(tmp_path: Path, load: Load) -> None:
    run, folder = load(last=0.2), tmp_path / "films"
    with files_of_at_most(1000), pytest.raises(RunError, match=r"animation\.gif could not be written"):
        draw("run", run, folder, only=(), films=["animation"])
    assert list(folder.iterdir()) == []


def test_a_film_has_the_base_and_the_links_where_the_run_has_them(run: Run) -> None:
    scene, times = scene_of(run), np.array([0.0, 12.0, 20.0])
    model = mujoco.MjModel.from_xml_string(film_model(scene, scene.extent(times)))
    data = mujoco.MjData(model)
    for time in times:
        data.qpos = run.motion.coordinates_at(time)
        mujoco.mj_forward(model, data)
        ends = run.motion.poses_at(np.array([time]))[0]
        for name, rows in run.problem.model.pose_rows.items():
            np.testing.assert_allclose(data.site(f"robot.{name}").xpos[:2], ends[rows][:2], atol=1e-9)


def test_a_film_has_obstacles_of_every_shape(load: Load, keeping_clear: dict[str, Any], tmp_path: Path) -> None:
    run = load(last=1.0, **keeping_clear)
    scene = scene_of(run)
    model = mujoco.MjModel.from_xml_string(film_model(scene, scene.extent([0.0])))
    geoms = [int(model.body(f"obstacle.{number}").geomadr[0]) for number in range(4)]
    found = [mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_") for geom in geoms]
    assert found == ["SPHERE", "CAPSULE", "BOX", "BOX"]
    assert [int(model.body(f"obstacle.{number}").mocapid[0]) for number in range(4)] == [1, 2, 3, 4]
    if mujoco_draws():
        (film,) = draw("run", load(last=4.0, **keeping_clear), tmp_path / "film", only=(), films=["render"])
        first, *_, last = (np.abs(frame - (207, 196, 188)).sum(axis=2) < 60 for frame in frames_of(film))
        assert (first & ~last).any() and (last & ~first).any()  # the ball moves


def test_a_film_shows_the_robot_in_every_frame_or_is_rejected_where_mujoco_cannot_draw(
    tmp_path: Path, load: Load
) -> None:
    run, folder = load(last=1.0), tmp_path / "out"
    if not mujoco_draws():
        with pytest.raises(InputError, match="found no driver with which MuJoCo draws off screen"):
            draw("run", run, folder, only=(), films=["render"])
        assert not folder.exists()
        return
    assert draw("run", run, folder, only=(), films=["render"]) == [folder / "render.gif"]
    frames = frames_of(folder / "render.gif")
    assert len(frames) == len(run.motion.time)
    for blue in ((frame[..., 2] - frame[..., 0] > 60) for frame in frames):
        assert blue.sum() > 100
    assert np.abs(frames[-1] - frames[0]).max() > 60
    assert all(frame[:30].min() < 100 < 250 < frame[:30].max() for frame in frames)  # the title


def test_a_driver_that_does_not_exist_is_rejected_with_what_helps(
    tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "crayons")
    with pytest.raises(InputError, match=r"crayons: .*; install EGL, name a driver .* or leave --render out"):
        draw("run", load(last=1.0), tmp_path / "out", films=["render"])
    assert not (tmp_path / "out").exists()
