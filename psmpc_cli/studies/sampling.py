"""The pairs of priorities that a sweep over weights tries, and how they stand in its results."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results

Array = np.ndarray

MOST_CELLS = 100_000
"""Largest number of cells; a larger one is a typing error."""

OVER = "omega_2 / omega_1"


@dataclass(frozen=True, eq=False)
class Sampling:
    """The pairs of priorities that a sweep tries, as a list of cells.

    Attributes:
        label: As the user wrote it, such as 25x25, 49 or random:40.
        omega: Priorities of the two stages in each cell, (cells, 2).
        dims: Dimensions of the arrays of the cells.
        columns: Arrays along these dimensions that say what the priorities are.
        scales: Coordinates whose values a reader needs.
    """

    label: str
    omega: Array

    dims: ClassVar[tuple[str, ...]]
    columns: ClassVar[tuple[str, ...]] = ("ratio", "omega_1", "omega_2")
    scales: ClassVar[tuple[str, ...]] = ()

    @property
    def ratio(self) -> Array:
        """omega_2 / omega_1 of each cell (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])

    def coordinates(self, stages: Sequence[str]) -> list[Quantity]:
        """Build the arrays that say in a file of results which priorities each cell has.

        Args:
            stages: Names of the two stages whose priorities differ from cell to cell.
        """
        first, second = stages
        return [
            Quantity("ratio", self.dims, self.ratio, "1", OVER),
            Quantity("omega_1", self.dims, self.omega[:, 0], "1", f"priority of {first}"),
            Quantity("omega_2", self.dims, self.omega[:, 1], "1", f"priority of {second}"),
        ]

    @classmethod
    def omega_in(cls, results: Results) -> Array:
        """Read the priorities in each cell (cells, 2) from results."""
        return np.column_stack([results["omega_1"], results["omega_2"]])


class Ratios(Sampling):
    """Ratios of the priorities, with the geometric mean of both at 1."""

    dims = ("ratio",)


class Draws(Sampling):
    """Random pairs of priorities."""

    dims = ("cell",)

    def coordinates(self, stages: Sequence[str]) -> list[Quantity]:
        """Build the number of each cell, and the priorities."""
        number = Quantity("cell", self.dims, np.arange(len(self.omega)), "1", "number of the cell")
        return [number, *super().coordinates(stages)]


class FullFactorial(Sampling):
    """A full factorial design: a grid over both priorities, whose cells go along omega_2, then omega_1."""

    dims = ("omega_2", "omega_1")
    columns = ("ratio",)
    scales = dims

    def coordinates(self, stages: Sequence[str]) -> list[Quantity]:
        """Build the priorities along both axes of the grid, and the ratio in each of its cells (omega_2, omega_1).

        All cells of one omega_2 follow each other, so the number of those with the first one is that of the columns.
        """
        first, second = stages
        omega_1 = self.omega[:, 0]
        omega_2 = self.omega[:, 1]
        columns = np.count_nonzero(omega_2 == omega_2[0])
        return [
            Quantity("omega_2", ("omega_2",), omega_2[::columns], "1", f"priority of {second}"),
            Quantity("omega_1", ("omega_1",), omega_1[:columns], "1", f"priority of {first}"),
            Quantity("ratio", self.dims, self.ratio.reshape(-1, columns), "1", OVER),
        ]

    @classmethod
    def omega_in(cls, results: Results) -> Array:
        """Read the priorities in each cell (cells, 2) from results."""
        omega_2, omega_1 = np.meshgrid(results["omega_2"], results["omega_1"], indexing="ij")
        return np.column_stack([omega_1.ravel(), omega_2.ravel()])


SAMPLINGS: Mapping[tuple[str, ...], type[Sampling]] = {each.dims: each for each in (FullFactorial, Ratios, Draws)}
"""The samplings by the dimensions of their cells, by which a reader tells them apart."""


def parse_numbers(option: str, text: str, expected: str, above: float = -np.inf, by: str = ",") -> tuple[float, ...]:
    """Parse the numbers of a list such as 1e-3,1e-2, and sort them, each once.

    Raises:
        InputError: One is no finite number above the smallest.
    """
    try:
        numbers = sorted({float(part) for part in text.split(by)})
    except ValueError:
        numbers = [np.nan]
    if not all(above < number < np.inf for number in numbers):
        raise InputError(f"{option}: found '{text}', expected {expected}")
    return tuple(numbers)


def parse_sampling(text: str, bounds: tuple[float, ...], seed: int = 0) -> Sampling:
    """Choose the pairs of priorities omega_1, omega_2 that a sweep tries, from a short text of the user.

    Args:
        text: What to try. `25x25` is a grid of 25 values of omega_1 by 25 of omega_2, evenly in their logarithms. `49`
            is 49 ratios omega_2 / omega_1, evenly in their logarithm, with omega_1 omega_2 = 1. `random:40` is 40
            random pairs, whose logarithms are uniform.
        bounds: The lowest and the highest priority.
        seed: Seed of random pairs.

    Raises:
        InputError: The text is none of these, there are more than `MOST_CELLS` pairs, or `bounds` is not two numbers.
    """
    if len(bounds) != 2:
        raise InputError(f"--range: found {len(bounds)} numbers, expected two, LOW:HIGH, such as 1e-3:1e3")
    match = re.fullmatch(r"(random:)?(\d+)|(\d+)x(\d+)", text.strip())
    sizes = [int(size) for size in match.groups()[1:] if size] if match else []
    is_random = match is not None and match[1] is not None
    if not sizes or min(sizes) < (1 if is_random else 2) or np.prod(sizes) > MOST_CELLS:
        raise InputError(
            f"found '{text}', expected a grid of two sizes of at least 2 such as 25x25 (omega_1 by omega_2), a number "
            f"of ratios such as 49, or --sampling random:N such as random:100; at most {MOST_CELLS} cells"
        )
    low, high = np.log10(bounds)  # all below is in decimal logarithms until the power of 10
    label = text.strip()
    if is_random:
        return Draws(label, 10.0 ** np.random.default_rng(seed).uniform(low, high, (sizes[0], 2)))
    if len(sizes) == 1:
        # the logarithm of the ratio goes from low - high to high - low; each priority has half of it, with its sign
        return Ratios(label, 10.0 ** np.outer(np.linspace(low - high, high - low, sizes[0]) / 2, [-1.0, 1.0]))
    omega_2, omega_1 = np.meshgrid(*(np.linspace(low, high, size) for size in reversed(sizes)), indexing="ij")
    return FullFactorial(label, 10.0 ** np.column_stack([omega_1.ravel(), omega_2.ravel()]))
