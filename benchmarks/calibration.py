"""Looks for what the paper leaves open: W_r, zeta, tolerances, the cost of waiting, and epsilon of the actual starts.

    python benchmarks/calibration.py screen [COUNT]    random settings at N_s = 25, drawn by seed
    python benchmarks/calibration.py refine [COUNT]    the best ones at N_s = 100
    python benchmarks/calibration.py table             the best of both as a table of docs/reproduce.md
    python benchmarks/calibration.py figure            docs/figures/early_starts.png

Each setting adds a line to benchmarks/calibration.jsonl, and a setting that has its line is not repeated. PSMPC runs
first, SMPC where PSMPC is near what is published. A setting is scored by how many claims of the paper it meets with the
best epsilon, then by the root mean square of the differences of the times.
"""

import json
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from pages import markdown

from psmpc_cli.figures.style import PALETTE, in_style
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

RESULTS = Path(__file__).with_suffix(".jsonl")
STAGES = ("approach", "capture", "transport", "release")
PSMPC, SMPC = (10.3, 13.8, 24.4, 31.3), (10.3, 15.1)
PSMPC_START, SMPC_START = 6.3, 8.8
"""Published switch times, and actual starts of Capture [s]."""

EPSILONS = {
    25: (0.02, 0.05, 0.1, 0.25, 0.5, 0.75),
    100: (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75),
}
"""Thresholds of `onset: closeness`, by N_s."""

HEADINGS = ("N_s", "W_r move, reach", "zeta", "pending cost", "tolerances [1e-3]", "epsilon", "claims", "rms [s]")

HORIZON, SAMPLE = 4.0, 0.1

CLAIMS = 17
"""How many claims on PSMPC and SMPC a setting is scored by."""
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "early_starts.png"

Row = dict[str, Any]


def draw(seed: int) -> Row:
    """Return the setting of a seed: W_r of both skills, zeta, the cost of waiting, tolerances by stage."""
    random = np.random.default_rng(seed)

    def within(low: float, high: float) -> float:
        return rounded(10 ** random.uniform(np.log10(low), np.log10(high)))

    move, apart = within(0.01, 30), random.random() < 0.5
    reach = within(0.01, 30) if apart else move
    base, own_capture = within(5e-4, 2e-2), random.random() < 0.7
    capture, release = within(5e-4, 2e-2) if own_capture else base, within(2e-3, 0.1)
    zeta, pending = within(1e-3, 0.1), 1.0 if random.random() < 0.6 else within(0.1, 10)
    return {"move": move, "reach": reach, "zeta": zeta, "pending": pending, "tolerance": [base, capture, base, release]}


def rounded(value: float) -> float:
    """Return a number with three digits."""
    return float(f"{value:.3g}")


def run(setting: Row, controller: str, nodes: int) -> Row:
    """Run the transport task with a setting and return its times [s] and how it ended."""
    pending = setting.get(f"{controller}_pending", setting["pending"])  # smpc may have its own
    changes = {
        "controller": {"kind": controller, "nodes": nodes, "zeta": setting["zeta"], "pending_cost": pending},
        **{f"skills.{skill}.weights.control": setting[skill] for skill in ("move", "reach")},
        **{f"stages.{s}.ends_when.tolerance": t for s, t in zip(STAGES, setting["tolerance"], strict=True)},
        "onset": {"kind": "closeness", "epsilon": 0.5, "series": list(EPSILONS[nodes])},
        "log": {"plans": False, "shares": False},
    }
    done = simulate(load_task("transport", changes))
    summary, starts = done.summary(), done.stages["actual_start_by_epsilon"]
    broken = [float(each.broken_at) for each in summary.monitors if not each.held]
    return {
        "ends": [round(float(stage.switch_time), 4) for stage in summary.stages],
        "starts": [[round(float(start), 4) for start in row[: len(EPSILONS[nodes])]] for row in starts[1:]],
        "succeeded": summary.succeeded,
        "broken_at": min(broken, default=None),
    }


def near(psmpc: Row) -> bool:
    """Tell whether PSMPC succeeds with all instants within 1.5 tolerances of the published ones."""
    pairs = zip(psmpc["ends"], PSMPC, strict=True)
    return psmpc["succeeded"] and all(abs(end - time) <= 1.5 * max(0.8, 0.05 * time) for end, time in pairs)


def missed(row: Row, index: int) -> tuple[list[str], float]:
    """Return the claims that a setting does not meet with the threshold at an index, and the rms difference [s]."""
    psmpc, smpc = row["psmpc"], row["smpc"]
    (p1, p2, p3, _), (s1, s2, s3, _) = psmpc["ends"], smpc["ends"]
    (pc, pt, pr), (sc, st, sr) = ([of[index] for of in each["starts"]] for each in (psmpc, smpc))
    times = {
        **{f"psmpc {stage}": pair for stage, *pair in zip(STAGES[1:], psmpc["ends"][1:], PSMPC[1:], strict=True)},
        **{f"smpc {stage}": pair for stage, *pair in zip(STAGES[:2], (s1, s2), SMPC, strict=True)},
        "psmpc start": [pc, PSMPC_START],
        "smpc start": [sc, SMPC_START],
    }
    one = SAMPLE + 1e-9
    claims = {
        **{name: abs(found - time) <= max(0.8, 0.05 * time) + 1e-9 for name, (found, time) in times.items()},
        "once seen": abs(pc - (p1 - HORIZON)) <= one,
        "transport on time": abs(pt - p2) <= one,
        "release on time": abs(pr - p3) <= one,
        "none before it is seen": all(s >= end - HORIZON - one for s, end in ((pc, p1), (pt, p2), (pr, p3))),
        "psmpc succeeds": psmpc["succeeded"],
        "smpc fails": not smpc["succeeded"],
        "smpc starts early": all(s < end - 1e-6 for s, end in ((sc, s1), (st, s2), (sr, s3))),
        "smpc loses it by that": smpc["broken_at"] is not None and sr <= smpc["broken_at"] < s3,
        "capture starts earlier than smpc's": pc < sc,
        "capture ends earlier than smpc's": p2 < s2,
    }
    squares = [(found - time) ** 2 for found, time in (*times.values(), (p1, PSMPC[0]))]
    return [name for name, met in claims.items() if not met], float(np.sqrt(np.mean(squares)))


def best(rows: list[Row], nodes: int) -> list[tuple[int, float, float, list[str], Row]]:
    """Return misses, rms [s], epsilon, missed claims and row, by setting with its best epsilon, best first."""
    found = []
    for row in rows:
        if row["nodes"] == nodes and "smpc" in row:
            scores = [(*missed(row, index), epsilon) for index, epsilon in enumerate(EPSILONS[nodes])]
            names, rms, epsilon = min(scores, key=lambda score: (len(score[0]), score[1]))
            found.append((len(names), rms, epsilon, names, row))
    return sorted(found, key=lambda each: each[:3])


def settings(command: str, count: int, rows: list[Row]) -> Iterator[tuple[int, Row]]:
    """Give the settings of a screen or a refinement that have no line yet, with their seeds."""
    if command == "screen":
        screened = {row["seed"] for row in rows if row["nodes"] == 25}
        yield from ((seed, draw(seed)) for seed in range(count) if seed not in screened)
        return
    refined = [row["setting"] for row in rows if row["nodes"] == 100]
    for _, _, _, _, row in best(rows, 25)[:count]:
        if row["setting"] not in refined:
            yield row["seed"], row["setting"]


def plot_early_starts(rows: list[Row]) -> Figure:
    """Plot how long before its time each stage starts in the screened settings, over W_r and zeta, with the medians."""
    screened = [row for row in rows if row["nodes"] == 25 and "smpc" in row and row["setting"]["pending"] >= 0.8]
    keys = {"move": "$W_r$ of the skill move (1)", "zeta": "ζ (1)"}
    curves = [
        ("capture, PSMPC", "psmpc", 0),
        ("release, SMPC", "smpc", 2),
        ("capture, SMPC", "smpc", 0),
        ("release, PSMPC", "psmpc", 2),
        ("transport, PSMPC", "psmpc", 1),
    ]
    with in_style():
        figure, panels = plt.subplots(2, 2, sharex="col", sharey=True, figsize=(7.2, 5.2), layout="constrained")
        for (key, label), column in zip(keys.items(), panels.T, strict=True):
            values = np.array([row["setting"][key] for row in screened])
            edges = np.quantile(values, np.linspace(0, 1, 11))
            for epsilon, axes in zip((0.1, 0.5), column, strict=True):
                index = EPSILONS[25].index(epsilon)
                for color, (name, controller, stage) in zip(PALETTE, curves, strict=False):
                    runs = [row[controller] for row in screened]
                    lead = np.array([run["ends"][stage] - run["starts"][stage][index] for run in runs])
                    within = [(values >= low) & (values <= high) for low, high in pairwise(edges)]
                    axes.plot(values, lead, ".", color=color, alpha=0.25, markersize=2.5)
                    middles = [float(np.median(values[which])) for which in within]
                    axes.plot(middles, [float(np.median(lead[which])) for which in within], color=color, label=name)
                axes.set_xscale("log")
                axes.set_title(f"closeness, ε = {epsilon:g}", loc="left")
            column[-1].set_xlabel(label)
        for axes in panels[:, 0]:
            axes.set_ylabel("Starts before its time by (s)")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def table(rows: list[Row]) -> Iterator[str]:
    """Yield a table of the best settings of each N_s: with one pending cost for both controllers, and with two."""
    found = []
    for nodes in EPSILONS:
        ranked = best(rows, nodes)
        for own in (False, True):
            chosen = [each for each in ranked if ("smpc_pending" in each[-1]["setting"]) == own]
            for misses, rms, epsilon, _, row in chosen[: 1 if own else 4]:
                setting = row["setting"]
                pending = f"{setting['pending']:g}" + (f", SMPC {setting['smpc_pending']:g}" if own else "")
                weights = f"{setting['move']:g}, {setting['reach']:g}"
                tolerances = ", ".join(f"{1e3 * each:g}" for each in setting["tolerance"])
                claims = f"{CLAIMS - misses} of {CLAIMS}"
                found.append((nodes, weights, setting["zeta"], pending, tolerances, epsilon, claims, f"{rms:.2f}"))
    return markdown(HEADINGS, found)


def main(command: str, count: str = "100") -> None:
    """Run what is missing of a screen or a refinement, or write the figure or the table."""
    rows = [json.loads(line) for line in RESULTS.read_text(encoding="utf-8").splitlines()]
    if command == "table":
        print("\n".join(table(rows)))
        return
    if command == "figure":
        plot_early_starts(rows).savefig(FIGURE, dpi=130)
        return
    nodes = 25 if command == "screen" else 100
    for seed, setting in settings(command, int(count), rows):
        row = {"nodes": nodes, "seed": seed, "setting": setting, "psmpc": run(setting, "psmpc", nodes)}
        if near(row["psmpc"]):
            row["smpc"] = run(setting, "smpc", nodes)
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
