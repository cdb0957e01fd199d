"""Shared by the tests of pareto and others."""

from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Quantity, Results

RATIOS = np.geomspace(1e-3, 1e3, 9)


INSTANTS = np.array([6.1, 7.1, 8.0])


def fronts(narrow: bool = False) -> np.ndarray:
    """J_1 and J_2 (instants, ratios, 2); narrow ones fit a linear axis."""
    along = np.linspace(0.2, 1.0, len(RATIOS))
    low = 0.5 if narrow else 0.01
    return np.array(
        [np.column_stack([1.5 * along**2 / (i + 1) + low, i / 3 + (1 - along) ** 2 + low]) for i in range(3)]
    )


def made_up(
    narrow: bool = False, later: int = 0, method: str = "both", ratio: tuple[float, ...] = (100,) * 3
) -> Results:
    """A study of three instants, with the instant held at `later` further times."""
    J = fronts(narrow)
    held = np.repeat(J[:, None], later + 1, axis=1) * (1 + 0.2 * np.arange(later + 1))[:, None, None]
    values = held if later else J
    dims = ("instant", *(("later",) if later else ()))
    marks = np.zeros(values.shape[:-1], "i1")
    marks[0, ..., 2] = 1
    found = [
        Quantity("instant", ("instant",), INSTANTS, "s", ""),
        Quantity("stage", ("stage",), np.array(["approach", "capture"]), "1", ""),
        Quantity("t_s", ("instant",), np.full(3, 10.0), "s", ""),
        Quantity("chosen_ratio", ("instant",), np.array(ratio, float), "1", ""),
        Quantity("chosen_J_1", ("instant",), J[:, 6, 0], "s", ""),
        Quantity("chosen_J_2", ("instant",), J[:, 6, 1], "s", ""),
        Quantity("hypervolume", ("instant",), np.array([1.0, 2.0, 3.0]), "s^2", ""),
    ]
    wait = np.broadcast_to((10.0 - INSTANTS)[:, None, None] + 0.3 * np.arange(later + 1)[:, None], held.shape[:-1])
    for name in ("weighted", "constrained"):
        if method in (name, "both"):
            along = (*dims, "ratio" if name == "weighted" else "bound")
            found += [Quantity(f"{name}_J_{s + 1}", along, values[..., s], "s", "") for s in range(2)]
            found += [Quantity(f"{name}_dominated", along, marks, "1", "")]
            found += [Quantity(f"{name}_wait", along, wait, "s", "")] if later else []
    if later:
        found += [Quantity("later", ("later",), np.linspace(0.0, 0.8, later + 1), "1", "")]
        found += [Quantity(f"free_J_{s + 1}", ("instant", "ratio"), J[..., s], "s", "") for s in range(2)]
        found += [Quantity("free_wait", ("instant", "ratio"), wait[:, 0], "s", "")]
    return Results(Path("made_up.h5"), {}, {quantity.name: quantity for quantity in found})


def unsolved(results: Results, point: int | slice) -> Results:
    """The study without those points that could be solved for by no method."""
    for name in results.quantities:
        if name.endswith(("_J_1", "_J_2")) and not name.startswith("chosen"):
            results[name][..., point] = np.nan
    return results
