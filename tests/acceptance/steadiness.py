"""How steady the plans of a run are from sample to sample."""

import numpy as np

from psmpc_cli.logs.run import Run


def longest_alternation(u: np.ndarray) -> int:
    """Return the longest run of samples whose control (K,) changes its sign, both values above 1 % of the peak."""
    large = np.abs(u) > 0.01 * np.abs(u).max()
    longest = run = 0
    for changes in (u[1:] * u[:-1] < 0) & large[1:] & large[:-1]:
        run = run + 1 if changes else 0
        longest = max(longest, run)
    return longest


def largest_jump(log: Run) -> float:
    """Return the most that the next optimized instant moves between samples whose windows hold the same stages [s]."""
    first, count = log["window/first"], log["window/count"]
    same = (np.diff(first) == 0) & (np.diff(count) == 0) & (count[1:] > 1)
    ahead = log["window/instants"][np.arange(len(first)), first]
    return float(np.abs(np.diff(ahead)[same]).max(initial=0.0))
