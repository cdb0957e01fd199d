"""Short runs of the transport task, with solvers that fail."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from psmpc_cli.control import Controller
from psmpc_cli.logs.schema import Sample
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.measures import Counterfactuals
from psmpc_cli.simulation.recorder import Ending
from psmpc_cli.simulation.run import Experiment, closed_loop
from psmpc_cli.solvers import Outcome, Solution, Solver

QUICK = ("controller.nodes=8", "plant.kind=ideal", "log.plans=false", "log.shares=false")
SHORT = (
    *QUICK,
    "stages.approach.target.base=[-0.3, 0.3, 5 deg]",
    "stages.capture.target={base: [-0.3, 0.3, 5 deg], arm_1: [1.1, 0.5, 20 deg], arm_2: [-1.7, 0.1, -10 deg]}",
    "stages.transport.target={base: [-0.2, 0.2, 0], arm_1: [5 deg, 5 deg, 5 deg], arm_2: [-5 deg, -5 deg, -5 deg]}",
    "stages.release.target={base: [-0.2, 0.2, 0], arm_1: [1.25, 0.4, 10 deg], arm_2: [-1.65, 0.0, -10 deg]}",
    "monitors=[]",
)
"""Four stages in a few seconds."""


def run(experiment: Experiment) -> tuple[list[Sample], Ending]:
    """Run the closed loop to its end."""
    samples, loop = [], closed_loop(experiment)
    while True:
        try:
            samples.append(next(loop))
        except StopIteration as stop:
            return samples, stop.value


class Unreliable(Solver):
    """A solver that does not converge where it is told so."""

    def __init__(self, solver: Solver, fails: Callable[[Window], bool]) -> None:
        self.solver, self.fails = solver, fails

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        solution = self.solver.solve(window, guess, previous, within)
        return replace(solution, outcome=Outcome.ITERATION_LIMIT) if self.fails(window) else solution


def with_failures(experiment: Experiment, fails: Callable[[Window], bool]) -> Experiment:
    """Return the experiment with a solver that fails in some windows."""
    controller = Controller(experiment.problem, Unreliable(experiment.controller.law.solver, fails))
    return replace(experiment, controller=controller, counterfactuals=Counterfactuals(controller))


def states(samples: list[Sample]) -> np.ndarray:
    """Return the states that were decided from (K, 2n)."""
    return np.array([sample.command.state for sample in samples])
