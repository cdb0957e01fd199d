"""Solves the exported windows of one stage with do-mpc, which knows neither several stages nor free durations.

python do_mpc_peer.py DIRECTORY          reads `windows`, writes `do_mpc`
"""

import time
import warnings
from functools import partial
from typing import Any

import casadi as ca

for category in (UserWarning, FutureWarning):  # optional packages that it misses, and its use of an older CasADi
    warnings.filterwarnings("ignore", category=category)

import do_mpc  # noqa: E402
from window import Solve, Start, Window, write_results  # noqa: E402


def controller(window: Window, nodes: int) -> do_mpc.controller.MPC:
    """Return do-mpc's controller for a window: exact double integrator, costs at the left of each step."""
    model, n, step = do_mpc.model.Model("discrete", "SX"), window.n, window.horizon / nodes
    Q, Qdot = model.set_variable("_x", "Q", (n, 1)), model.set_variable("_x", "Qdot", (n, 1))
    u = model.set_variable("_u", "u", (n, 1))
    model.set_rhs("Q", Q + step * Qdot + step**2 / 2 * u)
    model.set_rhs("Qdot", Qdot + step * u)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step = nodes, step
    mpc.settings.store_lagr_multiplier = False
    mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    (stage,) = window.stages
    mpc.set_objective(mterm=ca.SX(0), lterm=step * window.cost(stage, Q, u))
    mpc.set_rterm(u=0.0)
    mpc.bounds["lower", "_u", "u"] = stage.low
    mpc.bounds["upper", "_u", "u"] = stage.high
    mpc.setup()
    mesh = window.meshes[nodes]
    for k in range(1, nodes + 1):
        mpc.lb_opt_x["_x", k, 0, 0] = mesh.low[k]
        mpc.ub_opt_x["_x", k, 0, 0] = mesh.high[k]
    return mpc


def solve(mpc: do_mpc.controller.MPC, window: Window, start: Start) -> dict[str, Any]:
    """Solve from a start and return what came out."""
    for k, x in enumerate(start.X):
        mpc.opt_x_num["_x", k, 0, 0] = x
    for k, u in enumerate(start.u):
        mpc.opt_x_num["_u", k, 0] = u
    mpc.flags["set_initial_guess"] = True
    began = time.process_time()
    mpc.make_step(window.x0[:, None])
    elapsed = time.process_time() - began
    stats, J = mpc.solver_stats, ca.Function("J", [mpc.nlp["x"], mpc.nlp["p"]], [mpc.nlp["f"]])
    return {
        "status": stats["return_status"],
        "objective": float(J(mpc.opt_x_num.cat, mpc.opt_p_num.cat)),
        "instants": [],
        "iterations": stats["iter_count"],
        "time": elapsed,
    }


def build(window: Window, nodes: int) -> Solve:
    """Return what solves a window from a start."""
    return partial(solve, controller(window, nodes), window)


if __name__ == "__main__":
    write_results("do_mpc", {"do-mpc": build}, most_stages=1)
