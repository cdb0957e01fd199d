from collections.abc import Callable
from pathlib import Path
from subprocess import CalledProcessError

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter, PillowWriter
from PIL import Image, ImageSequence

from psmpc_cli.errors import RunError
from psmpc_cli.figures.animation import LONGEST, animation_files, events_at, frame_times, write_animation
from psmpc_cli.figures.draw import draw
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import in_style

Load = Callable[..., Run]


def test_a_gif_shows_every_frame(tmp_path: Path, load: Load) -> None:
    run = load(last=2.0)
    with in_style():
        write_animation(run, tmp_path / "animation.gif")
    with Image.open(tmp_path / "animation.gif") as film:
        assert (film.format, len(list(ImageSequence.Iterator(film)))) == ("GIF", len(run.time))
        assert film.width % 2 == film.height % 2 == 0


def test_frames_span_the_run_and_are_bounded(run: Run, load: Load) -> None:
    times = frame_times(run)
    assert (times[0], times[-1], len(times)) == (0.0, run.end, len(run.time))
    assert np.all(np.diff(times) > 0)
    assert len(frame_times(load(sample=0.1))) == LONGEST


def test_titles_say_what_goes_on(load: Load) -> None:
    run = load(early={1: 6.4, 3: 19.0})
    assert events_at(run, 5.0) == ["approach"]
    assert events_at(run, 7.0) == ["approach", "capture acts already"]
    assert events_at(run, 25.0) == ["release", "object lost"]


@pytest.mark.parametrize(("there", "names"), [(False, ["animation.gif"]), (True, ["animation.gif", "animation.mp4"])])
def test_an_mp4_is_written_with_ffmpeg(monkeypatch: pytest.MonkeyPatch, there: bool, names: list[str]) -> None:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: there)
    assert [path.name for path in animation_files(Path())] == names


def test_an_encoder_that_fails_is_reported(tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(writer: PillowWriter) -> None:
        raise CalledProcessError(1, "ffmpeg")

    monkeypatch.setattr(PillowWriter, "finish", fail)
    with in_style(), pytest.raises(RunError, match=r"animation\.gif could not be written.*ffmpeg"):
        write_animation(load(last=0.2), tmp_path / "animation.gif")


def test_draw_adds_the_animation_when_asked(tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    files = draw(load(last=0.5).log, tmp_path, only=["states"], animate=True)
    assert [path.name for path in files] == ["states.png", "animation.gif"]
    assert all(path.exists() for path in files)
