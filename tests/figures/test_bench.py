"""The figure of a bench, from a made-up document."""

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError
from psmpc_cli.figures.bench import FLOOR, draw_bench, plot_bench
from psmpc_cli.figures.style import in_style

from .drawn import common_legend, points
from .fit_to_print import check_figure

WAYS = [(solver, start) for solver in ("sqp", "fatrop", "ipopt") for start in ("warm", "cold")] + [
    ("reference", "cold")
]
MESHES = ("25", "50", "100", "200", "auto")


def spread(median: float | None, largest: float = 0.0) -> dict[str, float | int | None]:
    if median is None:
        return dict.fromkeys(("median", "p95", "p99", "least", "largest")) | {"count": 0}
    return {"count": 9, "median": median, "p95": largest, "p99": largest, "least": median, "largest": largest}


def row(nodes: str, way: int, stages: int | None = None, failed: bool = False) -> dict[str, Any]:
    size = 40 if nodes == "auto" else int(nodes)
    time, gap = size * 2.0**way * 1e-4, 10.0 ** (way - 12)
    return {
        "nodes": nodes,
        "stages": stages,
        "way": dict(zip(("solver", "start"), WAYS[way], strict=True)),
        "time": spread(None if failed else time, 2 * time),
        "objective_gap": spread(None if failed else gap, 100 * gap),
        "to_finest": spread(None if failed else gap + 1 / size**2, 2 / size**2),
    }


def document(*failed: int) -> dict[str, Any]:
    rows = [row(nodes, way, stages, way in failed) for nodes in MESHES for stages in (None, 1) for way in range(7)]
    return {"summary": rows}


@pytest.fixture
def figure() -> Figure:
    with in_style():
        return plot_bench(document())


def test_it_is_fit_to_print() -> None:
    with in_style():
        check_figure(plot_bench(document()))


def test_every_way_has_a_line_through_the_meshes_with_given_nodes(figure: Figure) -> None:
    for axes in figure.axes:
        lines = [points(line) for line in axes.lines if len(points(line)) == 4]
        assert len(lines) == 7
        assert all((line[1:, 0] > line[:-1, 0]).all() for line in lines)


def test_gaps_below_the_floor_stand_on_it(figure: Figure) -> None:
    lowest = min(points(line)[:, 1].min() for line in figure.axes[0].lines)
    assert lowest == FLOOR


def test_the_legend_names_back_ends_starts_meshes_and_the_floor(figure: Figure) -> None:
    named = common_legend(figure)
    assert named[:4] == ["sqp", "fatrop", "ipopt", "CasADi, IPOPT"]
    assert named[4:6] == ["warm", "cold"]
    assert named[-2:] == ["auto", "floor"]
    assert len(named) == 12


def test_what_failed_everywhere_is_left_out() -> None:
    with in_style():
        figure = plot_bench(document(6))
    assert "CasADi, IPOPT" not in common_legend(figure)


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    path = tmp_path / "bench.svg"
    path.write_text("mine")
    with pytest.raises(InputError, match="already"):
        draw_bench(document(), path)
    draw_bench(document(), path, force=True)
    assert path.read_text().startswith("<?xml")
