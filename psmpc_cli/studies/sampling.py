"""Which priorities a sweep tries: a grid, ratios alone, or random draws from the same box."""

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError

MOST_CELLS = 100_000
"""More cells than anyone waits for: a slip of the keyboard, and memory that no machine has."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """The cells of a sweep.

    Attributes:
        kind: A grid over both priorities, ratios with the geometric mean of both at 1, or random draws.
        label: As the user wrote it, such as 25x25, 49 or random:40.
        omega: Priorities of the two stages in each cell, (cells, 2).
        shape: Of the results' arrays: (omega_2, omega_1) of a grid, (cells,) of the others.
    """

    kind: Literal["grid", "ratios", "random"]
    label: str
    omega: np.ndarray
    shape: tuple[int, ...]

    @property
    def ratio(self) -> np.ndarray:
        """omega_2 / omega_1 of each cell (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])

    def index(self, cell: int) -> tuple[int, ...]:
        """Return where a cell stands in the results' arrays."""
        return tuple(int(i) for i in np.unravel_index(cell, self.shape))


def parse_range(text: str) -> tuple[float, float]:
    """Return the bounds of a range such as 1e-3:1e3.

    Raises:
        InputError: It is none, or not of positive rising numbers.
    """
    low, colon, high = text.partition(":")
    try:
        bounds = float(low), float(high)
    except ValueError:
        bounds = (np.nan, np.nan)
    if not colon or not 0 < bounds[0] < bounds[1] < np.inf:
        raise InputError(f"--range: found '{text}', expected LOW:HIGH with 0 < LOW < HIGH, such as 1e-3:1e3")
    return bounds


def parse_epsilons(text: str) -> tuple[float, ...]:
    """Return the thresholds of a list such as 1e-3,1e-2, rising.

    Raises:
        InputError: One is no positive number.
    """
    try:
        found = sorted({float(part) for part in text.split(",")})
    except ValueError:
        found = []
    if not found or not 0 < found[0] <= found[-1] < np.inf:
        raise InputError(f"--epsilon: found '{text}', expected positive numbers between commas, such as 1e-3,1e-2,0.1")
    return tuple(found)


def is_grid(text: str) -> bool:
    """Return whether a text is meant as a grid or a number of ratios, and not as a task."""
    return re.match(r"\s*[-+]?\d", text) is not None and not text.endswith((".yaml", ".yml")) and "/" not in text


def grid_sampling(text: str, bounds: tuple[float, float]) -> Sampling:
    """Return the cells of a grid such as 25x25 (omega_1 by omega_2), or of a number of ratios such as 49.

    Raises:
        InputError: It is neither.
    """
    match = re.fullmatch(r"(\d+)(?:x(\d+))?", text.strip())
    sizes = [int(size) for size in match.groups() if size] if match else []
    if not sizes or min(sizes) < 2:
        raise InputError(
            f"the grid: found '{text}', expected two sizes of at least 2 such as 25x25 (omega_1 by omega_2), or a "
            "number of ratios such as 49"
        )
    _ensure_bearable(text, int(np.prod(sizes)))
    low, high = np.log10(bounds)
    if len(sizes) == 1:
        half = np.linspace(low - high, high - low, sizes[0]) / 2
        return Sampling("ratios", text.strip(), 10.0 ** np.column_stack([-half, half]), (sizes[0],))
    axes = [10.0 ** np.linspace(low, high, size) for size in sizes]
    omega_2, omega_1 = np.meshgrid(axes[1], axes[0], indexing="ij")
    omega = np.column_stack([omega_1.ravel(), omega_2.ravel()])
    return Sampling("grid", text.strip(), omega, (sizes[1], sizes[0]))


def random_sampling(text: str, bounds: tuple[float, float], seed: int) -> Sampling:
    """Return the cells of a sampling such as random:40: log-uniform draws from the box.

    Raises:
        InputError: It is none.
    """
    match = re.fullmatch(r"random:(\d+)", text.strip())
    if match is None or int(match[1]) < 1:
        raise InputError(f"--sampling: found '{text}', expected random:N with N of at least 1, such as random:100")
    _ensure_bearable(text, int(match[1]))
    low, high = np.log10(bounds)
    draws = np.random.default_rng(seed).uniform(low, high, (int(match[1]), 2))
    return Sampling("random", text.strip(), 10.0**draws, (len(draws),))


def _ensure_bearable(text: str, cells: int) -> None:
    if cells > MOST_CELLS:
        raise InputError(f"found '{text}' with {cells} cells, expected at most {MOST_CELLS}")
