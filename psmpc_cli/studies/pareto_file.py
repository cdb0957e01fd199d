"""The file of a Pareto study: what is in it, by which method, and how it is read."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.results import Quantity, Results, create_results, read_results
from psmpc_cli.logs.schema import PARETO
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.fronts import dominated, extents, hypervolume, off_weighted_sums
from psmpc_cli.studies.pareto_windows import Front, Grid, SampleFronts

Vector = np.ndarray

WEIGHTED, CONSTRAINED, FREE = "weighted", "constrained", "free"
"""How the arrays of a method begin; `free` are weighted sums with the instant free."""

DIMENSION: Mapping[str, str] = {WEIGHTED: "ratio", CONSTRAINED: "bound", FREE: "ratio"}
"""The dimension along the points of a method."""

BEYOND = 0.1
"""How far beyond the worst value of a criterion the reference point lies, as a part of what the points span."""

STATUS = tuple(outcome.name.lower() for outcome in Outcome)


def write_pareto(
    path: Path,
    attributes: Mapping[str, str | int | float],
    stages: Sequence[str],
    grid: Grid,
    fronts: Sequence[SampleFronts],
    force: bool,
) -> None:
    """Write the fronts found at several samples into a file.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """
    quantities = [*_coordinates(stages, grid, fronts), *_of_run(fronts)]
    methods = _by_method(grid, fronts)
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


def _dims(method: str, grid: Grid) -> tuple[str, ...]:
    later = ("later",) if grid.free and method != FREE else ()
    return ("instant", *later, DIMENSION[method])


def _by_method(grid: Grid, fronts: Sequence[SampleFronts]) -> dict[str, list[list[Front]]]:
    """Return by method the fronts of every sample, one a part."""
    methods = {WEIGHTED: [list(front.weighted) for front in fronts]} if grid.weighted else {}
    if grid.bounds:
        methods[CONSTRAINED] = [list(front.constrained) for front in fronts]
    if grid.free:
        methods[FREE] = [[front.free] for front in fronts if front.free is not None]
    return methods


def _coordinates(stages: Sequence[str], grid: Grid, fronts: Sequence[SampleFronts]) -> list[Quantity]:
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
