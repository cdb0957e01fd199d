"""The objective as printed, delta = 0, against ours: the instants it gives, the control, and J(t_s) itself."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from psmpc_cli.logs.read import Log
from psmpc_cli.studies.ablation import JUMP, OURS, Ablation, Curve, ending, instants, joined, measured, variation
from psmpc_cli.studies.one_window import OneWindow, Scan, instant_grid, optimize_instants, scan_instants

PRINTED = "printed"
"""The run with the objective as printed."""

EQUAL = "equal priorities"
"""The run in which all priorities are 1."""

GUESSES = (0.3, 0.5, 0.975)
"""Where in the horizon the free optimizer starts."""

PROMINENT = 0.01
"""How deep a minimum of J(t_s) is at least, as a part of the range of J."""

Numbers = Mapping[str, float]


def ablate_pending_cost(logs: Mapping[str, Log], windows: Sequence[OneWindow], points: int) -> Ablation:
    """Compare the runs `PRINTED` and `OURS`, and both objectives in windows of other runs at so many instants."""
    runs = (PRINTED, OURS)
    panels: dict[str, dict[str, Curve]] = {
        "instant": instants(logs, runs),
        "variation": {name: variation(logs[name]) for name in runs},
        **{f"{what}, {name}": {} for what in ("J", "minima", "found") for name in runs},
    }
    numbers = measured(logs, runs)
    for one in windows:
        label, window = one.label, one.window
        scan = scan_instants(one, instant_grid(window.horizon, points))
        numbers |= {f"T0, {label}": window.start, f"earliest, {label}": float(scan.instants[0])}
        for name, delta in ((PRINTED, 0.0), (OURS, window.pending_cost)):
            cost = scan.with_pending(delta)
            found = optimize_instants(one, delta, [part * window.horizon for part in GUESSES])
            lowest = np.array(minima(replace(scan, cost=cost)))
            panels[f"J, {name}"][label] = scan.instants, cost / cost[0]
            for what, places in (("minima", lowest), ("found", found)):
                panels[f"{what}, {name}"][label] = places, np.interp(places, scan.instants, cost / cost[0])
            numbers |= _enumerated(f"minimum of J for {label}, {name}", lowest.tolist())
            numbers |= _enumerated(f"found for {label}, {name}", found.tolist())
    return Ablation("pending_cost", _sentence(numbers, windows), panels, numbers)


def minima(scan: Scan) -> list[float]:
    """Return the instants after T0 [s] at which J has a minimum, the lowest first; shallow ones are left out."""
    J = np.r_[np.inf, scan.cost, np.inf]
    places = [i for i in range(len(scan.cost)) if J[i] > J[i + 1] <= J[i + 2]]
    places.sort(key=lambda i: float(scan.cost[i]))
    lowest, least = places[0], PROMINENT * float(np.ptp(scan.cost))
    deep = [i for i in places[1:] if _ridge(scan.cost, lowest, i) - float(scan.cost[i]) >= least]
    return [float(scan.instants[i]) for i in (lowest, *deep)]


def _ridge(J: np.ndarray, i: int, k: int) -> float:
    """Return the highest J on the way between two places."""
    return float(J[min(i, k) : max(i, k) + 1].max())


def _enumerated(what: str, values: Sequence[float]) -> dict[str, float]:
    return {f"{what}, {i}": value for i, value in enumerate(values, start=1)}


def _sentence(numbers: Numbers, windows: Sequence[OneWindow]) -> str:
    """Say what the pending cost changes."""
    labels = [one.label for one in windows]
    horizon, starts = windows[0].window.horizon, joined(f"{numbers[f'T0, {label}']:.1f}" for label in labels)

    def runs(quantity: str, form: str) -> str:
        return f"{numbers[f'{quantity}, {PRINTED}']:{form}} ({numbers[f'{quantity}, {OURS}']:{form}})"

    return (
        "With the objective as printed (in parentheses: ours) the optimized instant of the current stage lies at T_f "
        f"in {runs('at T_f', '.0%')} of the samples that have one and jumps {runs('jumps', '.0f')} times by more than "
        f"{JUMP:g} s, the joints' control varies by {runs('variation', '.1f')} rad/s^2, and the run "
        f"{ending(numbers[f'end, {PRINTED}'])} ({ending(numbers[f'end, {OURS}'])}); in windows "
        f"at {starts} s with priorities {joined(labels)}, T_f {horizon:g} s after T0, J with all but t_s optimized has "
        f"its minimum {_minima(numbers, labels, PRINTED)} ({_minima(numbers, labels, OURS)}), and from {len(GUESSES)} "
        f"guesses the solver returns {_found(numbers, labels, PRINTED)} ({_found(numbers, labels, OURS)})."
    )


def _minima(numbers: Numbers, labels: Sequence[str], name: str) -> str:
    """Name the minima of J in each window, the lowest first."""
    said = {}
    for label in labels:
        lowest, *others = _numbered(numbers, f"minimum of J for {label}, {name}")
        also = f" and a higher one at {joined(f'{value:.2f}' for value in others)} s" if others else ""
        said[label] = f"at {lowest:.2f} s{also}"
    return _by_label(said)


def _found(numbers: Numbers, labels: Sequence[str], name: str) -> str:
    """Name what the solver returns in each window, each value once."""
    found = {label: _numbered(numbers, f"found for {label}, {name}") for label in labels}
    return _by_label({label: f"{joined(sorted({f'{t:.2f}' for t in times}))} s" for label, times in found.items()})


def _by_label(said: Mapping[str, str]) -> str:
    """Return what is said of every label, once if it is the same of all."""
    different = set(said.values())
    return different.pop() if len(different) == 1 else joined(f"{words} for {label}" for label, words in said.items())


def _numbered(numbers: Numbers, what: str) -> list[float]:
    return [value for key, value in numbers.items() if key.startswith(f"{what}, ")]
