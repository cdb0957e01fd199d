"""Back-ends that come as CasADi NLP solvers: what fatrop and IPOPT share."""

import time
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers.base import Guess, Outcome, Solution


class CasadiSolver:
    """One CasADi `nlpsol` plug-in with its return codes translated."""

    def __init__(self, plugin: str, nlp: Nlp, options: Mapping[str, Any], outcomes: Mapping[object, Outcome]) -> None:
        shared: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "expand": False,
            "show_eval_warnings": False,
        }
        self._solver = ca.nlpsol("window", plugin, nlp.problem, {**shared, **options})
        self._outcomes = outcomes

    def solve(self, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
        """Solve for the parameters p from the guess."""
        start = {"x0": guess.z}
        if guess.lam_x is not None and guess.lam_g is not None:
            start |= {"lam_x0": guess.lam_x, "lam_g0": guess.lam_g}
        began = time.perf_counter()
        result = self._solver(p=p, lbx=bounds.lbx, ubx=bounds.ubx, lbg=bounds.lbg, ubg=bounds.ubg, **start)
        wall_time = time.perf_counter() - began
        stats = self._solver.stats()
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
