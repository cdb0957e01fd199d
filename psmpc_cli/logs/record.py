"""A record: everything one sample leaves behind."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class SolveRecord:
    """What a solve was given and what it returned, enough to repeat it. Empty arrays where there was nothing."""

    status: str
    iterations: int
    wall_time: float  # [s], the solve alone
    objective: float  # J, in the task's own priorities
    guess: np.ndarray
    warm: bool
    guess_multipliers: np.ndarray
    parameters: np.ndarray
    solution: np.ndarray


@dataclass(frozen=True, eq=False)
class LevelsRecord:
    """What the levels of a lexicographic controller came to, by stage (S,).

    Attributes:
        objective: Optimum J_i* of the level, normalized; NaN where there was no level or it did not converge.
        cost: J_i of the stage at the last level that converged; NaN where there was none.
        wall_time: Of the level's solve alone [s]; NaN where there was none.
        solved: 1 if it converged, 0 if not, -1 if there was none.
    """

    objective: np.ndarray
    cost: np.ndarray
    wall_time: np.ndarray
    solved: np.ndarray


@dataclass(frozen=True, eq=False)
class TickRecord:
    """Every low-level tick of a sample: time (M,), Q, Qdot (M, n), F (M, n)."""

    time: np.ndarray
    Q: np.ndarray
    Qdot: np.ndarray
    F: np.ndarray


@dataclass(frozen=True, eq=False)
class Record:
    """One sample of the closed loop, from measured state to what the plant did until the next one.

    Attributes:
        time: Of the sample [s].
        Q, Qdot: Measured (n,).
        u: Acceleration applied over the first tick (n,) [m/s^2, rad/s^2].
        F: Generalized force over the first tick (n,) [N, N m].
        xi: Poses (m,).
        window_first: Index of the current stage.
        instants: Switching instants in the window (S,) [s], absolute.
        nadir: Scale of each window stage's normalized cost, (S + 1,).
        nodes: Intervals of each window stage, (S + 1,).
        flags: Names of what happened: appended, postponed, fallback, braking, unmeasured.
        switches: Stage index and instant [s] of each hand-over since the last sample.
        presence: By stage index, how much of a waiting stage is in the control. See `OnsetObserver`.
        solve: The solve.
        stage_cost: Lbar of the current stage.
        position_margin, velocity_margin: Smallest distance to a limit over all ticks until the next sample (n,).
        control_effort: Integral of |u|^2 until the next sample.
        thruster_effort: Integrals of the norms of base force and base torque until the next sample (2,) [N s, N m s].
        momentum_error: p(t) - p(0) - integral of the external wrench, at the next sample (3,).
        energy_error: T - T(0) - integral of F' Qdot, at the next sample [J].
        ticks: Every tick, where asked for.
        window_cost: Normalized cost integral of each window stage, (S + 1,); empty after a failed solve.
        shares: By stage index, its share in the applied control. See `control_shares`.
        plan_deviation: State at the next sample less the plan's (2n,); empty where it is not known.
        end_errors: By stage index, the error of its end condition over its tolerance, of stages that hand over at an
            instant before the next sample.
        levels: Under lexicographic control, unless its first level failed.
        true: The true state (2n,), where the measured one has noise.
        payload: Whether the payload is held from here on, and the energy that taking it up or letting it go at this
            sample added [J]; None in a task without one.
        disturbance: Estimated acceleration that no plan knows of (n,), under offset-free control.
        basin: Which guess of the window's instants won, 0 the last plan's; -1 if it was the only one.
    """

    time: float
    Q: np.ndarray
    Qdot: np.ndarray
    u: np.ndarray
    F: np.ndarray
    xi: np.ndarray
    window_first: int
    instants: np.ndarray
    nadir: np.ndarray
    nodes: np.ndarray
    flags: frozenset[str]
    switches: tuple[tuple[int, float], ...]
    presence: dict[int, float]
    solve: SolveRecord
    stage_cost: float
    position_margin: np.ndarray
    velocity_margin: np.ndarray
    control_effort: float
    thruster_effort: np.ndarray
    momentum_error: np.ndarray
    energy_error: float
    ticks: TickRecord | None = None
    window_cost: np.ndarray = field(default_factory=lambda: np.zeros(0))
    shares: Mapping[int, float] = field(default_factory=dict)
    levels: LevelsRecord | None = None
    true: np.ndarray | None = None
    payload: tuple[bool, float] | None = None
    disturbance: np.ndarray | None = None
    plan_deviation: np.ndarray = field(default_factory=lambda: np.zeros(0))
    end_errors: Mapping[int, float] = field(default_factory=dict)
    basin: int = -1
