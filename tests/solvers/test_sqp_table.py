from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.solvers.sqp_table import HEADING, IterationTable

from psmpc_cli.control import Command
from psmpc_cli.ocp.window import Bounds
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Outcome, Solution, build_solver
from psmpc_cli.solvers.sqp import SqpSolver

from .test_sqp import CONVERGED, ONE, Recorded, chosen


@pytest.fixture(scope="module")
def two_stages(model: RobotModel, decisions: list[Command]) -> Recorded:
    return Recorded(model, chosen(decisions, 2))


def watched(recorded: Recorded, guess: Guess, limits: Bounds) -> tuple[Solution, list[list[str]]]:
    """Return the solution and the rows of the table below its heading."""
    solver, table = build_solver(recorded.nlp, CONVERGED), IterationTable()
    assert isinstance(solver, SqpSolver)
    solution = solver.watched(table.take).solve(guess, recorded.parameters, limits)
    assert table.lines[0] == HEADING
    return solution, [line.split(maxsplit=6) for line in table.lines[1:]]


def test_a_row_an_iteration_leads_from_the_guess_to_the_solution(two_stages: Recorded) -> None:
    solution, rows = watched(two_stages, two_stages.guess, two_stages.bounds)
    assert [int(row[0]) for row in rows] == list(range(solution.iterations + 1))
    assert rows[0][3:] == ["-", "-", "-"]
    assert float(rows[-1][1]) == pytest.approx(solution.objective, rel=1e-8)
    assert float(rows[-1][3]) <= np.sqrt(CONVERGED.tolerance)
    for row in rows[1:]:
        assert 0 < float(row[4]) <= 1
        assert int(row[5]) > 0


def test_watching_changes_nothing(two_stages: Recorded) -> None:
    watched_solution, _ = watched(two_stages, two_stages.guess, two_stages.bounds)
    np.testing.assert_array_equal(watched_solution.z, two_stages.solve(CONVERGED).z)


def test_a_program_without_a_solution_is_named(two_stages: Recorded) -> None:
    held, rows = two_stages.bounds, two_stages.nlp.end_rows[0]
    lbg, ubg = held.lbg.copy(), held.ubg.copy()
    lbg[rows], ubg[rows] = 10.0, 10.1
    solution, lines = watched(two_stages, Guess(two_stages.guess.z), replace(held, lbg=lbg, ubg=ubg))
    assert solution.outcome is Outcome.INFEASIBLE
    assert len(lines) == solution.iterations + 1
    assert lines[-1][3:5] == ["-", "-"]
    assert lines[-1][6] == "no step meets the linearized constraints"


def test_a_solver_that_nobody_watches_keeps_no_table(two_stages: Recorded) -> None:
    solver = build_solver(two_stages.nlp, ONE)
    assert isinstance(solver, SqpSolver)
    table = IterationTable()
    solver.watched(table.take)
    solver.solve(two_stages.guess, two_stages.parameters, two_stages.bounds)
    assert table.lines == [HEADING]
