"""A window: the stages inside the current prediction horizon, with every number its NLP needs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.layout import Layout, StageShape, WindowShape, mesh
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.soft_limits import node_limits, scaled_violations
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.transcription import Nlp

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


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds on the decision variables and on the rows of g."""

    lbx: np.ndarray
    ubx: np.ndarray
    lbg: np.ndarray
    ubg: np.ndarray


def window_shape(
    stages: Sequence[Stage], nodes: tuple[int, ...], discretization: str, soft: bool = False
) -> WindowShape:
    """Return the shape of a window over these stages; the last stage's end condition is not imposed."""
    last = len(stages) - 1
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
            for i, stage in enumerate(stages)
        ),
        nodes=nodes,
        discretization=discretization,
        soft=soft,
    )


def parameter_vector(nlp: Nlp, window: Window, instants: np.ndarray) -> np.ndarray:
    """Return the numbers of the NLP's parameter vector for this window, its instants guessed at (S,) [s]."""
    largest = float(np.max(window.omega))
    stages = window.stages
    numbers = Parameters(
        x0=window.x0,
        horizon=np.array(window.horizon),
        pending=np.array(window.pending_cost),
        terminal=np.array(window.terminal_cost),
        omega=window.omega / largest,
        offset=window.offset,
        scale=window.scale,
        weights=tuple(stage.weights for stage in stages),
        control_weights=tuple(stage.control_weights for stage in stages),
        targets=tuple(stage.target for stage in stages),
        paths=_path_columns(nlp, window, instants),
    )
    return np.concatenate([np.ravel(piece, order="F") for piece in numbers.pieces()])


def _path_columns(nlp: Nlp, window: Window, instants: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return what each stage's cost follows, (rows, 2 (N_s + 1)); (rows, 0) where the target stands still."""
    still = [np.zeros((len(stage.target), 0)) for stage in window.stages]
    if all(stage.trajectory is None for stage in window.stages):
        return tuple(still)
    paths = desired_paths(nlp.layout.nodes, window, instants)
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


def desired_paths(nodes: tuple[int, ...], window: Window, instants: np.ndarray) -> tuple[DesiredPath, ...]:
    """Return what each stage's cost follows, about the durations that the guessed instants (S,) [s] give.

    A trajectory's time counts from where its stage begins: for the current stage in the past, for others at an instant.
    """
    tau = durations(instants, window.start, window.horizon)
    elapsed = [window.elapsed, *np.zeros(len(instants))]
    stages = zip(window.stages, nodes, tau, elapsed, strict=True)
    return tuple(_desired_path(stage, N, duration, before) for stage, N, duration, before in stages)


def _desired_path(stage: Stage, N: int, tau: float, elapsed: float) -> DesiredPath:
    share = np.arange(N + 1) / N
    slopes = stage.rate(elapsed + share * tau) * share[:, None]
    return DesiredPath(stage.reference(elapsed + share * tau) - tau * slopes, slopes)


def bounds(nlp: Nlp, window: Window) -> Bounds:
    """Return the bounds of the NLP for this window. Paper eqs. (14), (17), (18)."""
    layout = nlp.layout
    lbx, ubx = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    low, high = node_limits(layout, window.stages)
    for s, stage in enumerate(window.stages):
        if stage.input == "joint":
            inputs = layout.input_index(s)
            lbx[inputs], ubx[inputs] = stage.limits.acceleration_low, stage.limits.acceleration_high
    lbx[layout.duration_index[0]] = shortest_durations(window)[:-1]
    lbg, ubg = np.zeros(len(nlp.equality)), np.zeros(len(nlp.equality))
    if layout.soft:
        lbx[layout.violation_index] = 0.0
        lbg[nlp.limit_rows], ubg[nlp.limit_rows] = [low, np.full_like(low, -np.inf)], [np.full_like(high, np.inf), high]
    else:
        lbx[layout.state_index[1:]], ubx[layout.state_index[1:]] = low[1:], high[1:]
    if nlp.last_duration_row is not None:
        lbg[nlp.last_duration_row], ubg[nlp.last_duration_row] = SHORTEST, np.inf
    for s, row in nlp.instant_rows.items():
        at = window.stages[s].at
        lbg[row] = ubg[row] = (0.0 if at is None else at) - window.start
    for s, rows in nlp.end_rows.items():
        tolerance = end_tolerance(window.stages[s])
        lbg[rows], ubg[rows] = -tolerance, tolerance
    return Bounds(lbx, ubx, lbg, ubg)


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


def pack_guess(nlp: Nlp, window: Window, guess: Plan, instants: np.ndarray, costs: StageCosts) -> np.ndarray:
    """Return the decision vector that follows a guessed plan with the given instants (S,)."""
    layout = nlp.layout
    tau = durations(instants, window.start, window.horizon)
    times = window.start + mesh(tau, layout.nodes)
    z = np.zeros(layout.size)
    X = guess.states_at(times)
    X[0] = window.x0
    z[layout.state_index] = X
    z[layout.duration_index] = tau[:-1]
    u = guess.control_at(times[:-1])
    for s, stage in enumerate(window.stages):
        first, last = layout.first_node[s], layout.first_node[s + 1]
        inputs = u[first:last] if stage.input == "joint" else costs.task_acceleration(X[first:last], u[first:last])
        z[layout.input_index(s)] = inputs
    if layout.soft:
        z[layout.violation_index] = scaled_violations(X, *node_limits(layout, window.stages))
    return z


def unpack_plan(nlp: Nlp, window: Window, z: np.ndarray) -> Plan:
    """Return the plan a decision vector stands for."""
    layout: Layout = nlp.layout
    tau = z[layout.duration_index[0]]
    instants = window.start + np.cumsum(tau)
    times = window.start + mesh(np.append(tau, window.horizon - tau.sum()), layout.nodes)
    X = z[layout.state_index]
    u = np.zeros((layout.K, layout.n))
    for s, stage in enumerate(window.stages):
        first, last = layout.first_node[s], layout.first_node[s + 1]
        if stage.input == "joint":
            u[first:last] = z[layout.input_index(s)]
        else:
            u[first:last] = np.diff(X[first : last + 1, layout.n :], axis=0) / np.diff(times[first : last + 1])[:, None]
    return Plan(times, X, u, instants)
