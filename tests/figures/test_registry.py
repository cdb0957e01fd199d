"""What a referee would ask of every figure, of ordinary and of odd runs."""

from collections.abc import Callable
from typing import Any

import pytest

from psmpc_cli.figures.registry import FIGURES
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import in_style

from .fit_to_print import check_figure

Load = Callable[..., Run]

STORIES: dict[str, dict[str, Any]] = {
    "object lost": {"early": {1: 6.4, 3: 19.0}},
    "killed": {"last": 8.0},
    "killed at once": {"last": 0.2},
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_fit_to_print(name: str, run: Run) -> None:
    check_print(name, run)


@pytest.mark.parametrize("story", STORIES)
def test_the_figures_of_an_odd_run_are_fit_to_print(story: str, load: Load) -> None:
    run = load(**STORIES[story])
    for name in FIGURES:
        check_print(name, run)


def test_the_figures_of_many_long_names_are_fit_to_print(load: Load, many_stages: dict[str, Any]) -> None:
    run = load(**many_stages)
    for name in ("controls", "instants"):
        check_print(name, run)


def check_print(name: str, run: Run) -> None:
    with in_style():
        check_figure(FIGURES[name](run))
