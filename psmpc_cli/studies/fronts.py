"""The fronts of a Pareto study: what their points dominate, what weighted sums miss, how they move, and a table.

A point is a row of criteria (C,) to be small; NaN means that it could not be solved for.
"""

from collections import Counter
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

CLEARLY = 1e-4
SAME = 1e-9
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

NOTE = "t_s, J_1 and J_2: as the run optimized them with its own weights"


def read_fronts(path: Path) -> Results:
    """Return the results of a Pareto study.

    Raises:
        LogError: As for `read_results`; or they are not those of such a study.
    """
    results = read_results(path, PARETO)
    of_run = ("instant", "t_s", "chosen_ratio", "chosen_J_1", "chosen_J_2", "hypervolume")
    check_columns(results, [Column(name, "1", name) for name in of_run], ("instant",))
    check_columns(results, [Column("stage", "1", "stage", dtype="text", dims=("stage",))])
    free = "later" in results.quantities
    methods = [method for method in (WEIGHTED, CONSTRAINED) if f"{method}_status" in results.quantities]
    missing: list[str] = []
    for method in (*methods, *((FREE,) if free else ())):
        types = {"J_1": "f8", "J_2": "f8", "wait": "f8", "status": "i1", "dominated": "i1"}
        held = ("later",) if free and method != FREE else ()
        along = ("instant", *held, "bound" if method == CONSTRAINED else "ratio")
        check_columns(results, [Column(f"{method}_{name}", "1", name, None, types[name]) for name in types], along)
        missing += [f"{method}_{name}" for name in types if f"{method}_{name}" not in results.quantities]
    horizon = results.attributes.get("horizon")
    if missing:
        raise LogError(f"{path}: found no {', '.join(missing)}, expected results as psmpc writes them")
    if not methods or results["stage"].size != 2 or not isinstance(horizon, np.number) or not 0 < horizon < np.inf:
        raise LogError(f"{path}: found no fronts of two stages over a horizon, expected those of psmpc pareto")
    return results


def extents(points: Vector) -> Vector:
    """Return what points (P, C) span in each criterion (C,); 1 where that is nothing."""
    known = points[np.isfinite(points).all(axis=1)]
    span = np.ptp(known, axis=0) if len(known) else np.zeros(points.shape[1])
    return np.where(span > 0, span, 1.0)


def dominated(points: Vector) -> Vector:
    """Return which points (P, C) another is better than in every criterion in which the two differ (P,).

    Better is what is so by `CLEARLY` of the extent: where a front is steep, less is in solvers' last digits.
    """
    better_by = (points[:, None, :] - points[None, :, :]) / extents(points)  # [i, j]: what j is better by than i
    better = better_by > CLEARLY
    same = np.abs(better_by) <= SAME
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
    """Return what was found at every sample, by the names in `COLUMNS`.

    `t_s`, `ratio`, `J_1` and `J_2` are those of the run; `points` are all, `dominated` those that another one
    dominates, `failed` those without optimum.
    """
    methods = [method for method in (WEIGHTED, CONSTRAINED, FREE) if f"{method}_status" in results.quantities]
    rows = []
    for i in range(len(results["instant"])):
        status = np.concatenate([results[f"{method}_status"][i].ravel() for method in methods])
        names = ("instant", "t_s", "chosen_ratio", "chosen_J_1", "chosen_J_2", "hypervolume")
        row: dict[str, float | int] = {name.removeprefix("chosen_"): float(results[name][i]) for name in names}
        marks = sum(int(results[f"{method}_dominated"][i].sum()) for method in methods)
        failed = int(np.sum(status != STATUS.index("optimal")))
        rows.append({**row, "points": len(status), "dominated": marks, "failed": failed})
    return rows


def front_texts(results: Results) -> list[tuple[str, ...]]:
    """Return what was found at every sample as text, in the order of `HEADINGS`."""
    return [tuple(f"{row[name]:{form}}" for name, (_, form) in COLUMNS.items()) for row in front_rows(results)]


MEASURES: Mapping[str, str] = {
    "normalized": "in costs normalized as in (12)",
    "per second": "in their means over each stage's part of the horizon",
    "own extent": "with every front over its own extent",
}
"""What a front is followed in from sample to sample, and how a sentence says that."""


class FrontMovement:
    """How the fronts of a study's weighted sums move, the switch time held at the run's optimum.

    Attributes:
        instants: Sampling instants [s].
        against: The largest step of each front against the upper left, as the ratio grows, over its extent.
        moves: Whether the optimum moves at all between the smallest and the largest ratio, in both costs.
        moving: Number of samples at which it moves to the upper left, and never back, as the ratio grows.
        steps: By measure, the mean change of J_1 and J_2 over the points of equal ratio from sample to sample (S, 2);
            NaN if no ratio has a point at both.
        with_time: Whether the front moves to the upper left from every sample to the next, in normalized costs.
        parts: The two stages' parts of the horizon at each sample (S + 1, 2) [s].
    """

    def __init__(self, results: Results) -> None:
        instants = results["instant"]
        J = front_points(results, WEIGHTED)[0][:, 0]
        first = results["t_s"] - instants
        self.instants: list[float] = instants.tolist()
        self.parts = np.column_stack([first, float(np.asarray(results.attributes["horizon"])) - first])
        relative = J / np.array([extents(front) for front in J])[:, None, :]
        known = [front[np.isfinite(front).all(axis=1)] for front in relative]
        backward = [np.diff(front, axis=0) * [-1.0, 1.0] for front in known]
        self.against = [float(np.max(steps, initial=0.0)) for steps in backward]
        self.moves = [bool(len(front)) and bool(np.all(np.ptp(front, axis=0) > 0)) for front in known]
        self.moving = sum(moves and step <= CLEARLY for moves, step in zip(self.moves, self.against, strict=True))
        lows = np.nanmin(relative, axis=1, keepdims=True, initial=np.inf)
        followed = {"normalized": J, "per second": J / self.parts[:, None, :], "own extent": relative - lows}
        changes = {name: np.ma.masked_invalid(np.diff(values, axis=0)) for name, values in followed.items()}
        self.steps = {name: each.mean(axis=1).filled(np.nan) for name, each in changes.items()}
        self.with_time = all(direction(step) == "upper left" for step in self.steps["normalized"])

    def directions(self, measure: str = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(direction(step) for step in self.steps[measure]).most_common()
        return " and ".join(f"{where} ({count} of {len(self.steps[measure])})" for where, count in counts)

    @property
    def over_ratio(self) -> str:
        """The movement as the ratio grows, as a sentence."""
        return (
            f"with growing omega_2/omega_1 the optimum moves to the upper left at {self.moving} of {len(self.against)} "
            f"instants (against it at most {max(self.against):.1g} of a front)"
        )

    @property
    def over_time(self) -> tuple[str, ...]:
        """The movement from sample to sample, as sentences; empty for a single sample."""
        if len(self.instants) < 2:
            return ()
        first, second = self.parts[0]
        first_end, second_end = self.parts[-1]
        moves = (f"{words}, the front moves to the {self.directions(name)}" for name, words in MEASURES.items())
        return (
            *(f"from sample to sample, {words}" for words in moves),
            f"meanwhile the first stage's part of the horizon goes from {first:.2f} to {first_end:.2f} s, the second's "
            f"from {second:.2f} to {second_end:.2f} s, and J_1 and J_2 are integrals over them",
        )


def direction(step: Vector) -> str:
    """Return where a mean change of J_1 and J_2 (2,) leads, J_2 to the right and J_1 up, such as upper left."""
    up, right = step
    if not np.isfinite(step).all():
        return "unknown"
    return f"{'upper' if up > 0 else 'lower'} {'left' if right < 0 else 'right'}"


def front_points(results: Results, method: str) -> tuple[Vector, Vector]:
    """Return J_1 and J_2 of a method's points (instants, later, points, 2), and which are dominated, without the last.

    Along `later` are the instants held: the run's optimum alone, or later ones too where that is a criterion.
    """
    found = (results[f"{method}_{name}"] for name in ("J_1", "J_2", "dominated"))
    J_1, J_2, marks = (each if each.ndim == 3 else each[:, None] for each in found)
    return np.stack([J_1, J_2], axis=-1), marks.astype(bool)
