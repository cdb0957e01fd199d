"""Looks for what the paper leaves open: W_r, zeta, tolerances, the cost of waiting, and epsilon of the actual starts.

    python benchmarks/calibration.py screen [COUNT]    random settings at N_s = 25, drawn by seed
    python benchmarks/calibration.py refine [COUNT]    the best ones at N_s = 100
    python benchmarks/calibration.py table             the best of both as a table of docs/reproduce.md
    python benchmarks/calibration.py held              in how many settings each claim holds, for docs and claims.yaml
    python benchmarks/calibration.py figure            docs/figures/early_starts.png

Each setting adds a line to benchmarks/calibration.jsonl, and a setting that has its line is not repeated. PSMPC runs
first, SMPC where PSMPC is near what is published. A setting is scored by how many of the counted claims on these two
controllers it meets with the best epsilon, by the rules of `psmpc reproduce` but none by a time that is earlier than
published, then by the root mean square of the differences of the times.
"""

import json
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from pages import ROOT, command_line, markdown

import psmpc_cli as psmpc
from psmpc_cli.figures.style import PALETTE, in_style
from psmpc_cli.paper.claims import Claim, Finding, load_claims
from psmpc_cli.paper.missions import MISSION_RULES, ROUNDING, Mission, judge_missions, time_tolerance

RESULTS = Path(__file__).with_suffix(".jsonl")
STAGES = ("approach", "capture", "transport", "release")
PSMPC = (10.3, 13.8, 24.4, 31.3)
"""Switch times of PSMPC as published [s]; the first one by its claim that Capture starts at t1 - T_h = 6.3 s."""

METHODS = ("psmpc", "smpc")

SHIPPED_EPSILON = 0.5
"""Threshold of `onset: closeness` in the transport task."""

EPSILONS = {
    25: (0.02, 0.05, 0.1, 0.25, 0.5, 0.75),
    100: (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75),
}
"""Thresholds of `onset: closeness`, by N_s."""

HORIZON = 4.0
SAMPLE_TIME = 0.1
"""Of the transport task [s]."""

CURVES = {
    "capture, PSMPC": ("psmpc", 0),
    "release, SMPC": ("smpc", 2),
    "capture, SMPC": ("smpc", 0),
    "release, PSMPC": ("psmpc", 2),
    "transport, PSMPC": ("psmpc", 1),
}
"""Controller and stage, after Approach, of the curves of the figure."""

Row = dict[str, Any]


def read_rows(nodes: int, scored: bool = False) -> list[Row]:
    """Return the results at N_s, all of them or those with both controllers."""
    rows = map(json.loads, RESULTS.read_text(encoding="utf-8").splitlines())
    return [row for row in rows if row["nodes"] == nodes and ("smpc" in row or not scored)]


def draw(seed: int) -> Row:
    """Return the setting of a seed: W_r of both skills, zeta, the cost of waiting, tolerances by stage."""
    random = np.random.default_rng(seed)

    def within(low: float, high: float) -> float:
        return float(f"{10 ** random.uniform(np.log10(low), np.log10(high)):.3g}")

    move, apart = within(0.01, 30), random.random() < 0.5
    reach = within(0.01, 30) if apart else move
    base, own_capture = within(5e-4, 2e-2), random.random() < 0.7
    capture, release = within(5e-4, 2e-2) if own_capture else base, within(2e-3, 0.1)
    zeta, pending = within(1e-3, 0.1), 1.0 if random.random() < 0.6 else within(0.1, 10)
    return {"move": move, "reach": reach, "zeta": zeta, "pending": pending, "tolerance": [base, capture, base, release]}


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
    done = psmpc.simulate(psmpc.load_task("transport", changes))
    summary, starts = done.summary(), done.stages["actual_start_by_epsilon"]
    return {
        "ends": [round(float(stage.switch_time), 4) for stage in summary.stages],
        "starts": [[round(float(start), 4) for start in row[: len(EPSILONS[nodes])]] for row in starts[1:]],
        "succeeded": summary.succeeded,
        "broken_at": min((float(each.broken_at) for each in summary.monitors if not each.held), default=None),
    }


def is_near(found: float, published: float, factor: float = 1.0) -> bool:
    """Return whether a time is within its tolerance, or so many times that, of the published one [s]."""
    return abs(found - published) <= factor * time_tolerance(published) + ROUNDING


def mission(row: Row, index: int) -> Mission:
    """Return what the rules read of a run in a row of the results, with the threshold at an index."""
    broken_at = row["broken_at"]
    return Mission(
        stages=STAGES,
        starts=(0.0, *(by_epsilon[index] for by_epsilon in row["starts"])),
        ends=tuple(row["ends"]),
        succeeded=row["succeeded"],
        broken_at=np.nan if broken_at is None else broken_at,
        horizon=HORIZON,
        sample_time=SAMPLE_TIME,
    )


def judged_claims() -> list[Claim]:
    """Return the claims that runs of PSMPC and SMPC tell, counted or not."""
    on_runs = [claim for claim in load_claims() if claim.rule in MISSION_RULES]
    return [claim for claim in on_runs if {name.partition(".")[0] for name in claim.reads} <= set(METHODS)]


def findings(row: Row, index: int) -> list[Finding]:
    """Judge these claims of a setting, with the threshold at an index."""
    missions = {method: mission(row[method], index) for method in METHODS}
    return [judge_missions(claim, missions) for claim in judged_claims()]


def score(row: Row, index: int) -> tuple[int, float]:
    """Return how many counted claims a setting misses with the threshold at an index, and the rms difference [s]."""
    judged = [finding for finding in findings(row, index) if finding.claim.apart is None]
    differences = [finding.difference for finding in judged if finding.claim.rule == "time"]
    first_end = row["psmpc"]["ends"][0]
    missed = sum(finding.earlier or not finding.holds for finding in judged)
    return missed, float(np.sqrt(np.mean(np.square([*differences, first_end - PSMPC[0]]))))


def count_held() -> dict[str, tuple[int, int, int]]:
    """Count in how many of the settings with both runs at N_s = 25 each claim holds, by the shipped epsilon.

    Returns:
        By claim in how many it holds, in how many of these by a time earlier than published, and how many settings.
    """
    rows = read_rows(25, scored=True)
    index = EPSILONS[25].index(SHIPPED_EPSILON)
    judged = [findings(row, index) for row in rows]
    counts = {}
    for claim, of_claim in zip(judged_claims(), zip(*judged, strict=True), strict=True):
        holds = sum(finding.holds for finding in of_claim)
        earlier = sum(finding.earlier for finding in of_claim)
        counts[claim.id] = (holds, earlier, len(rows))
    return counts


def held() -> Iterator[str]:
    """Yield in how many of the searched settings each claim holds, the rarest first."""
    claims = {claim.id: claim for claim in judged_claims()}
    rows = []
    for name, (holds, earlier, total) in sorted(count_held().items(), key=lambda each: each[1]):
        rows.append(
            {
                "claim": f"`{name}`",
                "statement": claims[name].statement,
                "holds in": f"{holds} of {total}",
                "earlier than published": earlier or "",
                "not counted, follows from": claims[name].apart or "",
            }
        )
    return markdown(rows)


def best(nodes: int) -> list[tuple[int, float, float, Row]]:
    """Return claims missed, rms [s], epsilon and row of each setting at N_s with its best epsilon, best first."""
    found = []
    for row in read_rows(nodes, scored=True):
        scores = ((*score(row, index), epsilon) for index, epsilon in enumerate(EPSILONS[nodes]))
        found.append((*min(scores), row))
    return sorted(found, key=lambda each: each[:3])


def measure(nodes: int, settings: Iterable[tuple[int, Row]]) -> Iterator[str]:
    """Run settings, given with their seeds, add their lines to the results and yield them."""
    for seed, setting in settings:
        row = {"nodes": nodes, "seed": seed, "setting": setting, "psmpc": run(setting, "psmpc", nodes)}
        if row["psmpc"]["succeeded"] and all(map(is_near, row["psmpc"]["ends"], PSMPC, [1.5] * len(PSMPC))):
            row["smpc"] = run(setting, "smpc", nodes)
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(row)}\n")
        yield json.dumps(row)


def screen(count: str = "100") -> Iterator[str]:
    """Run so many drawn settings, but those that have been run."""
    screened = {row["seed"] for row in read_rows(25)}
    return measure(25, ((seed, draw(seed)) for seed in range(int(count)) if seed not in screened))


def refine(count: str = "100") -> Iterator[str]:
    """Run so many of the best screened settings at N_s = 100, but those that have been run."""
    refined, screened = [row["setting"] for row in read_rows(100)], [row for *_, row in best(25)[: int(count)]]
    return measure(100, ((row["seed"], row["setting"]) for row in screened if row["setting"] not in refined))


def table() -> Iterator[str]:
    """Yield the best settings of each N_s: with one pending cost for both controllers, and with two."""
    rows = []
    count = sum(claim.apart is None for claim in judged_claims())
    for nodes, own in ((nodes, own) for nodes in EPSILONS for own in (False, True)):
        chosen = [each for each in best(nodes) if ("smpc_pending" in each[-1]["setting"]) == own]
        for missed, rms, epsilon, row in chosen[: 1 if own else 4]:
            setting = row["setting"]
            rows.append(
                {
                    "N_s": nodes,
                    "W_r move, reach": f"{setting['move']:g}, {setting['reach']:g}",
                    "zeta": setting["zeta"],
                    "pending cost": f"{setting['pending']:g}" + (f", SMPC {setting['smpc_pending']:g}" if own else ""),
                    "tolerances [1e-3]": ", ".join(f"{1e3 * each:g}" for each in setting["tolerance"]),
                    "epsilon": epsilon,
                    "claims": f"{count - missed} of {count}",
                    "rms [s]": f"{rms:.2f}",
                }
            )
    return markdown(rows)


def figure() -> list[str]:
    """Plot how long before its time each stage starts in the screened settings, over W_r and zeta, with the medians."""
    rows = [row for row in read_rows(25, scored=True) if row["setting"]["pending"] >= 0.8]
    with in_style():
        plot, panels = plt.subplots(2, 2, sharex="col", sharey=True, figsize=(7.2, 5.2), layout="constrained")
        labels = {"move": "$W_r$ of the skill move (1)", "zeta": "ζ (1)"}
        for (key, label), column in zip(labels.items(), panels.T, strict=True):
            values = np.array([row["setting"][key] for row in rows])
            edges = np.quantile(values, np.linspace(0, 1, 11))
            within = [(values >= low) & (values <= high) for low, high in pairwise(edges)]
            for epsilon, axes in zip((0.1, 0.5), column, strict=True):
                index = EPSILONS[25].index(epsilon)
                for color, (name, (controller, stage)) in zip(PALETTE, CURVES.items(), strict=False):
                    runs = [row[controller] for row in rows]
                    lead = np.array([run["ends"][stage] - run["starts"][stage][index] for run in runs])
                    axes.plot(values, lead, ".", color=color, alpha=0.25, markersize=2.5)
                    medians = [(np.median(values[which]), np.median(lead[which])) for which in within]
                    axes.plot(*np.transpose(medians), color=color, label=name)
                axes.set_xscale("log")
                axes.set_title(f"closeness, ε = {epsilon:g}", loc="left")
            column[-1].set_xlabel(label)
        for axes in panels[:, 0]:
            axes.set_ylabel("Starts before its time by (s)")
        plot.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    plot.savefig(ROOT / "docs" / "figures" / "early_starts.png", dpi=130)
    return []


if __name__ == "__main__":
    command_line(screen, refine, table, held, figure)
