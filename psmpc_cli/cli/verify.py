"""`psmpc verify`: what the physics does between the nodes of the plans and along the closed loop."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from psmpc_cli.simulation.verify import Peaks

HEADINGS = ("", "largest", "of", "at [s]", "sample")


def verify(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate.")],
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Integrate every N-th horizon only.")] = 1,
) -> None:
    """Integrate the full dynamics along every plan of a log and along its closed loop, with an adaptive integrator."""
    import time

    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.verify import verify as integrate

    began = time.perf_counter()
    found = integrate(read_run(log), every)
    typer.echo(f"{found.count} horizons, the low-level law acting at every instant")
    if found.count:
        _print(found.horizons)
    if found.samples:
        typer.echo(f"\nclosed loop, {found.samples} samples, each from its logged state, the force held over a tick")
        _print(found.loop)
    for remark in found.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"integrated in {time.perf_counter() - began:.1f} s")


def _print(peaks: "Peaks") -> None:
    from psmpc_cli.cli.summary import print_table
    from psmpc_cli.simulation.verify import QUANTITIES

    rows = []
    for quantity, name in QUANTITIES.items():
        if (peak := peaks.get(quantity)) is None:
            continue
        value = f"{peak.value:.6f}" if quantity == "end condition" else f"{peak.value:.1e}" if peak.value else "0"
        nowhere = peak.value == 0
        rows.append(
            (name, value, "" if nowhere else peak.where, "" if nowhere else f"{peak.time:.3f}", str(peak.sample))
        )
    print_table(HEADINGS, rows, left=1)
