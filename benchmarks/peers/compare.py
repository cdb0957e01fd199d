"""Solves the same windows with psmpc, rockit and do-mpc and prints one table.

    python benchmarks/peers/compare.py          with .venv-rockit and .venv-do-mpc beside it

`make peers` makes the environments and does this. The exit code is 1 where objectives differ by more than 1e-3 relative
or instants by more than 20 ms from those of fatrop.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import export

HERE = Path(__file__).parent
PEERS = {"rockit": ".venv-rockit", "do_mpc": ".venv-do-mpc"}
REFERENCE = "psmpc, fatrop"
OBJECTIVE, INSTANT = 1e-3, 0.02

Result = Mapping[str, Any]


def results(directory: Path) -> list[Result]:
    """Return what every program makes of every window."""
    export.main(directory)
    for name, environment in PEERS.items():
        subprocess.run([HERE / environment / "bin" / "python", HERE / f"{name}_peer.py", directory], check=True)
    return [row for name in ("psmpc", *PEERS) for row in json.loads((directory / f"{name}.json").read_text())]


def apart(row: Result, reference: Result, start: str) -> tuple[float, float]:
    """Return the relative difference of the objectives and the largest of the instants [s]."""
    found, expected = row[start], reference[start]
    instants = [abs(a - b) for a, b in zip(found["instants"], expected["instants"], strict=True)]
    return abs(found["objective"] / expected["objective"] - 1), max(instants, default=0.0)


def print_table(rows: list[Result]) -> bool:
    """Print the results by window and N_s; return whether all programs agree."""
    agree = True
    print(
        "| window | N_s | program | build [s] | cold [ms] | warm [ms] | warm over sqp | J apart | instants apart [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for window, nodes in dict.fromkeys((row["window"], row["nodes"]) for row in rows):
        here = {row["program"]: row for row in rows if (row["window"], row["nodes"]) == (window, nodes)}
        fastest = here["psmpc, sqp"]["warm"]["time"]
        for program, row in here.items():
            pairs = [apart(row, here[REFERENCE], start) for start in ("cold", "warm")]
            objective, instant = (max(values) for values in zip(*pairs, strict=True))
            agree &= objective <= OBJECTIVE and instant <= INSTANT
            cold, warm = (f"{1e3 * row[start]['time']:.1f} ({row[start]['iterations']})" for start in ("cold", "warm"))
            ratio = row["warm"]["time"] / fastest
            print(
                f"| {window} | {nodes} | {program} | {row['build']:.2f} | {cold} | {warm} | {ratio:.0f} "
                f"| {objective:.0e} | {1e3 * instant:.2f} |"
            )
    return agree


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        found = results(Path(temporary))
    sys.stdout.flush()
    raise SystemExit(0 if print_table(found) else 1)
