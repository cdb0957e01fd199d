"""One horizon's problem as a file of its own: all that CasADi needs to solve it, for a report of a bug."""

import json
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.window import bounds
from psmpc_cli.simulation.replay import Replay
from psmpc_cli.solvers import build_solver, ipopt
from psmpc_cli.solvers.casadi_nlp import CasadiSolver

FUNCTION, README, SOLVER = "nlp.casadi", "README.txt", "solver.json"
"""Members of the file that are no arrays."""

ABOUT = """\
One nonlinear program of model predictive control, written by psmpc {version} with CasADi {casadi}.

min f(x, p)  subject to  lbx <= x <= ubx,  lbg <= g(x, p) <= ubg

{what}

Everything in this file is data; no part of psmpc is needed to read it:

    import json
    import casadi
    import numpy
    data = numpy.load("{name}")
    nlp = casadi.Function.deserialize(data["{function}"].decode())  # (x, p) -> (f, g)
    solver = json.loads(data["{solver}"])  # plug-in of CasADi, its options
    solve = casadi.nlpsol("solve", solver["plugin"], nlp, solver["options"])
    start = {{name: data[name] for name in ("x0", "lam_x0", "lam_g0") if len(data[name])}}
    limits = {{name: data[name] for name in ("lbx", "ubx", "lbg", "ubg")}}
    result = solve(p=data["p"], **start, **limits)
    J = float(result["f"]) * float(data["largest_priority"])  # f is J over the largest priority
    print("J", J, "in the log", float(data["J_logged"]))
    print("largest difference of x", abs(result["x"].full().ravel() - data["x_logged"]).max())

{solved_by}

x0, lam_x0, lam_g0   where the solve started; no multipliers if they are empty
p                    parameters
lbx, ubx, lbg, ubg   bounds
largest_priority     the largest priority of a stage in the window: f times it is J
x_logged, J_logged   what the run's solver, {kind}, returned; its outcome was: {outcome}
"""

SAME = """\
The run's solver was {kind}, and so is this one: with the build that wrote the log the last number is 0, unless a
deadline stopped the run's."""

OTHER = """\
The run's solver was {kind}, this one is {plugin}. Two solvers stop at different points within their tolerances, so that
the last number is not 0."""

STAND_IN = """\
The run's solver was {kind}, which is psmpc's own and no plug-in of CasADi: {plugin} stands in for it, and a fault
of {kind} itself does not show here. The last number is not 0, for two reasons: {kind} need not have converged, since
from the plan of the sample before it is asked for solver.iterations: {iterations}; and {plugin} stops at its tolerance,
which may leave controls far off that hardly count in J. A smaller one, tol in the options, tells the two apart."""

PLUGINS = ("fatrop", "ipopt")
"""Solvers that CasADi has."""


def write_problem(replay: Replay, log: Log, sample: int, path: Path) -> None:
    """Write the problem of a replayed horizon as an .npz file; nothing is overwritten.

    Raises:
        InputError: The path is taken or cannot be written.
    """
    if path.exists():
        raise InputError(f"{path} exists already: choose another file with --export")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in _texts(replay, log, sample, path.name).items():
                archive.writestr(name, text)
            for name, values in _arrays(replay).items():
                with archive.open(f"{name}.npy", "w") as member:
                    np.lib.format.write_array(member, np.asarray(values), allow_pickle=False)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path} cannot be written: {path.parent} is no directory") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def _texts(replay: Replay, log: Log, sample: int, name: str) -> dict[str, str]:
    logged, problem = replay.logged, replay.logged.nlp.problem
    plugin, options = _plugin(replay)
    function = ca.Function("nlp", [problem["x"], problem["p"]], [problem["f"], problem["g"]], ["x", "p"], ["f", "g"])
    stages = ", ".join(stage.name for stage in logged.window.stages)
    what = (
        f"Sample {sample} of a run of {log.attributes['task_name']}, at {logged.window.start:g} s: window of {stages}."
    )
    about = ABOUT.format(
        version=__version__,
        casadi=version("casadi"),
        what="\n".join([what, *(f"Note: {remark}." for remark in replay.remarks)]),
        name=name,
        function=FUNCTION,
        solver=SOLVER,
        solved_by=_solved_by(replay, plugin),
        kind=replay.run_solver,
        outcome=f"{logged.outcome.name.lower()}, {logged.outcome.value}",
    )
    chosen = {"plugin": plugin, "options": options}
    return {README: about, FUNCTION: function.serialize(), SOLVER: json.dumps(chosen, indent=1)}


def _plugin(replay: Replay) -> tuple[str, Mapping[str, Any]]:
    """Return plug-in and options of the solve without a deadline; those of IPOPT where the solver is our own."""
    spec, nlp = replay.experiment.task.solver.model_copy(update={"deadline": None}), replay.logged.nlp
    solver = build_solver(nlp, spec)
    if not isinstance(solver, CasadiSolver):
        solver = ipopt.build(nlp, spec)
    return solver.options_from(replay.logged.guess)


def _solved_by(replay: Replay, plugin: str) -> str:
    """Say which solver the run had, which one the file has, and what that means for the difference."""
    text = SAME if plugin == replay.run_solver else OTHER if replay.run_solver in PLUGINS else STAND_IN
    iterations = replay.experiment.task.solver.iterations
    return text.format(kind=replay.run_solver, plugin=plugin, iterations=iterations)


def _arrays(replay: Replay) -> dict[str, np.ndarray]:
    logged = replay.logged
    limits, guess, none = bounds(logged.nlp, logged.window), logged.guess, np.zeros(0)
    return {
        "x0": guess.z,
        "lam_x0": none if guess.lam_x is None else guess.lam_x,
        "lam_g0": none if guess.lam_g is None else guess.lam_g,
        "p": logged.parameters,
        "lbx": limits.lbx,
        "ubx": limits.ubx,
        "lbg": limits.lbg,
        "ubg": limits.ubg,
        "x_logged": logged.z,
        "largest_priority": np.array(replay.largest_priority),
        "J_logged": np.array(logged.objective),
    }
