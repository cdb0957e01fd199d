"""Writes the tables of docs/performance.md from a bench.

    psmpc bench --growth --json benchmarks/bench.json --force       on a quiet machine
    python benchmarks/performance_table.py

Each table stands between two comments with its name; everything else on the page is left as it is.
"""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from psmpc_cli.cli.bench_table import GROWTH, HEADINGS, about_machine, bench_rows, growth_rows

SOURCE = Path(__file__).with_name("bench.json")
PAGE = Path(__file__).parents[1] / "docs" / "performance.md"

QUIET = 1.1
"""Wall over processor time up to which times mean something."""

Found = dict[str, Any]


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def machine(found: Found) -> str:
    """Say what the bench ran on."""
    versions = ", ".join(f"{name} {version}" for name, version in found["machine"]["versions"].items())
    text = f"{about_machine(found)}; {found['machine']['system']}; {versions}; {found['created']}."
    busy = " **The machine was busy: times are too long, and do not compare from mesh to mesh.**"
    return text + (busy if found["wall_over_busy"] > QUIET else "")


def meshes(found: Found) -> str:
    """Return the table over all windows, a row a mesh and way."""
    return table(HEADINGS, bench_rows(found))


def stages(found: Found) -> str:
    """Return medians by number of stages, a row a mesh and way."""
    counts = sorted({row["stages"] for row in found["summary"] if row["stages"]})
    cells = {(r["nodes"], *r["way"].values(), r["stages"]): r["time"]["median"] for r in found["summary"]}
    rows = []
    for nodes, solver, start in dict.fromkeys(key[:3] for key in cells):
        medians = (cells[nodes, solver, start, count] for count in counts)
        rows.append((nodes, solver, start, *("-" if m is None else f"{1e3 * m:.2f}" for m in medians)))
    return table(("nodes", "solver", "start", *(f"{count} stage{'s' * (count > 1)} [ms]" for count in counts)), rows)


def growth(key: str, size: str) -> Callable[[Found], str]:
    """Return what writes a table of growth."""

    def write(found: Found) -> str:
        rows = list(growth_rows(found[key], size))
        return table(("solver", "start", "stages", *GROWTH[size]), rows) if rows else "Not measured in this bench."

    return write


def automatic(found: Found) -> str:
    """Return what the automatic mesh gave each window, and what its plan costs over that of the finest."""
    solves = {(s["window"], s["solver"], s["start"]): s for s in found["solves"] if s["nodes"] == "auto"}
    counts = {problem["window"]: problem["counts"] for problem in found["problems"] if problem["nodes"] == "auto"}
    rows = []
    for window in found["windows"]:
        solved = solves[window["window"], "sqp", "warm"]
        gap, late = solved["cost_over_time_to_finest"], solved["instant_gap_to_finest"]
        rows.append(
            (
                f"{window['controller']}, {window['time']:.1f} s, {window['phase']} an append",
                " + ".join(map(str, counts[window["window"]])),
                "-" if gap is None else f"{gap:.0e}",
                "-" if late is None or not counts[window["window"]][1:] else f"{late:.0e}",
            )
        )
    return table(("window", "nodes", "cost over time off", "instants off [s]"), rows)


TABLES: dict[str, Callable[[Found], str]] = {
    "machine": machine,
    "meshes": meshes,
    "stages": stages,
    "growth with nodes": growth("growth_with_nodes", "nodes"),
    "growth with freedom": growth("growth_with_freedom", "n"),
    "automatic mesh": automatic,
}


def main() -> None:
    """Write the page anew."""
    found, page = json.loads(SOURCE.read_text(encoding="utf-8")), PAGE.read_text(encoding="utf-8")
    for name, write in TABLES.items():
        between = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        match = between.search(page)
        if match is None:
            raise SystemExit(f"{PAGE}: found no table '{name}'")
        page = page[: match.end(1)] + f"{write(found)}\n" + page[match.start(2) :]
    PAGE.write_text(page, encoding="utf-8")
    print(f"written: {PAGE}")


if __name__ == "__main__":
    main()
