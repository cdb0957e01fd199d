from collections.abc import Callable
from pathlib import Path

import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.figures.style import in_style
from psmpc_cli.figures.sweep.draw import draw_sweep
from psmpc_cli.figures.sweep.registry import FIGURES
from psmpc_cli.logs.results import Results
from psmpc_cli.simulation.sweep_cells import sweep_cells

from ...made_up_sweep import made_up_sweep
from ..fit_to_print import check_figure

CASES = {
    "complete": {"sampling": "7x7"},
    "with holes": {"sampling": "7x7", "waiting": (5, 6, 13), "failed": (0, 24, 30)},
    "begun": {"sampling": "3x3", "waiting": tuple(range(1, 9))},
    "failed": {"sampling": "3x3", "failed": tuple(range(9))},
    "not square": {"sampling": "2x9"},
    "ratios": {"sampling": "13"},
    "ratios with holes": {"sampling": "13", "waiting": (1,), "failed": (6,)},
    "draws": {"sampling": "random:20"},
    "draws with holes": {"sampling": "random:20", "waiting": (1, 3), "failed": (6,)},
    "one draw": {"sampling": "random:1"},
}

Sweep = Callable[..., Results]


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return lambda **given: made_up_sweep(tmp_path / "sweep.h5", **given)


@pytest.mark.parametrize("case", CASES)
def test_every_figure_of_every_sampling_is_fit_to_print(sweep: Sweep, case: str) -> None:
    cells = sweep_cells(sweep(**CASES[case]))
    with in_style():
        for plot in FIGURES[cells.sampling].values():
            check_figure(plot(cells))


@pytest.mark.parametrize(
    ("sampling", "names"),
    [
        ("3x3", ["surface", "heat_map", "starts", "sensitivity"]),
        ("5", ["starts", "sensitivity"]),
        ("random:4", ["draws", "starts", "sensitivity"]),
    ],
)
def test_a_sampling_has_the_figures_that_go_with_it(
    sweep: Sweep, tmp_path: Path, sampling: str, names: list[str]
) -> None:
    drawn = draw_sweep(sweep(sampling=sampling), tmp_path / "figures")
    assert drawn == [tmp_path / "figures" / f"{name}.png" for name in names]
    assert all(path.stat().st_size for path in drawn)


def test_figures_and_formats_are_chosen(sweep: Sweep, tmp_path: Path) -> None:
    drawn = draw_sweep(sweep(sampling="3x3"), tmp_path, ("svg", "pdf"), ["starts"])
    assert {path.name for path in drawn} == {"starts.pdf", "starts.svg"}


def test_a_figure_of_another_sampling_is_refused_with_those_there_are(sweep: Sweep, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no figure 'surface', expected one of starts, sensitivity"):
        draw_sweep(sweep(sampling="3"), tmp_path, only=["surface"])


def test_nothing_is_overwritten_unasked(sweep: Sweep, tmp_path: Path) -> None:
    results = sweep(sampling="3")
    draw_sweep(results, tmp_path)
    with pytest.raises(InputError, match="--force"):
        draw_sweep(results, tmp_path)
    assert draw_sweep(results, tmp_path, force=True)


def test_a_sweep_that_has_not_begun_has_nothing_to_draw(sweep: Sweep, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no cell that was run"):
        draw_sweep(sweep(sampling="2", waiting=(0, 1)), tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


def test_the_same_sweep_gives_the_same_files(sweep: Sweep, tmp_path: Path) -> None:
    results = sweep(sampling="3x3")
    first, second = (draw_sweep(results, tmp_path / name) for name in ("first", "second"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
