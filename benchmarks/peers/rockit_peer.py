"""Solves the exported windows with rockit: one stage object a stage, free durations, multiple shooting, IPOPT.

python rockit_peer.py DIRECTORY          reads `windows`, writes `rockit`
"""

import time
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from rockit import FreeTime, MultipleShooting, Ocp, Stage
from window import Solve, Start, Window, write_results

QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
VARIANTS = {"rockit": {}, "rockit, expand": {"expand": True}}
"""Its defaults, and the option that its examples use where speed matters: IPOPT sees scalar expressions."""


class Problem:
    """A window at N_s intervals a stage."""

    def __init__(self, options: dict[str, object], window: Window, nodes: int) -> None:
        self.window, self.nodes, self.ocp = window, nodes, Ocp()
        self.stages, self.states, self.controls = [], [], []
        for index in range(len(window.stages)):
            self._add_stage(index)
        last = self.stages[-1]
        self.ocp.subject_to(last.tf == window.horizon)
        self.ocp.solver("ipopt", QUIET | options)
        self.ocp.transcribe()

    def _add_stage(self, index: int) -> None:
        window, spec = self.window, self.window.stages[index]
        share = window.horizon / len(window.stages)
        stage = self.ocp.stage(t0=FreeTime(share * index), T=FreeTime(share))
        Q, Qdot, u = stage.state(window.n), stage.state(window.n), stage.control(window.n)
        stage.set_der(Q, Qdot)
        stage.set_der(Qdot, u)
        stage.method(MultipleShooting(N=self.nodes, M=1, intg="rk"))
        self._limit(index, stage, ca.vertcat(Q, Qdot), u)
        stage.add_objective(stage.T / self.nodes * stage.sum(window.cost(spec, Q, u)))
        self.ocp.subject_to(spec.shortest <= stage.T)
        if index == 0:
            self.ocp.subject_to(stage.t0 == 0)
            self.ocp.subject_to(stage.at_t0(Q) == window.x0[: window.n])
            self.ocp.subject_to(stage.at_t0(Qdot) == window.x0[window.n :])
        else:
            before, (Q_before, Qdot_before) = self.stages[-1], self.states[-1]
            self.ocp.subject_to(stage.t0 == before.tf)
            self.ocp.subject_to(stage.at_t0(Q) == before.at_tf(Q_before))
            self.ocp.subject_to(stage.at_t0(Qdot) == before.at_tf(Qdot_before))
            stage.add_objective(window.pending_cost * stage.t0)
        if spec.end_rows:
            error = window.error(spec, stage.at_tf(Q))[spec.end_rows]
            stage.subject_to((-spec.tolerance <= error) <= spec.tolerance)
        self.stages.append(stage)
        self.states.append((Q, Qdot))
        self.controls.append(u)

    def _limit(self, index: int, stage: Stage, x: ca.MX, u: ca.MX) -> None:
        """Limit states and controls; limits that differ from node to node are parameters."""
        spec, mesh = self.window.stages[index], self.window.meshes[self.nodes]
        at = slice(index * self.nodes, (index + 1) * self.nodes + 1)
        low, high = mesh.low[at], mesh.high[at]
        finite = np.isfinite(low).any(axis=0)
        moves = (np.ptp(low[:, finite], axis=0) > 0).any()
        rows = np.flatnonzero(finite)
        bounds = [each[0, rows] for each in (low, high)]
        if moves:
            bounds = [stage.parameter(len(rows), grid="control+") for _ in bounds]
            for parameter, each in zip(bounds, (low, high), strict=True):
                stage.set_value(parameter, each[:, rows].T)
        stage.subject_to((bounds[0] <= x[rows]) <= bounds[1], include_first=False)
        forced = np.flatnonzero(np.isfinite(spec.low))
        if len(forced):
            stage.subject_to((spec.low[forced] <= u[forced]) <= spec.high[forced], include_last=False)

    def solve(self, start: Start) -> dict[str, Any]:
        """Solve from a start and return what came out."""
        tau = self.window.durations(start.durations)
        begins = np.concatenate([[0.0], np.cumsum(tau)[:-1]])
        for index, (stage, (Q, Qdot), u) in enumerate(zip(self.stages, self.states, self.controls, strict=True)):
            first = index * self.nodes
            X = start.X[first : first + self.nodes + 1]
            stage.set_initial(stage.t0, begins[index])
            stage.set_initial(stage.T, tau[index])
            stage.set_initial(Q, X[:, : self.window.n].T)
            stage.set_initial(Qdot, X[:, self.window.n :].T)
            stage.set_initial(u, start.u[first : first + self.nodes].T)
        began = time.process_time()
        solution = self.ocp.solve()
        elapsed = time.process_time() - began
        return {
            "status": solution.stats["return_status"],
            "objective": sum(float(solution(stage).value(stage.objective)) for stage in self.stages),
            "instants": [float(solution(stage).value(stage.tf)) for stage in self.stages[:-1]],
            "iterations": solution.stats["iter_count"],
            "time": elapsed,
        }


def build(options: dict[str, object], window: Window, nodes: int) -> Solve:
    """Return what solves a window from a start."""
    return Problem(options, window, nodes).solve


if __name__ == "__main__":
    write_results("rockit", {name: partial(build, each) for name, each in VARIANTS.items()})
