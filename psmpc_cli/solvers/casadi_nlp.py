"""Back-ends that come as CasADi NLP solvers: what fatrop and IPOPT share."""

import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers.base import FEASIBLE, Guess, Outcome, Solution, StructuredNlp

PRINT_LEVEL = 5
"""From this level on both plug-ins write a line an iteration."""


class CasadiSolver:
    """One CasADi `nlpsol` plug-in with its return codes translated.

    `warm_options` replace `options` in solves that start from multipliers, where a plug-in takes them.
    """

    def __init__(
        self,
        plugin: str,
        nlp: StructuredNlp,
        options: Mapping[str, Any],
        outcomes: Mapping[object, Outcome],
        warm_options: Mapping[str, Any] | None = None,
    ) -> None:
        self._plugin, self._nlp, self._outcomes = plugin, nlp, outcomes
        self._options, self._warm_options = options, options if warm_options is None else warm_options

    @cached_property
    def _cold(self) -> ca.Function:
        return self._build(self._options)

    @cached_property
    def _warm(self) -> ca.Function:
        return self._cold if self._warm_options is self._options else self._build(self._warm_options)

    def _build(self, options: Mapping[str, Any]) -> ca.Function:
        silent: dict[str, Any] = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
        return ca.nlpsol("window", self._plugin, self._nlp.problem, {**silent, **options})

    def options_from(self, guess: Guess) -> tuple[str, Mapping[str, Any]]:
        """Return the plug-in and its options in a solve that starts from the guess."""
        warm = guess.lam_x is not None and guess.lam_g is not None
        return self._plugin, self._warm_options if warm else self._options

    def printing(self) -> "CasadiSolver":
        """Return the same solver, which writes its table of iterations to standard output."""

        def loud(options: Mapping[str, Any]) -> dict[str, Any]:
            return {**options, self._plugin: {**options[self._plugin], "print_level": PRINT_LEVEL}}

        return CasadiSolver(self._plugin, self._nlp, loud(self._options), self._outcomes, loud(self._warm_options))

    def solve(self, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
        """Solve for the parameters p from the guess."""
        start, solver = {"x0": guess.z}, self._cold
        if guess.lam_x is not None and guess.lam_g is not None:
            start, solver = {**start, "lam_x0": guess.lam_x, "lam_g0": guess.lam_g}, self._warm
        began = time.perf_counter()
        result = solver(p=p, lbx=bounds.lbx, ubx=bounds.ubx, lbg=bounds.lbg, ubg=bounds.ubg, **start)
        wall_time = time.perf_counter() - began
        stats = solver.stats()
        z = np.asarray(result["x"]).ravel()
        outcome = self._outcome(stats, z)
        stepped = outcome is Outcome.DEADLINE and int(stats["iter_count"]) > 0  # else this is the guess
        if stepped and _violation(z, np.asarray(result["g"]).ravel(), bounds) <= FEASIBLE:
            outcome = Outcome.FEASIBLE
        return Solution(
            outcome=outcome,
            z=z,
            lam_x=np.asarray(result["lam_x"]).ravel(),
            lam_g=np.asarray(result["lam_g"]).ravel(),
            objective=float(result["f"]),
            iterations=int(stats["iter_count"]),
            wall_time=wall_time,
        )

    def _outcome(self, stats: Mapping[str, object], z: np.ndarray) -> Outcome:
        if not np.all(np.isfinite(z)):
            return Outcome.FAILED
        if stats["success"]:
            return Outcome.OPTIMAL
        return self._outcomes.get(stats["return_status"], Outcome.FAILED)


def _violation(x: np.ndarray, g: np.ndarray, bounds: Bounds) -> float:
    """Return by how much x and g(x) violate their bounds at worst."""
    past = (bounds.lbx - x, x - bounds.ubx, bounds.lbg - g, g - bounds.ubg)
    return float(max(piece.max(initial=0.0) for piece in past))
