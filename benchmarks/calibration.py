"""Looks for what the paper leaves open: W_r, zeta, tolerances, the cost of waiting, and epsilon of the actual starts.

    python benchmarks/calibration.py screen [COUNT] [PART/PARTS]    random settings at N_s = 25, drawn by seed
    python benchmarks/calibration.py refine [COUNT] [PART/PARTS]    perturbations of the best ones at N_s = 100
    python benchmarks/calibration.py show                           the best settings of both

Each setting adds a line to benchmarks/calibration.jsonl, and a setting that has its line is not repeated. PSMPC runs
first, SMPC where PSMPC is near what is published. A setting is scored by how many claims of the paper it meets with the
best epsilon, then by the root mean square of the differences of the times. HTMPC has a setting of its own.
"""

import json
import logging
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

RESULTS = Path(__file__).with_suffix(".jsonl")
STAGES = ("approach", "capture", "transport", "release")
PSMPC, SMPC = (10.3, 13.8, 24.4, 31.3), (10.3, 15.1)
"""Published instants that end the stages [s]."""

STARTS = {"psmpc": 6.3, "smpc": 8.8}
"""Published actual starts of Capture [s]."""

EPSILONS = {
    25: (0.02, 0.05, 0.1, 0.25, 0.5, 0.75),
    100: (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75),
}
"""Thresholds of `onset: closeness`, by N_s."""

HORIZON, SAMPLE = 4.0, 0.1
PARENTS, SPREAD = 12, 0.12
"""How many settings are perturbed, and the standard deviation of the logarithms of what is perturbed."""

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
    zeta = within(1e-3, 0.1)
    pending = 1.0 if random.random() < 0.6 else within(0.1, 10)
    return {"move": move, "reach": reach, "zeta": zeta, "pending": pending, "tolerance": [base, capture, base, release]}


def perturbed(setting: Row, seed: int) -> Row:
    """Return a setting with every number changed at random, equal ones alike, and another tolerance of Approach.

    That tolerance moves its end within the sample, on which depends how much of Capture the first window that sees it
    has.
    """
    random = np.random.default_rng(seed)
    values = sorted({setting["move"], setting["reach"], setting["zeta"], setting["pending"], *setting["tolerance"]})
    new = {value: value * np.exp(SPREAD * random.normal()) for value in values}
    tolerances = [new[value] for value in setting["tolerance"]]
    tolerances[0] = np.exp(random.uniform(np.log(1e-3), np.log(2e-2)))
    named = {key: rounded(new[value]) for key, value in setting.items() if key != "tolerance"}
    return {**named, "tolerance": [rounded(value) for value in tolerances]}


def rounded(value: float) -> float:
    """Return a number with three digits."""
    return float(f"{value:.3g}")


def run(setting: Row, controller: str, nodes: int) -> Row:
    """Run the transport task with a setting and return its times [s] and how it ended."""
    task = load_task(
        "transport",
        {
            "controller.kind": controller,
            "controller.nodes": nodes,
            "controller.zeta": setting["zeta"],
            "controller.pending_cost": setting["pending"],
            "skills.move.weights.control": setting["move"],
            "skills.reach.weights.control": setting["reach"],
            **{f"stages.{s}.ends_when.tolerance": t for s, t in zip(STAGES, setting["tolerance"], strict=True)},
            "onset": {"kind": "closeness", "epsilon": 0.5, "series": list(EPSILONS[nodes])},
            "log.plans": False,
            "log.shares": False,
        },
    )
    done = simulate(task)
    summary, starts = done.summary(), np.asarray(done.stages["actual_start_by_epsilon"])
    broken = [float(each.broken_at) for each in summary.monitors if not each.held]
    return {
        "ends": [round(float(stage.switch_time), 4) for stage in summary.stages],
        "starts": [[round(float(start), 4) for start in row[: len(EPSILONS[nodes])]] for row in starts[1:]],
        "succeeded": summary.succeeded,
        "broken_at": min(broken, default=None),
    }


def near(psmpc: Row) -> bool:
    """Tell whether PSMPC succeeds with all instants within 1.5 tolerances of the published ones."""
    apart = [abs(end - time) / tolerance(time) for end, time in zip(psmpc["ends"], PSMPC, strict=True)]
    return bool(psmpc["succeeded"]) and max(apart) <= 1.5


def tolerance(time: float) -> float:
    """Return by how much a time may differ from a published one [s]."""
    return max(0.8, 0.05 * time)


def missed(row: Row, index: int) -> tuple[list[str], float]:
    """Return the claims that a setting does not meet with the threshold at an index, and the rms difference [s]."""
    psmpc, smpc = row["psmpc"], row["smpc"]
    (p1, p2, p3, _), (s1, s2, s3, _) = psmpc["ends"], smpc["ends"]
    (pc, pt, pr), (sc, st, sr) = ([of[index] for of in each["starts"]] for each in (psmpc, smpc))
    times = {
        **{f"psmpc {stage}": pair for stage, *pair in zip(STAGES[1:], psmpc["ends"][1:], PSMPC[1:], strict=True)},
        **{f"smpc {stage}": pair for stage, *pair in zip(STAGES[:2], smpc["ends"], SMPC, strict=False)},
        "psmpc start": [pc, STARTS["psmpc"]],
        "smpc start": [sc, STARTS["smpc"]],
    }
    one = SAMPLE + 1e-9
    claims = {
        **{name: abs(found - time) <= tolerance(time) + 1e-9 for name, (found, time) in times.items()},
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
    differences = [found - time for found, time in times.values()] + [p1 - PSMPC[0]]
    return [name for name, met in claims.items() if not met], float(np.sqrt(np.mean(np.square(differences))))


def best(rows: list[Row], nodes: int) -> list[tuple[int, float, float, list[str], Row]]:
    """Return misses, rms [s], epsilon, missed claims and row, by setting with its best epsilon, best first."""
    found = []
    for row in rows:
        if row["nodes"] == nodes and "smpc" in row:
            scores = [(*missed(row, index), epsilon) for index, epsilon in enumerate(EPSILONS[nodes])]
            names, rms, epsilon = min(scores, key=lambda score: (len(score[0]), score[1]))
            found.append((len(names), rms, epsilon, names, row))
    return sorted(found, key=lambda each: each[:3])


def between(row: Row) -> int:
    """Return how many thresholds lie between those that meet the claims on the starts of Capture and of Release."""
    names = [missed(row, index)[0] for index in range(len(EPSILONS[row["nodes"]]))]
    low = [index for index, each in enumerate(names) if "once seen" not in each]
    high = [index for index, each in enumerate(names) if "release on time" not in each]
    return min((abs(a - b) for a, b in product(low, high)), default=len(names))


def main(command: str, count: str = "1200", part: str = "0/1") -> None:
    """Run what is missing of a screen or a refinement, or show the best settings."""
    logging.disable(logging.CRITICAL)
    lines = RESULTS.read_text(encoding="utf-8").splitlines() if RESULTS.exists() else []
    rows = [json.loads(line) for line in lines]
    if command == "show":
        for nodes in EPSILONS:
            for _, rms, epsilon, names, row in best(rows, nodes)[: int(count)]:
                print(f"N_s = {nodes}: misses {names}, rms {rms:.3f} s, epsilon {epsilon}, {row['setting']}")
        return
    nodes = 25 if command == "screen" else 100
    parents = [row for _, _, _, _, row in sorted(best(rows, 25), key=lambda each: (each[0], between(each[4]), each[1]))]
    have = {row["seed"] for row in rows if row["nodes"] == nodes}
    for seed in range(*map(int, part.split("/")[:1]), int(count), int(part.split("/")[1])):
        if seed in have:
            continue
        setting = draw(seed) if nodes == 25 else perturbed(parents[seed % PARENTS]["setting"], seed)
        psmpc = run(setting, "psmpc", nodes)
        row = {"nodes": nodes, "seed": seed, "setting": setting}
        if near(psmpc):
            row |= {"psmpc": psmpc, "smpc": run(setting, "smpc", nodes)}
        else:
            row |= {"ends": psmpc["ends"], "succeeded": psmpc["succeeded"]}
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
