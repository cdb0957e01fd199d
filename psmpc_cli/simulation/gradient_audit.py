"""Audits the gradient with respect to the switch times on a task's own windows. Paper eqs. (21) to (27)."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.control.window_builder import WindowBuilder
from psmpc_cli.ocp.end import NEVER, StageProgress
from psmpc_cli.ocp.gradient import Rollout
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import in_own_chart
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.ocp.window import Window, durations
from psmpc_cli.simulation.run import Experiment
from psmpc_cli.solvers import build_solver
from psmpc_cli.specs.parts import QUANTITIES
from psmpc_cli.specs.robots.robot import Limits

AD_TOLERANCE = 1e-8
DIFFERENCE_TOLERANCE = 1e-6
"""Largest relative difference of the discrete adjoint from algorithmic differentiation and from central differences."""

SWITCH_AT = 0.4
"""Where the audited switch is in the horizon, as a fraction of it."""

POSITION_SPREAD = 0.3
VELOCITY_SPREAD = 0.05
CONTROL_SPREAD = 0.1
"""Standard deviations of drawn positions [m, rad], velocities [m/s, rad/s] and controls [m/s^2, rad/s^2]."""

GRADIENT_FLOOR = 1e-3
"""Differences are relative to the gradient, or to this [1/s] near a stationary point, where the gradient is tiny."""

LEAST_SHRINKAGE = 1.5
"""Least factor by which the costate formula's gap shrinks when the mesh doubles. An error O(1/N_s) halves; the solver's
tolerance takes some of that."""


@dataclass(frozen=True)
class Audit:
    """The gradient at one switch of the task.

    Attributes:
        switch: Names of the stages before and after.
        gradient: dJ/dt_s by the discrete adjoint, over the window's largest priority [1/s].
        to_differentiation, to_differences: Relative difference from AD and from central differences.
        costate_gaps: Difference of the costate formula from it at an unconstrained optimum, with N_s and 2 N_s.
    """

    switch: tuple[str, str]
    gradient: float
    to_differentiation: float
    to_differences: float
    costate_gaps: tuple[float, float]

    @property
    def holds(self) -> bool:
        """Whether adjoint, AD and differences agree, and the costate formula's gap shrinks with the mesh."""
        coarse, fine = self.costate_gaps
        agree = self.to_differentiation <= AD_TOLERANCE and self.to_differences <= DIFFERENCE_TOLERANCE
        return agree and (coarse < 1e-9 or fine <= coarse / LEAST_SHRINKAGE)


def audit_gradients(experiment: Experiment) -> tuple[Audit, ...]:
    """Audit every switch of the task, at a state drawn by the task's seed near its initial one."""
    return tuple(_audit_switch(experiment, first) for first in range(len(experiment.problem.stages) - 1))


def _audit_switch(experiment: Experiment, stage_before: int) -> Audit:
    """Compare four ways of computing the gradient dJ/dt_s by one switch time, on a window over two stages.

    The discrete adjoint is compared with algorithmic differentiation and with central differences, at random controls.
    With the costate formula it is compared at an optimum, on the task's mesh and on one twice as fine: its gap has to
    shrink.

    Args:
        experiment: The task's experiment.
        stage_before: Index of the stage that ends at the switch.

    Returns:
        The gradient, and by how much each of the other ways differs from the adjoint.
    """
    generator = np.random.default_rng(experiment.problem.spec.seed)
    window, switch_times = _window_over_switch(experiment, stage_before, generator)
    tau = durations(switch_times, window.start, window.horizon)
    model = experiment.problem.model
    rollout = Rollout(model, window, switch_times)
    input_counts = [model.n_inputs(stage.input) for stage in window.stages]
    U = [CONTROL_SPREAD * generator.standard_normal(shape) for shape in zip(window.nodes, input_counts, strict=True)]
    gradient = rollout.by_adjoint(tau, U)
    scale = max(GRADIENT_FLOOR, float(np.abs(gradient).max()))
    N = experiment.problem.spec.controller.uniform_nodes
    return Audit(
        switch=(window.stages[0].name, window.stages[1].name),
        gradient=float(gradient[0]),
        to_differentiation=float(np.abs(gradient - rollout.by_differentiation(tau, U)).max()) / scale,
        to_differences=float(np.abs(gradient - rollout.by_differences(tau, U)).max()) / scale,
        costate_gaps=(_costate_gap(experiment, window, tau, N), _costate_gap(experiment, window, tau, 2 * N)),
    )


def _window_over_switch(
    experiment: Experiment, stage_before: int, generator: np.random.Generator
) -> tuple[Window, np.ndarray]:
    """Build a window over two stages from a random state near the task's initial one, to audit its gradient.

    The switch is at the fraction `SWITCH_AT` of the horizon. The terminal cost is 0, so that only the running costs of
    the two stages count.

    Args:
        experiment: The task's experiment.
        stage_before: Index of the first of the two stages.
        generator: Draws the state.

    Returns:
        The window, and its switch time (1,) [s].
    """
    problem = experiment.problem
    controller = problem.spec.controller
    n = problem.model.n
    Q = experiment.initial_state[:-n]
    v = experiment.initial_state[-n:]
    chart = problem.model.space.chart_at(Q)
    noise = np.r_[POSITION_SPREAD * generator.standard_normal(n), VELOCITY_SPREAD * generator.standard_normal(n)]
    # noise is added in a chart, where an attitude has three coordinates instead of four of a unit quaternion
    Q, v = (rows[0] for rows in chart.from_chart(chart.to_chart(Q[None], v[None]) + noise))
    placed = [in_own_chart(problem.model, stage, Q, v)[0] for stage in problem.stages]
    chart = problem.model.space.chart_at(Q)  # a window is written in the chart about its own first attitude
    x0 = np.asarray(chart.to_chart(Q[None], v[None])[0])
    N = controller.uniform_nodes
    switch_times = np.array([SWITCH_AT * controller.horizon])
    prediction = resting_plan(0.0, controller.horizon, N, x0, chart)
    window = WindowBuilder(problem).build(
        MovingSequence((stage_before, stage_before + 1), switch_times, StageProgress(0.0)),
        placed,
        prediction,
    )
    return replace(window, nodes=(N, N), terminal_cost=0.0), switch_times


def _costate_gap(experiment: Experiment, window: Window, tau: np.ndarray, nodes_per_stage: int) -> float:
    """Compute how far the costate formula (eq. 27) is from the discrete adjoint, at an unconstrained optimum.

    The formula assumes such an optimum: with multipliers of constraints the costate has further terms. So limits,
    constraints and end conditions are removed before the solve.

    Args:
        experiment: The task's experiment, whose solver is used.
        window: Window over two stages.
        tau: Durations of the stages (S + 1,) [s].
        nodes_per_stage: Intervals of the mesh in each stage.

    Returns:
        The largest difference of the two gradients by switch times [1/s].
    """
    unconstrained = tuple(_unconstrained(stage) for stage in window.stages)
    window = replace(window, nodes=(nodes_per_stage,) * len(unconstrained), stages=unconstrained)
    switch_times = window.start + np.cumsum(tau)[:-1]
    guess = replace(
        resting_plan(window.start, window.horizon, nodes_per_stage, window.x0, window.chart), switch_times=switch_times
    )
    solution = build_solver(experiment.problem).solve(window, guess, within=0.0)  # 0 holds the switch times
    plan = solution.plan
    ends = np.cumsum(window.nodes)
    intervals_of_stage = [slice(end - N, end) for end, N in zip(ends, window.nodes, strict=True)]
    costs = experiment.problem.costs
    # the inputs over the intervals of each stage: accelerations, or rates in task space where the stage asks for these
    U = [
        costs.inputs(stage, plan.X[intervals], plan.u[intervals])
        for stage, intervals in zip(unconstrained, intervals_of_stage, strict=True)
    ]
    rollout = Rollout(experiment.problem.model, window, switch_times)
    return float(np.abs(rollout.by_adjoint(tau, U) - rollout.by_costate(tau, U)).max())


def _unconstrained(stage: PlacedStage) -> PlacedStage:
    """Return a stage without limits, constraints, end condition and cost of rates: the costate formula has none."""
    infinite = np.full_like(stage.limits.position_low, np.inf)
    limits = Limits(*(sign * infinite for _ in QUANTITIES for sign in (-1, 1)))  # low and high of each quantity
    return replace(
        stage,
        limits=limits,
        end=NEVER,
        constraints={},
        rate_weights=np.zeros(0),
    )
