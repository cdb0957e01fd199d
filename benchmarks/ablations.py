"""The ablations of docs/formulation.md: the transport task with each departure from the paper taken back.

python benchmarks/ablations.py                 the tables, and docs/figures/ablation_*.png; about half an hour
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
from collections.abc import Iterator, Mapping, Sequence

from pages import ROOT, markdown

import psmpc_cli as psmpc
from psmpc_cli.figures.registry import draw
from psmpc_cli.studies.ablations import CHANGES, DISCRETIZATIONS, run_ablations

FIGURES = ROOT / "docs" / "figures"

VARIANTS = (*CHANGES, *DISCRETIZATIONS)


def pivot(numbers: Mapping[str, float]) -> Iterator[str]:
    """Yield a table with a row for each quantity and a column for each variant, which the names of numbers contain."""
    columns = [variant for variant in VARIANTS if any(f", {variant}" in name for name in numbers)]
    rows: dict[str, dict[str, str]] = {}
    for name, value in numbers.items():
        of = next((variant for variant in sorted(columns, key=len, reverse=True) if f", {variant}" in name), None)
        row = rows.setdefault(name.replace(f", {of}", ""), {})
        row |= dict.fromkeys([of] if of else columns, f"{value:.4g}")
    cells = ((quantity, *(row.get(variant, "-") for variant in columns)) for quantity, row in rows.items())
    return markdown(("", *columns), cells)


def main(nodes: Sequence[str]) -> None:
    """Run the ablations, by default at the task's own mesh, draw their figures and print their tables."""
    task = psmpc.load_task("transport", [f"controller.nodes={count}" for count in nodes])
    for ablation in run_ablations(task, done=lambda name: print(name, file=sys.stderr, flush=True)):
        draw("ablations", ablation.panels, FIGURES, only=[f"ablation_{ablation.name}"], force=True)
        print(f"\nWithout our {ablation.name.replace('_', ' ')}:\n")
        print("\n".join(pivot(ablation.numbers)))


if __name__ == "__main__":
    main(sys.argv[1:])
