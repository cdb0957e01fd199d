"""Solves the exported windows with acados: real-time iterations on HPIPM, durations as states without dynamics.

python acados_peer.py DIRECTORY          reads `windows`, writes `acados`

This version of acados has one model for all stages of the horizon. So a parameter of every interval, 1 for one stage
and 0 for the others, chooses cost and duration. An end condition on single coordinates bounds them at the switch; its
other rows are at every node, with bounds that count at the switch alone.
"""

import ctypes
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import acados
import casadi as ca
import numpy as np

os.environ["ACADOS_SOURCE_DIR"] = acados.DIR
os.environ["ACADOS_PYTHON_INTERFACE_PATH"] = acados.TEMPLATE_DIR
os.environ["TERA_PATH"] = acados.TERA_PATH
for library in ("blasfeo", "hpipm", "qpOASES_e", "acados"):  # so that what is generated finds them
    ctypes.CDLL(f"{acados.LIB_DIR}/lib{library}.so", ctypes.RTLD_GLOBAL)

from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver  # noqa: E402
from window import Solve, Start, Window, write_results  # noqa: E402

TOLERANCE = 1e-8
"""Of the quadratic programs."""

CONVERGED = 1e-6
"""Largest change of a state in the last iteration of a window that is iterated to convergence.

HPIPM's mode without multipliers of the equations leaves no residual of the stationarity to be tested.
"""

ITERATIONS = 50
"""Most iterations of such a window."""

FAR = 1e3
"""In place of infinity in bounds that are finite at a switch alone."""

NUMBER = count()
"""Makes the names of generated code differ."""


@dataclass(frozen=True)
class EndRow:
    """A row of an end condition: an expression of Q that is within its tolerance at a node."""

    node: int
    expression: ca.SX
    tolerance: float

    def coordinate(self, Q: ca.SX) -> int | None:
        """Return the coordinate from which the row differs by a constant alone, if there is one."""
        slope = ca.jacobian(self.expression, Q).T
        return slope.sparsity().row()[0] if slope.nnz() == 1 and slope.is_constant() else None

    def bounds(self, Q: ca.SX) -> tuple[float, float]:
        """Return low and high of that coordinate."""
        constant = float(ca.evalf(ca.substitute(self.expression, Q, np.zeros(Q.numel()))))
        return -constant - self.tolerance, -constant + self.tolerance


class Problem:
    """A window at N_s intervals a stage."""

    def __init__(self, window: Window, nodes: int) -> None:
        self.window, self.nodes = window, nodes
        self.free = len(window.stages) - 1
        self.K = nodes * len(window.stages)
        self.forced = np.flatnonzero(np.isfinite(window.stages[0].low))
        ocp = AcadosOcp()
        ocp.model = self._model()
        rows = list(self._end_rows())
        self.bounded = [row for row in rows if row.coordinate(self.Q) is not None]
        self.curved = [row for row in rows if row.coordinate(self.Q) is None]
        limited = np.isfinite(window.meshes[nodes].low).any(axis=0)
        limited[[row.coordinate(self.Q) for row in self.bounded]] = True
        self.limited = np.flatnonzero(limited)
        ocp.parameter_values = np.zeros(len(window.stages))
        ocp.dims.N = self.K
        self._set_cost(ocp)
        self._set_constraints(ocp)
        self._set_options(ocp)
        self.solver = self._built(ocp)
        self._set_numbers()

    def _model(self) -> AcadosModel:
        window = self.window
        model = AcadosModel()
        model.name = f"window_{os.getpid()}_{next(NUMBER)}"
        self.Q, self.Qdot = ca.SX.sym("Q", window.n), ca.SX.sym("Qdot", window.n)
        self.u, self.tau = ca.SX.sym("u", window.n), ca.SX.sym("tau", self.free)
        self.chosen = ca.SX.sym("chosen", len(window.stages))
        durations = ca.vertcat(self.tau, window.horizon - ca.sum1(self.tau))
        self.step = ca.dot(self.chosen, durations) / self.nodes
        model.x = ca.vertcat(self.Q, self.Qdot, self.tau)
        model.u = self.u
        model.p = self.chosen
        Q = self.Q + self.step * self.Qdot + self.step**2 / 2 * self.u
        model.disc_dyn_expr = ca.vertcat(Q, self.Qdot + self.step * self.u, self.tau)
        return model

    def _end_rows(self) -> Iterator[EndRow]:
        for s, stage in enumerate(self.window.stages):
            error = self.window.error(stage, self.Q)
            for row, tolerance in zip(stage.end_rows, stage.tolerance, strict=True):
                yield EndRow((s + 1) * self.nodes, error[row], tolerance)

    def _set_cost(self, ocp: AcadosOcp) -> None:
        """Set J as |y|^2 / 2 summed over the intervals, y that of the stage that is chosen.

        The pending cost, linear in the durations, is the square of a residual about a far point but for a constant.
        """
        window = self.window
        rows = max(len(stage.weights) for stage in window.stages)
        residuals, controls = ca.SX(rows, 1), ca.SX(window.n, 1)
        for stage, chosen in zip(window.stages, ca.vertsplit(self.chosen), strict=True):
            scale = np.sqrt(2 * stage.omega / stage.scale)
            error = scale * np.sqrt(stage.weights) * window.error(stage, self.Q)
            residuals += chosen * ca.vertcat(error, ca.SX(rows - len(stage.weights), 1))
            controls += chosen * scale * np.sqrt(stage.control_weights)
        waiting = window.pending_cost / self.K * np.arange(self.free, 0, -1)  # every later stage waits for a duration
        y = ca.vertcat(ca.sqrt(self.step) * ca.vertcat(residuals, controls * self.u), np.sqrt(waiting / FAR) * self.tau)
        far = np.append(np.zeros(rows + window.n), -np.sqrt(waiting * FAR))
        ocp.cost.cost_type = ocp.cost.cost_type_0 = "NONLINEAR_LS"
        ocp.model.cost_y_expr = ocp.model.cost_y_expr_0 = y
        ocp.cost.W = ocp.cost.W_0 = np.eye(y.numel())
        ocp.cost.yref = ocp.cost.yref_0 = far

    def _set_constraints(self, ocp: AcadosOcp) -> None:
        """Set which rows there are; `_set_numbers` says their bounds node by node."""
        window, constraints = self.window, ocp.constraints
        durations = np.arange(2 * window.n, 2 * window.n + self.free)
        constraints.idxbx_0 = np.arange(2 * window.n + self.free)
        constraints.idxbxe_0 = np.arange(2 * window.n)
        constraints.lbx_0 = np.append(window.x0, np.zeros(self.free))
        constraints.ubx_0 = np.append(window.x0, np.full(self.free, window.horizon))
        constraints.idxbx = constraints.idxbx_e = np.append(self.limited, durations)
        constraints.lbx = constraints.lbx_e = np.full(len(constraints.idxbx), -FAR)
        constraints.ubx = constraints.ubx_e = np.full(len(constraints.idxbx), FAR)
        if len(self.forced):
            constraints.idxbu = self.forced
            constraints.lbu, constraints.ubu = window.stages[0].low[self.forced], window.stages[0].high[self.forced]
        if self.curved:
            ocp.model.con_h_expr = ca.vertcat(*(row.expression for row in self.curved))
            constraints.lh = np.full(len(self.curved), -FAR)
            constraints.uh = np.full(len(self.curved), FAR)

    def _set_options(self, ocp: AcadosOcp) -> None:
        options = ocp.solver_options
        options.tf = float(self.K)
        options.integrator_type = "DISCRETE"
        options.nlp_solver_type = "SQP_RTI"
        options.hessian_approx = "GAUSS_NEWTON"
        options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
        options.hpipm_mode = "SPEED_ABS"
        options.qp_solver_cond_N = self.K  # nothing is condensed
        options.qp_solver_iter_max = 100
        options.qp_solver_tol_stat = options.qp_solver_tol_eq = TOLERANCE
        options.qp_solver_tol_ineq = options.qp_solver_tol_comp = TOLERANCE

    def _built(self, ocp: AcadosOcp) -> AcadosOcpSolver:
        """Generate and compile the solver, in a directory that can go once it is loaded."""
        with tempfile.TemporaryDirectory() as folder:
            ocp.code_export_directory = f"{folder}/code"
            ocp.acados_include_path = acados.INCLUDE_DIR
            ocp.acados_lib_path = acados.LIB_DIR
            return AcadosOcpSolver(ocp, json_file=str(Path(folder) / "ocp.json"), verbose=False)

    def _set_numbers(self) -> None:
        """Set the limits at each node, and the end conditions at the switches."""
        window = self.window
        mesh = window.meshes[self.nodes]
        shortest = [stage.shortest for stage in window.stages]
        longest = window.horizon - (sum(shortest) - np.array(shortest[:-1]))
        low, high = mesh.low.copy(), mesh.high.copy()
        low[0] = high[0] = window.x0
        for row in self.bounded:
            at = row.node, row.coordinate(self.Q)
            row_low, row_high = row.bounds(self.Q)
            low[at], high[at] = max(low[at], row_low), min(high[at], row_high)
        for k in range(self.K + 1):
            rows = slice(None) if k == 0 else self.limited
            self.solver.constraints_set(k, "lbx", np.append(np.maximum(low[k, rows], -FAR), shortest[:-1]))
            self.solver.constraints_set(k, "ubx", np.append(np.minimum(high[k, rows], FAR), longest))
        for node in {row.node for row in self.curved}:
            bound = np.array([row.tolerance if row.node == node else FAR for row in self.curved])
            self.solver.constraints_set(node, "lh", -bound)
            self.solver.constraints_set(node, "uh", bound)

    def solve(self, start: Start) -> dict[str, Any]:
        """Solve from a start and return what came out: one iteration from a warm start, else until convergence."""
        self.solver.reset()
        for k in range(self.K + 1):
            self.solver.set(k, "p", np.eye(len(self.window.stages))[min(k // self.nodes, self.free)])
            self.solver.set(k, "x", np.append(start.X[k], start.durations))
        for k in range(self.K):
            self.solver.set(k, "u", start.u[k])
        times = list[float]()
        states = start.X
        for _ in range(1 if start.is_warm else ITERATIONS):
            began = time.process_time()
            status = self.solver.solve()
            times.append(time.process_time() - began)
            before, states = states, np.array([self.solver.get(k, "x")[: 2 * self.window.n] for k in range(self.K + 1)])
            if status or np.abs(states - before).max() <= CONVERGED:
                break
        if status:
            return {
                "status": str(status),
                "objective": None,
                "instants": [],
                "iterations": len(times),
                "time": sum(times),
            }
        u = np.array([self.solver.get(k, "u") for k in range(self.K)])
        durations = self.window.durations(self.solver.get(0, "x")[2 * self.window.n :])
        return {
            "status": str(status),
            "objective": self.window.objective(states, u, durations),
            "instants": np.cumsum(durations)[:-1].tolist(),
            "iterations": len(times),
            "time": sum(times),
        }


def build(window: Window, nodes: int) -> Solve:
    """Return what solves a window from a start."""
    return Problem(window, nodes).solve


if __name__ == "__main__":
    write_results("acados", {"acados": build})
