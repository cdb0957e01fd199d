"""Back-ends that come as CasADi NLP solvers: what fatrop and IPOPT share."""

import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers.base import Guess, Outcome, Solution, StructuredNlp


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
        return Solution(
            outcome=self._outcome(stats, z),
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
