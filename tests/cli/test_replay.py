from pathlib import Path

import numpy as np

from psmpc_cli.logs.run import read_run

from ..simulation.logged import there_and_back
from .command import Psmpc


def test_a_replay_shows_iterations_and_what_is_equal(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("replay", "part.h5", "--step", "3")
    assert (ran.code, ran.stderr) == (0, "")
    lines = ran.stdout.splitlines()
    assert lines[0] == "sample 3 of 6, 0.30 s: window of go, back; solver fatrop"
    assert lines[1].split()[:4] == ["iter", "objective", "inf_pr", "inf_du"]
    rows = {line.rpartition("  ")[0].split("  ")[0]: line.split()[-1] for line in lines}
    assert [rows[name] for name in ("objective J", "go ends [s]", "control of base.x")] == ["0.0e+00"] * 3
    count = read_run(part)["solver/iterations"][3]
    assert lines[-1] == f"the log is repeated to 1e-06: optimal after {count} iterations, again optimal after {count}"


def test_our_own_solver_writes_its_table_and_says_what_its_objective_is(psmpc: Psmpc, tmp_path: Path) -> None:
    there_and_back(tmp_path, "solver.kind=sqp", "stages.go.priority=50", samples=4, name="own")
    lines = psmpc("replay", "own.h5", "--step", "3").stdout.splitlines()
    assert lines[1].split() == ["iter", "objective", "inf_pr", "||d||", "alpha", "qp"]
    assert lines[2].split()[0] == "0"
    assert "objective in the lines above: J over the largest priority, 50" in lines


def test_another_solver_is_said_to_be_one(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("replay", "part.h5", "--step", "3", "--solver", "ipopt")
    assert ran.code == 0
    assert "solver ipopt" in ran.stdout.splitlines()[0]
    assert ", by another solver: optimal after " in ran.stdout.splitlines()[-1]


def test_a_problem_is_exported(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("replay", "part.h5", "--step", "5", "--export", "bugs/problem.npz")
    assert ran.stdout.splitlines()[-1] == "problem: bugs/problem.npz"
    with np.load("bugs/problem.npz") as data:
        assert "Sample 5 of a run of task, at 0.5 s: window of go, back." in data["README.txt"].decode()
    again = psmpc("replay", "part.h5", "--step", "5", "--export", "bugs/problem.npz")
    assert (again.code, again.stdout) == (2, "")
    assert again.stderr == "psmpc: bugs/problem.npz exists already: choose another file with --export\n"
