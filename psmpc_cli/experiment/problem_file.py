"""One horizon's problem as a file of its own: all that CasADi needs to solve it, for a report of a bug."""

import json
import zipfile
from importlib.metadata import version
from pathlib import Path

import casadi as ca
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.experiment.replay import Replay
from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.window import bounds
from psmpc_cli.solvers import build_solver
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
    solver = json.loads(data["{solver}"])  # plug-in and options of the run
    solve = casadi.nlpsol("solve", solver["plugin"], nlp, solver["options"])
    start = {{name: data[name] for name in ("x0", "lam_x0", "lam_g0") if len(data[name])}}
    limits = {{name: data[name] for name in ("lbx", "ubx", "lbg", "ubg")}}
    result = solve(p=data["p"], **start, **limits)
    print(float(result["f"]), abs(result["x"].full().ravel() - data["x_logged"]).max())

x0, lam_x0, lam_g0   where the solve started; no multipliers if they are empty
p                    parameters
lbx, ubx, lbg, ubg   bounds
x_logged, f_logged   what the run's solver returned; its outcome was: {outcome}
"""


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
        outcome=f"{logged.outcome.name.lower()}, {logged.outcome.value}",
    )
    return {README: about, FUNCTION: function.serialize(), SOLVER: json.dumps(_solver(replay), indent=1)}


def _solver(replay: Replay) -> dict[str, object]:
    """Return plug-in and options of the solve; IPOPT's own defaults where the solver is no plug-in of CasADi."""
    solver = build_solver(replay.logged.nlp, replay.experiment.task.solver)
    plugin, options = solver.options_from(replay.logged.guess) if isinstance(solver, CasadiSolver) else ("ipopt", {})
    return {"plugin": plugin, "options": options}


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
        "f_logged": np.array(logged.objective / float(np.max(logged.window.omega))),
    }
