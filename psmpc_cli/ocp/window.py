"""A window: the stages inside the current prediction horizon, with every number its NLP needs."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.layout import StageShape, WindowShape, mesh
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.stages import Stage

SHORTEST = 1e-3
"""Shortest duration of a stage in a window [s], eps of (14)."""


@dataclass(frozen=True, eq=False)
class Window:
    """The stages of one prediction horizon [T0, T0 + T_h].

    Attributes:
        stages: The stages, the current one first.
        start: T0 [s].
        elapsed: Time the current stage has run already [s].
        x0: Measured state (2n,).
        omega: Priorities in force, (S + 1,).
        offset, scale: Normalization of each stage's cost, (S + 1,) each. Paper eq. (12).
        horizon, pending_cost, terminal_cost: T_h [s], delta, kappa.
        nodes: N_s, intervals of each stage, (S + 1,).
        discretization: `exact` or `euler`.
        soft: Limits on the states may be violated, at a cost.
        cost_bound: The largest cost integral of the last stage, for epsilon constraints; IPOPT alone takes one.
    """

    stages: tuple[Stage, ...]
    start: float
    elapsed: float
    x0: np.ndarray
    omega: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    horizon: float
    pending_cost: float
    terminal_cost: float
    nodes: tuple[int, ...]
    discretization: str = "exact"
    soft: bool = False
    cost_bound: float = np.inf

    @property
    def numbers(self) -> np.ndarray:
        """What a log needs besides the measured state: elapsed time, then omega, offset and scale, (1 + 3 (S + 1),)."""
        return np.concatenate([[self.elapsed], self.omega, self.offset, self.scale])

    @property
    def K(self) -> int:
        """Number of intervals."""
        return sum(self.nodes)

    def plan_of(self, flat: np.ndarray) -> Plan:
        """Return the plan on this window's mesh from `Plan.flat`.

        Raises:
            ValueError: It does not have the size of such a plan.
        """
        S, n = len(self.stages) - 1, len(self.x0) // 2
        instants, X, u = np.split(flat, [S, S + 2 * n * (self.K + 1)])
        times = self.start + mesh(durations(instants, self.start, self.horizon), self.nodes)
        return Plan(times, X.reshape(self.K + 1, 2 * n), u.reshape(self.K, n), instants)


def window_shape(window: Window) -> WindowShape:
    """Return the shape of a window; the last stage's end condition is not imposed."""
    last = len(window.stages) - 1
    return WindowShape(
        stages=tuple(
            StageShape(
                space=stage.space,
                input=stage.input,
                end_rows=stage.end_rows if i < last else (),
                end_velocity=stage.end_velocity is not None and i < last,
                fixed_end=stage.at is not None and i < last,
                moving=stage.trajectory is not None,
            )
            for i, stage in enumerate(window.stages)
        ),
        nodes=window.nodes,
        discretization=window.discretization,
        soft=window.soft,
        bounded=np.isfinite(window.cost_bound),
    )


def window_numbers(window: Window, instants: np.ndarray) -> Parameters[np.ndarray]:
    """Return the parameters of a window's optimization, its instants guessed at (S,) [s]."""
    return Parameters(
        x0=window.x0,
        horizon=np.array(window.horizon),
        pending=np.array(window.pending_cost),
        terminal=np.array(window.terminal_cost),
        omega=window.omega / float(np.max(window.omega)),
        offset=window.offset,
        scale=window.scale,
        weights=tuple(stage.weights for stage in window.stages),
        control_weights=tuple(stage.control_weights for stage in window.stages),
        targets=tuple(stage.target for stage in window.stages),
        paths=_path_columns(window, instants),
    )


def _path_columns(window: Window, instants: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return what each stage's cost follows, (rows, 2 (N_s + 1)); (rows, 0) where the target stands still."""
    still = [np.zeros((len(stage.target), 0)) for stage in window.stages]
    if all(stage.trajectory is None for stage in window.stages):
        return tuple(still)
    paths = desired_paths(window, instants)
    stages = zip(window.stages, paths, still, strict=True)
    return tuple(none if stage.trajectory is None else path.columns for stage, path, none in stages)


@dataclass(frozen=True, eq=False)
class DesiredPath:
    """What a stage's cost follows at its nodes if the stage lasts tau [s]: `values + tau slopes`, (N_s + 1, rows).

    A node moves along the trajectory as the stage gets longer. Between two of its times the trajectory is straight, and
    so is this; a node that passes one of them is put right by the next solve.
    """

    values: np.ndarray
    slopes: np.ndarray

    @property
    def columns(self) -> np.ndarray:
        """Both as the NLP's parameters have them, (rows, 2 (N_s + 1))."""
        return np.vstack([self.values, self.slopes]).T


def desired_paths(window: Window, instants: np.ndarray) -> tuple[DesiredPath, ...]:
    """Return what each stage's cost follows, about the durations that the guessed instants (S,) [s] give.

    A trajectory's time counts from where its stage begins: for the current stage in the past, for others at an instant.
    """
    tau = durations(instants, window.start, window.horizon)
    elapsed = [window.elapsed, *np.zeros(len(instants))]
    stages = zip(window.stages, window.nodes, tau, elapsed, strict=True)
    return tuple(_desired_path(stage, N, duration, before) for stage, N, duration, before in stages)


def _desired_path(stage: Stage, N: int, tau: float, elapsed: float) -> DesiredPath:
    share = np.arange(N + 1) / N
    slopes = stage.rate(elapsed + share * tau) * share[:, None]
    return DesiredPath(stage.reference(elapsed + share * tau) - tau * slopes, slopes)


def end_tolerance(stage: Stage) -> np.ndarray:
    """Return the tolerance of each end row, positions first, then rates where they count. Paper eq. (18)."""
    if stage.end_velocity is None:
        return stage.tolerance
    return np.concatenate([stage.tolerance, np.full(len(stage.end_rows), stage.end_velocity)])


def shortest_durations(window: Window) -> np.ndarray:
    """Return the shortest duration of each stage (S + 1,): eps, or what is left of its dwell time."""
    dwell = np.array([stage.dwell for stage in window.stages])
    dwell[0] -= window.elapsed
    dwell[-1] = 0.0
    return np.asarray(np.maximum(dwell, SHORTEST))


def durations(instants: np.ndarray, start: float, horizon: float) -> np.ndarray:
    """Return the durations (S + 1,) [s] between start, the instants and the end of the horizon."""
    return np.asarray(np.diff(instants, prepend=start, append=start + horizon))


def on_mesh(plan: Plan, window: Window) -> Plan:
    """Return a plan read at the nodes of a window, begun at its measured state; the plan's instants (S,) stay."""
    tau = durations(plan.instants, window.start, window.horizon)
    times = window.start + mesh(tau, window.nodes)
    X = plan.states_at(times)
    X[0] = window.x0
    return Plan(times, X, plan.control_at(times[:-1]), plan.instants)


def plan_on_mesh(window: Window, X: np.ndarray, u: np.ndarray, tau: np.ndarray) -> Plan:
    """Return the plan of states X (K + 1, 2n) and accelerations u (K, n) at the nodes, free durations tau (S,) [s]."""
    times = window.start + mesh(np.append(tau, window.horizon - tau.sum()), window.nodes)
    return Plan(times, X, u, window.start + np.cumsum(tau))
