"""Solves the exported windows of one stage with do-mpc, which knows neither several stages nor free durations.

python do_mpc_peer.py DIRECTORY          reads windows.json, writes do_mpc.json
"""

import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

for category in (UserWarning, FutureWarning):  # optional packages that it misses, and its use of an older CasADi
    warnings.filterwarnings("ignore", category=category)

import do_mpc  # noqa: E402
from window import Start, Window, read_windows  # noqa: E402


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
    for name, rows in (("Q", slice(0, n)), ("Qdot", slice(n, None))):
        mpc.bounds["lower", "_x", name] = stage.low[rows]
        mpc.bounds["upper", "_x", name] = stage.high[rows]
        mpc.terminal_bounds["lower", name] = stage.low[rows]
        mpc.terminal_bounds["upper", name] = stage.high[rows]
    mpc.setup()
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
    stats = mpc.solver_stats
    return {
        "status": stats["return_status"],
        "objective": objective(mpc),
        "instants": [],
        "iterations": stats["iter_count"],
        "time": elapsed,
    }


def objective(mpc: do_mpc.controller.MPC) -> float:
    """Return J at the last solution."""
    J = ca.Function("J", [mpc.nlp["x"], mpc.nlp["p"]], [mpc.nlp["f"]])
    return float(J(mpc.opt_x_num.cat, mpc.opt_p_num.cat))


def result(window: Window, nodes: int) -> dict[str, Any]:
    """Return what do-mpc makes of a window from each of its starts."""
    began = time.process_time()
    mpc = controller(window, nodes)
    build = time.process_time() - began
    found = {}
    for name, start in window.starts[nodes].items():
        first = solve(mpc, window, start)
        times = [solve(mpc, window, start)["time"] for _ in range(window.repeats)]
        found[name] = first | {"time": float(np.median(times))}
    return {"build": build, **found}


def main(directory: Path) -> None:
    """Solve every window of one stage and write the results."""
    results = []
    for name, window in read_windows(directory / "windows.json").items():
        if len(window.stages) > 1:
            continue
        for nodes in window.starts:
            print(f"do-mpc, {name}, N_s = {nodes}", flush=True)
            results.append({"program": "do-mpc", "window": name, "nodes": nodes, **result(window, nodes)})
    (directory / "do_mpc.json").write_text(json.dumps(results), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
