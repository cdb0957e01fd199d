"""The fronts of a Pareto study: their file, what they dominate, what weighted sums miss, and a table.

A point is a row of criteria (C,) to be small; NaN means that it could not be solved for.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.results import Quantity, Results, create_results, read_results
from psmpc_cli.logs.schema import PARETO
from psmpc_cli.solvers import Outcome

Vector = np.ndarray

CLEARLY, SAME = 1e-4, 1e-9
"""How much better a point has to be to dominate, and what is no difference, as parts of what the points span."""

WEIGHTED, CONSTRAINED, FREE = "weighted", "constrained", "free"
"""How the arrays of a method begin; `free` are weighted sums with the instant free."""

DIMENSION: Mapping[str, str] = {WEIGHTED: "ratio", CONSTRAINED: "bound", FREE: "ratio"}
"""The dimension along the points of a method."""

BEYOND = 0.1
"""How far beyond the worst value of a criterion the reference point lies, as a part of what the points span."""

STATUS = tuple(outcome.name.lower() for outcome in Outcome)

HEADINGS = (
    "T0 [s]",
    "t_s [s]",
    "omega_2/omega_1",
    "J_1 [s]",
    "J_2 [s]",
    "hypervolume",
    "points",
    "dominated",
    "failed",
)

NOTE = "t_s, J_1 and J_2: as the run optimized them with its own weights"


@dataclass(frozen=True, eq=False)
class FrontGrid:
    """Which problems are solved at every sample.

    Attributes:
        ratios: omega_2 / omega_1 of the weighted sums, rising (N,).
        weighted: Whether all of them are wanted; the first and the last one are always solved.
        bounds: Number of bounds on J_2, evenly between what the first and the last ratio lead to; 0 for none.
        parts: How much later the instant is held than the run's optimum, as parts of what is left of the horizon (H,);
            0 for that optimum itself.
        free: Whether the weighted sums are solved with the instant free as well.
    """

    ratios: Vector
    weighted: bool
    bounds: int
    parts: Vector
    free: bool


@dataclass(frozen=True, eq=False)
class Front:
    """What was found with one method at one instant, or with the instant free.

    Attributes:
        J: J_1 and J_2 of each point (P, 2).
        wait: t_s - T0 (P,) [s].
        objective: What was minimized (P,).
        ratio: omega_2 / omega_1 of each, given or found (P,).
        bound: The bound on J_2 (P,); infinite for weighted sums.
        outcome: Index of each solve's `Outcome` (P,).
    """

    J: Vector
    wait: Vector
    objective: Vector
    ratio: Vector
    bound: Vector
    outcome: Vector


@dataclass(frozen=True, eq=False)
class SampleFronts:
    """What was found at one sample.

    Attributes:
        start: T0 [s].
        wait: t_s - T0 of the run's optimum [s].
        J: J_1 and J_2 of the run's optimum (2,).
        ratio: Its omega_2 / omega_1.
        scale: Normalization of both costs (2,).
        fronts: Those that were wanted, by method: one for each part (H,) at which the instant was held; one for `FREE`.
        again: How many points were solved again because another one served them better.
    """

    start: float
    wait: float
    J: Vector
    ratio: float
    scale: Vector
    fronts: Mapping[str, tuple[Front, ...]]
    again: int


def write_pareto(
    path: Path,
    attributes: Mapping[str, str | int | float],
    stages: Sequence[str],
    grid: FrontGrid,
    fronts: Sequence[SampleFronts],
    force: bool,
) -> None:
    """Write the fronts found at several samples into a file.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """
    quantities = [*_coordinates(stages, grid, fronts), *_of_run(fronts)]
    methods = {method: [sample.fronts[method] for sample in fronts] for method in fronts[0].fronts}
    for method, found in methods.items():
        quantities += _of_method(method, found, _dims(method, grid))
    criteria = _all_criteria(methods, 3 if grid.free else 2)
    verdicts = _dominated(criteria)
    reference = _reference(criteria)
    quantities += [
        Quantity(f"{method}_dominated", _dims(method, grid), marks.astype("i1"), "1", "another point is better")
        for method, marks in verdicts.items()
    ]
    volumes = np.array([hypervolume(_stacked(criteria, i), reference) for i in range(len(fronts))])
    quantities += [
        Quantity("reference", ("criterion",), reference, "s", "reference point of the hypervolume"),
        Quantity("hypervolume", ("instant",), volumes, "s^3" if grid.free else "s^2", "measure of what is dominated"),
    ]
    if WEIGHTED in methods and CONSTRAINED in methods:
        quantities.append(_off_sums(methods, _dims(CONSTRAINED, grid)))
    create_results(path, PARETO, {**attributes, "free_instant": int(grid.free)}, quantities, force)


def read_pareto(path: Path) -> Results:
    """Return the results of a Pareto study.

    Raises:
        LogError: The file is missing, damaged, of another version, or holds something else.
    """
    results = read_results(path, PARETO)
    horizon = results.attributes.get("horizon")
    if not isinstance(horizon, int | float | np.integer | np.floating) or not 0 < horizon < np.inf:
        raise LogError(f"{path}: found no horizon, expected a study written by psmpc pareto")
    return results


def held_at_optimum(results: Results, name: str) -> Vector:
    """Return a method's array for the instant held at the run's optimum, (instants, points)."""
    quantity = results.quantities[name]
    return quantity.values[:, 0] if "later" in quantity.dims else quantity.values


def costs_of(results: Results, method: str) -> Vector:
    """Return J_1 and J_2 of a method's points with the instant held at the run's optimum, (instants, points, 2)."""
    return np.stack([held_at_optimum(results, f"{method}_{J}") for J in ("J_1", "J_2")], axis=-1)


def methods_in(results: Results) -> tuple[str, ...]:
    """Return which methods a file has points of with the instant held."""
    return tuple(method for method in (WEIGHTED, CONSTRAINED) if f"{method}_J_1" in results.quantities)


def _dims(method: str, grid: FrontGrid) -> tuple[str, ...]:
    later = ("later",) if grid.free and method != FREE else ()
    return ("instant", *later, DIMENSION[method])


def _coordinates(stages: Sequence[str], grid: FrontGrid, fronts: Sequence[SampleFronts]) -> list[Quantity]:
    criteria = ["J_1", "J_2", "t_s - T0"] if grid.free else ["J_1", "J_2"]
    found = [
        Quantity("instant", ("instant",), np.array([front.start for front in fronts]), "s", "sampling instant T0"),
        Quantity("stage", ("stage",), np.array(stages), "1", "the two stages"),
        Quantity("criterion", ("criterion",), np.array(criteria), "1", "what is to be small"),
    ]
    if grid.weighted or grid.free:
        found.append(Quantity("ratio", ("ratio",), grid.ratios, "1", "omega_2 / omega_1"))
    if grid.bounds:
        part = np.linspace(0.0, 1.0, grid.bounds)
        words = "bound on J_2, from the smallest ratio's (0) to the largest one's (1)"
        found.append(Quantity("bound", ("bound",), part, "1", words))
    if grid.free:
        words = "how much later the instant is held than the run's optimum, as a part of what is left of the horizon"
        found.append(Quantity("later", ("later",), grid.parts, "1", words))
    return found


def _of_run(fronts: Sequence[SampleFronts]) -> list[Quantity]:
    """Return what the run itself had at the samples."""

    def each(name: str, units: str, words: str, value: Callable[[SampleFronts], object]) -> Quantity:
        return Quantity(name, ("instant",), np.array([value(front) for front in fronts]), units, words)

    scale = np.array([front.scale for front in fronts])
    return [
        each("t_s", "s", "switching instant, as the run optimized it", lambda front: front.start + front.wait),
        each("chosen_ratio", "1", "omega_2 / omega_1 of the run", lambda front: front.ratio),
        each("chosen_J_1", "s", "J_1 of the run's optimum", lambda front: front.J[0]),
        each("chosen_J_2", "s", "J_2 of the run's optimum", lambda front: front.J[1]),
        Quantity("scale", ("instant", "stage"), scale, "1", "normalization of each stage's cost, for all points"),
        each("again", "1", "points solved again because another one served them better", lambda front: front.again),
    ]


def _of_method(method: str, found: Sequence[Sequence[Front]], dims: tuple[str, ...]) -> list[Quantity]:
    """Return the arrays of a method."""

    def each(name: str, units: str, words: str, value: Callable[[Front], Vector], codes: bool = False) -> Quantity:
        values = _shaped(np.array([[value(front) for front in sample] for sample in found]), dims)
        return Quantity(f"{method}_{name}", dims, values, units, words, STATUS if codes else ())

    starts = "weighted sum" if method != CONSTRAINED else "J_1 with J_2 bounded"
    quantities = [
        each("J_1", "s", "normalized cost of the first stage", lambda front: front.J[:, 0]),
        each("J_2", "s", "normalized cost of the second stage", lambda front: front.J[:, 1]),
        each("wait", "s", "t_s - T0", lambda front: front.wait),
        each("objective", "1", f"{starts} and pending cost, over the larger weight", lambda front: front.objective),
        each("status", "1", "outcome of the solve", lambda front: front.outcome, codes=True),
    ]
    if method == CONSTRAINED:
        quantities += [
            each("limit", "s", "bound on J_2", lambda front: front.bound),
            each("ratio", "1", "omega_2 / omega_1 with the same optimum, -dJ_1/dJ_2", lambda front: front.ratio),
        ]
    return quantities


def _shaped(values: Vector, dims: tuple[str, ...]) -> Vector:
    """Return values (instants, parts, points) without the parts where there is only one."""
    return values if len(dims) == 3 else values[:, 0]


def _all_criteria(methods: Mapping[str, Sequence[Sequence[Front]]], count: int) -> dict[str, Vector]:
    """Return the criteria of all points by method, (instants, parts, points, criteria)."""
    return {
        method: np.array([[np.column_stack([front.J, front.wait])[:, :count] for front in sample] for sample in found])
        for method, found in methods.items()
    }


def _stacked(criteria: Mapping[str, Vector], instant: int) -> Vector:
    """Return the criteria of all points at an instant, whatever they were found with, (points, criteria)."""
    return np.concatenate([values[instant].reshape(-1, values.shape[-1]) for values in criteria.values()])


def _dominated(criteria: Mapping[str, Vector]) -> dict[str, Vector]:
    """Return which points are dominated by any other of their instant, by method, in the shape of the file."""
    marks = {method: np.zeros(values.shape[:-1], bool) for method, values in criteria.items()}
    for i in range(len(next(iter(criteria.values())))):
        verdicts, before = dominated(_stacked(criteria, i)), 0
        for method, values in criteria.items():
            size = values[i, ..., 0].size
            marks[method][i] = verdicts[before : before + size].reshape(values.shape[1:-1])
            before += size
    held = max(values.shape[1] for values in criteria.values())
    return {method: values if held > 1 and method != FREE else values[:, 0] for method, values in marks.items()}


def _reference(criteria: Mapping[str, Vector]) -> Vector:
    """Return one reference point for all instants, a little beyond the worst of all points (criteria,)."""
    every = np.concatenate([values.reshape(-1, values.shape[-1]) for values in criteria.values()])
    return np.asarray(np.nanmax(every, axis=0, initial=0.0) + BEYOND * extents(every))


def _off_sums(methods: Mapping[str, Sequence[Sequence[Front]]], dims: tuple[str, ...]) -> Quantity:
    """Return how far each point of the epsilon-constraint method is off what the weighted sums say of the front."""
    off = np.array(
        [
            [off_weighted_sums(one.J, other.J, other.ratio) for one, other in zip(ones, others, strict=True)]
            for ones, others in zip(methods[CONSTRAINED], methods[WEIGHTED], strict=True)
        ]
    )
    words = "distance above the weighted sums' chords (positive) or below their lines (negative), over the front"
    return Quantity("constrained_off_weighted", dims, _shaped(off, dims), "1", words)


def extents(points: Vector) -> Vector:
    """Return what points (P, C) span in each criterion (C,); 1 where that is nothing."""
    known = points[np.isfinite(points).all(axis=1)]
    span = np.ptp(known, axis=0) if len(known) else np.zeros(points.shape[1])
    return np.where(span > 0, span, 1.0)


def dominated(points: Vector, clearly: float = CLEARLY) -> Vector:
    """Return which points (P, C) another is better than in every criterion in which the two differ (P,).

    Better is what is so by `clearly` of the extent: where a front is steep, less is in solvers' last digits.
    """
    better_by = (points[:, None, :] - points[None, :, :]) / extents(points)  # [i, j]: what j is better by than i
    better, same = better_by > clearly, np.abs(better_by) <= SAME
    return np.asarray((np.all(better | same, axis=2) & np.any(better, axis=2)).any(axis=1))


def hypervolume(points: Vector, reference: Vector) -> float:
    """Return the measure of what lies between points (P, 2) or (P, 3) and a reference point (C,), and is dominated."""
    inside = points[np.all(points < reference, axis=1)]
    if not len(inside):
        return 0.0
    if points.shape[1] == 2:
        rising = inside[np.argsort(inside[:, 0])]
        lowest = np.minimum.accumulate(rising[:, 1])
        widths = np.diff(np.append(rising[:, 0], reference[0]))
        return float(widths @ (reference[1] - lowest))
    layers = np.unique(inside[:, -1])
    heights = np.diff(np.append(layers, reference[-1]))
    areas = [hypervolume(inside[inside[:, -1] <= layer, :-1], reference[:-1]) for layer in layers]
    return float(heights @ np.array(areas))


def off_weighted_sums(points: Vector, sums: Vector, ratios: Vector) -> Vector:
    """Return how far points (P, 2) lie outside of what weighted sums (M, 2) say of the front, over its extent (P,).

    The optimum of J_1 + r J_2 leaves nothing below the line of that slope through it, and a convex front does not rise
    above the chords between such optima. Between both a point agrees with them: 0. Positive, it lies above the chords,
    on a part that is not convex and that no weights lead to; negative, it lies below a line, and the optimum was none.

    Args:
        points: (J_1, J_2) of each point.
        sums: (J_1, J_2) of each weighted sum's optimum.
        ratios: omega_2 / omega_1 of each (M,).
    """
    known = np.isfinite(sums).all(axis=1)
    if not known.any():
        return np.full(len(points), np.nan)
    span = extents(sums)
    at, found, normals = (
        points / span,
        sums[known] / span,
        np.column_stack([np.ones(known.sum()), ratios[known]]) * span,
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    below = np.max(np.sum(normals * (found - at[:, None, :]), axis=2), axis=1)
    above = np.array([_above_chords(point, found) for point in at])
    return np.where(np.isnan(at).any(axis=1), np.nan, np.maximum(above, 0.0) - np.maximum(below, 0.0))


def _above_chords(point: Vector, front: Vector) -> float:
    """Return how far a point (2,) lies above the chords of a front (M, 2) that falls; 0 beyond its ends."""
    front = front[np.lexsort((front[:, 0], front[:, 1]))]  # rising in J_2
    if not front[0, 1] < point[1] < front[-1, 1]:
        return 0.0
    upper = int(np.searchsorted(front[:, 1], point[1]))
    start, along = front[upper - 1], front[upper] - front[upper - 1]
    away = point - start
    return float((away[0] * along[1] - away[1] * along[0]) / np.linalg.norm(along))


@dataclass(frozen=True)
class FrontRow:
    """What was found at a sample.

    Attributes:
        instant, t_s: Sampling instant T0, and the switching instant as the run optimized it [s].
        ratio, J_1, J_2: omega_2 / omega_1 of the run, and the normalized costs of its optimum [s].
        hypervolume: Measure of what the points dominate.
        points, dominated, failed: How many there are, how many of them another one dominates, how many have no optimum.
    """

    instant: float
    t_s: float
    ratio: float
    J_1: float
    J_2: float
    hypervolume: float
    points: int
    dominated: int
    failed: int


def front_rows(results: Results) -> tuple[FrontRow, ...]:
    """Return what was found at every sample, whatever it was found with."""
    return tuple(_row(results, i) for i in range(len(results["instant"])))


def front_texts(row: FrontRow) -> tuple[str, ...]:
    """Return a row as text, in the order of `HEADINGS`."""
    return (
        f"{row.instant:.2f}",
        f"{row.t_s:.2f}",
        f"{row.ratio:g}",
        f"{row.J_1:.4f}",
        f"{row.J_2:.4f}",
        f"{row.hypervolume:.3f}",
        str(row.points),
        str(row.dominated),
        str(row.failed),
    )


def _row(results: Results, i: int) -> FrontRow:
    methods = [method for method in (WEIGHTED, CONSTRAINED, FREE) if f"{method}_status" in results.quantities]
    status = np.concatenate([results[f"{method}_status"][i].ravel() for method in methods])
    return FrontRow(
        instant=float(results["instant"][i]),
        t_s=float(results["t_s"][i]),
        ratio=float(results["chosen_ratio"][i]),
        J_1=float(results["chosen_J_1"][i]),
        J_2=float(results["chosen_J_2"][i]),
        hypervolume=float(results["hypervolume"][i]),
        points=len(status),
        dominated=sum(int(results[f"{method}_dominated"][i].sum()) for method in methods),
        failed=int(np.sum(status != STATUS.index("optimal"))),
    )


Measure = Literal["normalized", "per second", "own extent"]

WORDS: dict[Measure, str] = {
    "normalized": "in costs normalized as in (12)",
    "per second": "in their means over each stage's part of the horizon",
    "own extent": "with every front over its own extent",
}
"""The measures of a front: costs as in the windows, normalized by (12) at each sample; their means over the parts of
the horizon that the stages have; and each front over its own extent."""


@dataclass(frozen=True)
class Step:
    """How a front moves from one sample to the next: mean change of J_2 and of J_1 over the points of equal ratio."""

    right: float
    up: float

    @property
    def direction(self) -> str:
        """Where the points move on average, such as upper left; unknown if no ratio has a point at both samples."""
        if not np.isfinite([self.right, self.up]).all():
            return "unknown"
        return f"{'upper' if self.up > 0 else 'lower'} {'left' if self.right < 0 else 'right'}"


@dataclass(frozen=True)
class FrontMovement:
    """How the fronts of a study move.

    Attributes:
        instants: Sampling instants [s].
        against: The largest step of each front against the upper left, as the ratio grows, over its extent.
        moves: Whether the optimum moves at all between the smallest and the largest ratio, in both costs.
        steps: From sample to sample, in each measure.
        parts: The two stages' parts of the horizon at each sample (instants, 2) [s].
    """

    instants: tuple[float, ...]
    against: tuple[float, ...]
    moves: tuple[bool, ...]
    steps: dict[Measure, tuple[Step, ...]]
    parts: Vector

    @property
    def moving(self) -> int:
        """Number of samples at which the optimum moves to the upper left, and never back, as the ratio grows."""
        return sum(moves and step <= CLEARLY for moves, step in zip(self.moves, self.against, strict=True))

    @property
    def with_time(self) -> bool:
        """Whether the front moves to the upper left from every sample to the next, in normalized costs."""
        return all(step.direction == "upper left" for step in self.steps["normalized"])

    def directions(self, measure: Measure = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(step.direction for step in self.steps[measure]).most_common()
        return " and ".join(f"{direction} ({count} of {len(self.steps[measure])})" for direction, count in counts)

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
        (first, second), (first_end, second_end) = self.parts[0], self.parts[-1]
        return (
            *(
                f"from sample to sample, {words}, the front moves to the {self.directions(measure)}"
                for measure, words in WORDS.items()
            ),
            f"meanwhile the first stage's part of the horizon goes from {first:.2f} to {first_end:.2f} s, the second's "
            f"from {second:.2f} to {second_end:.2f} s, and J_1 and J_2 are integrals over them",
        )


def front_movement(results: Results) -> FrontMovement:
    """Return how the fronts of the weighted sums move, the switch time held at the run's optimum.

    Raises:
        InputError: The study has no weighted sums.
    """
    if f"{WEIGHTED}_J_1" not in results.quantities:
        raise InputError(f"{results.path}: found no weighted sums, expected a study with them: only they have a ratio")
    instants, J = results["instant"], costs_of(results, WEIGHTED)
    first = results["t_s"] - instants
    parts = np.column_stack([first, float(np.asarray(results.attributes["horizon"])) - first])
    lows = np.array([np.nanmin(front, axis=0, initial=np.inf) / extents(front) for front in J])[:, None, :]
    followed: dict[Measure, Vector] = {
        "normalized": J,
        "per second": J / parts[:, None, :],
        "own extent": np.array([front / extents(front) for front in J]) - lows,
    }
    known = [front[np.isfinite(front).all(axis=1)] for front in J]
    return FrontMovement(
        instants=tuple(map(float, instants)),
        against=tuple(_against(points / extents(points)) for points in known),
        moves=tuple(bool(len(points)) and bool(np.all(np.ptp(points, axis=0) > 0)) for points in known),
        steps={measure: tuple(_step(*pair) for pair in pairwise(values)) for measure, values in followed.items()},
        parts=parts,
    )


def _against(points: Vector) -> float:
    """Return the largest rise of J_2 or fall of J_1 along the points of a front (N, 2)."""
    steps = np.diff(points, axis=0)
    return float(np.max(np.column_stack([-steps[:, 0], steps[:, 1]]), initial=0.0))


def _step(one: Vector, other: Vector) -> Step:
    """Return how points (N, 2) move from one sample to the next."""
    change = other - one
    change = change[np.isfinite(change).all(axis=1)]
    up, right = change.mean(axis=0) if len(change) else np.full(2, np.nan)
    return Step(float(right), float(up))
