"""The fronts of a Pareto study: how they are read from its file, what their points dominate, and their table.

A point is a row of criteria (C,) to be small; NaN means that it could not be solved for.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.schema import PARETO, Column
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.measures import check_columns

Vector = np.ndarray

WEIGHTED = "weighted"
CONSTRAINED = "constrained"
FREE = "free"
"""How the arrays of a method begin; `free` are weighted sums with the instant free."""

LEAST_IMPROVEMENT = 1e-4
EQUALITY_TOLERANCE = 1e-9
"""How much better a point has to be to dominate, and what is no difference, as parts of what the points span."""

STATUS = tuple(outcome.name.lower() for outcome in Outcome)

COLUMNS: Mapping[str, tuple[str, str]] = {
    "instant": ("T0 [s]", ".2f"),
    "t_s": ("t_s [s]", ".2f"),
    "ratio": ("omega_2/omega_1", "g"),
    "J_1": ("J_1 [s]", ".4f"),
    "J_2": ("J_2 [s]", ".4f"),
    "hypervolume": ("hypervolume", ".3f"),
    "points": ("points", "d"),
    "dominated": ("dominated", "d"),
    "failed": ("failed", "d"),
}
"""Columns of the table of fronts: heading and format of each."""

HEADINGS = tuple(heading for heading, _ in COLUMNS.values())

NOTE = (
    "t_s, J_1 and J_2: the run's own optimum, the star in the figures, which has the least omega_1 J_1 + omega_2 J_2 + "
    "pending cost with the run's own weights"
)
"""What the table says of the one point of each front that it singles out; cf. paper eqs. (16), (29)."""


def read_fronts(path: Path) -> Results:
    """Read the results of a Pareto study, and check that they have all arrays that the functions of this module read.

    Args:
        path: The file.

    Raises:
        LogError: The file cannot be read as for `read_results`, is not of a Pareto study, or lacks an array of a method
            by which it has fronts.
    """
    results = read_results(path, PARETO)
    names_by_instant = ("instant", "t_s", "chosen_ratio", "chosen_J_1", "chosen_J_2", "hypervolume")
    check_columns(results, [Column(name, "1", name) for name in names_by_instant], ("instant",))
    check_columns(results, [Column("stage", "1", "stage", dtype="text", dims=("stage",))])
    # with `later`, fronts were computed for several switch times and for a free one
    has_free_instant = "later" in results.quantities
    methods = [method for method in (WEIGHTED, CONSTRAINED) if f"{method}_status" in results.quantities]
    missing: list[str] = []
    for method in (*methods, *((FREE,) if has_free_instant else ())):
        types = {"J_1": "f8", "J_2": "f8", "wait": "f8", "status": "i1", "dominated": "i1"}
        later_dim = ("later",) if has_free_instant and method != FREE else ()
        dims = ("instant", *later_dim, "bound" if method == CONSTRAINED else "ratio")
        check_columns(results, [Column(f"{method}_{name}", "1", name, None, types[name]) for name in types], dims)
        missing += [f"{method}_{name}" for name in types if f"{method}_{name}" not in results.quantities]
    horizon = results.attributes.get("horizon")
    if missing:
        raise LogError(f"{path}: found no {', '.join(missing)}, expected results as psmpc writes them")
    has_horizon = isinstance(horizon, np.number) and 0 < horizon < np.inf
    if not (methods and has_horizon and results["stage"].size == 2):
        raise LogError(f"{path}: found no fronts of two stages over a horizon, expected those of psmpc pareto")
    return results


def extents(points: Vector) -> Vector:
    """Return what points (P, C) span in each criterion (C,); 1 where that is nothing."""
    known = points[np.isfinite(points).all(axis=1)]
    span = np.ptp(known, axis=0) if len(known) else np.zeros(points.shape[1])
    return np.where(span > 0, span, 1.0)


def dominated(points: Vector) -> Vector:
    """Return which points (P, C) another is better than in every criterion in which the two differ (P,).

    Better is what is so by `LEAST_IMPROVEMENT` of the extent: where a front is steep, less is in solvers' last digits.
    """
    better_by = (points[:, None, :] - points[None, :, :]) / extents(points)  # [i, j]: what j is better by than i
    better = better_by > LEAST_IMPROVEMENT
    same = np.abs(better_by) <= EQUALITY_TOLERANCE
    return np.asarray((np.all(better | same, axis=2) & np.any(better, axis=2)).any(axis=1))


def hypervolume(points: Vector, reference: Vector) -> float:
    """Return the measure of what lies between points (P, C) and a reference point (C,), and is dominated."""
    inside = points[np.all(points < reference, axis=1)]
    if len(reference) == 1:
        return float(np.max(reference - inside, initial=0.0))
    layers = np.unique(inside[:, -1])
    heights = np.diff(np.append(layers, reference[-1]))
    return float(heights @ [hypervolume(inside[inside[:, -1] <= layer, :-1], reference[:-1]) for layer in layers])


def front_rows(results: Results) -> list[dict[str, float | int]]:
    """Return the table of a Pareto study: a row for each sample at which fronts were computed.

    Returns:
        Rows with the keys of `COLUMNS`. `instant` is the time of the sample. `t_s`, `ratio`, `J_1` and `J_2` are those
        of the run's own optimum there. `points` counts the points of all fronts, `dominated` those of them that another
        point dominates, and `failed` those for which no optimum was found.
    """
    methods = [method for method in (WEIGHTED, CONSTRAINED, FREE) if f"{method}_status" in results.quantities]
    rows = []
    for instant in range(len(results["instant"])):
        status = np.concatenate([results[f"{method}_status"][instant].ravel() for method in methods])
        names = ("instant", "t_s", "chosen_ratio", "chosen_J_1", "chosen_J_2", "hypervolume")
        row: dict[str, float | int] = {name.removeprefix("chosen_"): float(results[name][instant]) for name in names}
        dominated_points = sum(int(results[f"{method}_dominated"][instant].sum()) for method in methods)
        failed = int(np.sum(status != STATUS.index("optimal")))
        rows.append({**row, "points": len(status), "dominated": dominated_points, "failed": failed})
    return rows


def front_texts(results: Results) -> list[tuple[str, ...]]:
    """Return what was found at every sample as text, in the order of `HEADINGS`."""
    return [tuple(f"{row[name]:{form}}" for name, (_, form) in COLUMNS.items()) for row in front_rows(results)]


def front_points(results: Results, method: str) -> tuple[Vector, Vector]:
    """Return J_1 and J_2 of a method's points (instants, later, points, 2), and which are dominated, without the last.

    Along `later` are the instants held: the run's optimum alone, or later ones too where that is a criterion.
    """
    arrays = (results[f"{method}_{name}"] for name in ("J_1", "J_2", "dominated"))
    J_1, J_2, marks = (each if each.ndim == 3 else each[:, None] for each in arrays)
    return np.stack([J_1, J_2], axis=-1), marks.astype(bool)
