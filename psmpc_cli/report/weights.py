"""The section on the weights of two stages: the claims of Fig. 6 of the paper with the figures of the sweep."""

from collections.abc import Iterator
from functools import partial

from psmpc_cli.figures.sweep.registry import FIGURES
from psmpc_cli.report.claims import claim_table
from psmpc_cli.report.html import Html, element
from psmpc_cli.report.images import NARROW, Picture, embed
from psmpc_cli.simulation.recommendation import recommend
from psmpc_cli.simulation.sweep_cells import SweepCells
from psmpc_cli.studies.reproduce import Reproduction
from psmpc_cli.studies.sweep_claims import WEIGHTS
from psmpc_cli.studies.sweep_findings import settled

TITLE = "The weights"

CAPTIONS = {
    "surface": "The actual start over both weights (Fig. 6 of the paper).",
    "heat_map": "The same from above, with the contour of t_s - T_h.",
    "starts": "The actual start against the ratio of the weights, for every threshold.",
    "sensitivity": "What the ratio does to completion, effort and final error, and the recommended ratio.",
}


def weights_section(reproduction: Reproduction) -> Iterator[Html]:
    """Give the section, if the sweep was run: its claims, what it recommends, and its figures."""
    cells = reproduction.weights
    if cells is None:
        return
    yield element("h2", TITLE)
    yield claim_table(TITLE, [judged for judged in reproduction.judged if judged.claim.group == WEIGHTS])
    yield element("p", _came_to(cells))
    best = recommend(cells)
    yield element("p", f"Design guidance: {best}." if best else "Design guidance: no ratio completed in every cell.")
    if cells.ended.any():
        yield element("div", *(embed(picture, NARROW) for picture in _pictures(cells)), class_="gallery")


def _came_to(cells: SweepCells) -> str:
    first, second = cells.names
    return (
        f"The weights of {first} and {second} were varied in {len(cells.ratio)} cells, from {cells.omega.min():g} to "
        f"{cells.omega.max():g} each; {cells.failed.sum()} cells failed, and {cells.count('fallbacks')} of "
        f"{cells.count('solves')} solves."
    )


def _pictures(cells: SweepCells) -> Iterator[Picture]:
    found = settled(cells)
    summary = f"from ratio {found.ratio:.4g} on the actual start stays at {found.start:.2f} s"
    for name, draw in FIGURES[cells.sampling].items():
        caption = CAPTIONS[name]
        yield Picture(partial(draw, cells), f"{caption} In short: {summary}.", caption)
