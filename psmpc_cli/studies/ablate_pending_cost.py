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
        label, window = one.ratio, one.window
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
    ratios = list(dict.fromkeys(one.ratio for one in windows))
    horizon, starts = windows[0].window.horizon, joined(f"{numbers[f'T0, {ratio}']:.1f}" for ratio in ratios)

    def runs(quantity: str, form: str) -> str:
        return f"{numbers[f'{quantity}, {PRINTED}']:{form}} ({numbers[f'{quantity}, {OURS}']:{form}})"

    return (
        "With the objective as printed (in parentheses: ours) the optimized instant of the current stage lies at T_f "
        f"in {runs('at T_f', '.0%')} of the samples that have one and jumps {runs('jumps', '.0f')} times by more than "
        f"{JUMP:g} s, the joints' control varies by {runs('variation', '.1f')} rad/s^2, and the run "
        f"{ending(numbers[f'end, {PRINTED}'])} ({ending(numbers[f'end, {OURS}'])}); in windows at "
        f"{starts} s of runs with priorities {joined(ratios)}, with T_f {horizon:g} s after T0, J with all but t_s "
        f"optimized has its minimum {_minima(numbers, ratios, PRINTED)} ({_minima(numbers, ratios, OURS)}), and from "
        f"{len(GUESSES)} guesses each the solver returns {_found(numbers, ratios, PRINTED)} "
        f"({_found(numbers, ratios, OURS)})."
    )


def _minima(numbers: Numbers, ratios: Sequence[str], name: str) -> str:
    """Name the minima of J for each ratio of priorities, the lowest first."""
    found = {label: _numbered(numbers, f"minimum of J for {label}, {name}") for label in ratios}
    parts = []
    for label, (lowest, *others) in found.items():
        also = f" and a higher one at {joined(f'{value:.2f}' for value in others)} s" if others else ""
        parts.append(f"at {lowest:.2f} s{also} for {label}")
    return joined(parts)


def _found(numbers: Numbers, ratios: Sequence[str], name: str) -> str:
    """Name what the solver returns, each value once."""
    found = [value for label in ratios for value in _numbered(numbers, f"found for {label}, {name}")]
    return f"{joined(sorted({f'{value:.2f}' for value in found}))} s"


def _numbered(numbers: Numbers, what: str) -> list[float]:
    return [value for key, value in numbers.items() if key.startswith(f"{what}, ")]
