"""A bench as tables: what each way takes on each mesh, how times grow, and how machine and reference were."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import typer

from psmpc_cli.cli.summary import print_table

HEADINGS = (
    "nodes",
    "solver",
    "start",
    "median [ms]",
    "p95",
    "p99",
    "times faster",
    "iterations",
    "J off, median",
    "worst",
    "instants off [s]",
    "off finest",
    "violation",
    "failed",
)
"""Columns of the table by mesh and way."""

NOTE = (
    "times faster: than the reference way, CasADi with IPOPT as both come and a cold start\n"
    "off: from a tightly converged optimum on the same mesh, relative in J, instants at worst; off finest: what the "
    "plan costs over time, from the optimum on the finest mesh, median\n"
    "violation: the worst of a constraint [m, rad, m/s, rad/s, s]; failed: windows, whose solves are in no other column"
)


def print_bench(found: Mapping[str, Any]) -> None:
    """Print a bench from its document."""
    print_table(HEADINGS, list(bench_rows(found)), left=3)
    typer.echo(NOTE)
    for key, size in (("growth_with_nodes", "nodes"), ("growth_with_freedom", "n")):
        rows = list(growth_rows(found[key], size))
        if rows:
            typer.echo("")
            print_table(("solver", "start", "stages", *GROWTH[size]), rows, left=2)
    typer.echo(f"\n{len(found['windows'])} windows; {about_machine(found)}")


def about_machine(found: Mapping[str, Any]) -> str:
    """Say what a bench ran on, and whether it had the machine to itself."""
    at, busy = found["machine"], found["wall_over_busy"]
    compiled = f"compiled by {at['compiler']}" if found["compiled"] else "interpreted"
    return f"{at['processor']}, {at['cores']} cores; sqp {compiled}; wall over processor time {_number(busy, 1, '.2f')}"


GROWTH = {
    "nodes": ("exponent in N_s", "200 over 100 nodes"),
    "n": ("exponent in degrees of freedom", "failed"),
}
"""Columns of the tables of growth."""


def bench_rows(found: Mapping[str, Any], stages: int | None = None) -> Iterator[Sequence[str]]:
    """Give a row a mesh and way, over all windows or those with so many stages."""
    for row in found["summary"]:
        if row["stages"] == stages:
            way = row["way"]
            yield (
                row["nodes"],
                way["solver"],
                way["start"],
                *(_number(row["time"][name], 1e3, ".2f") for name in ("median", "p95", "p99")),
                _number(row["speedup"], 1, ".1f"),
                _number(row["iterations"]["median"], 1, ".0f"),
                _number(row["objective_gap"]["median"], 1, ".0e"),
                _number(row["objective_gap"]["largest"], 1, ".0e"),
                _number(row["instant_gap"]["largest"], 1, ".0e"),
                _number(row["to_finest"]["median"], 1, ".0e"),
                _number(row["violation"]["largest"], 1, ".0e"),
                f"{row['failed']} of {row['windows']}",
            )


def growth_rows(growths: Sequence[Mapping[str, Any]], size: str) -> Iterator[Sequence[str]]:
    """Give a row a way and number of stages, of those measured at two sizes at least."""
    for growth in growths:
        if growth["exponent"] is not None:
            last = _number(growth["doubling"], 1, ".2f") if size == "nodes" else str(growth["failed"])
            way = growth["way"]
            yield way["solver"], way["start"], str(growth["stages"]), _number(growth["exponent"], 1, ".2f"), last


def _number(value: float | None, scale: float, form: str) -> str:
    """Write a number in a unit; a dash where there is none."""
    return "-" if value is None else format(scale * value, form)
