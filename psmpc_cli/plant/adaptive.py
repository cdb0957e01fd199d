"""The full rigid-body dynamics by an adaptive integrator of a library: SUNDIALS CVODES, as CasADi ships it.

Only for verification: the plants step at the rate of the low-level loop. The order adapts too (Adams methods), and the
control is constant over each piece, so that the right-hand side is smooth within it.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.robot.model import RobotModel

TOLERANCE = 1e-12
"""Absolute and relative tolerance of a step [m, rad, m/s, rad/s]."""

INSIDE = 4
"""Parts of a piece at whose ends its states are returned."""


@dataclass(frozen=True, eq=False)
class Flow:
    """States over consecutive pieces of constant control.

    Attributes:
        times: (pieces * INSIDE + 1,) [s], the first and every `INSIDE`-th after it being ends of pieces.
        states: States at those times, (len(times), nq + n).
    """

    times: np.ndarray
    states: np.ndarray

    @property
    def between_pieces(self) -> np.ndarray:
        """The states at the beginning and after each piece (pieces + 1, nq + n)."""
        return self.states[::INSIDE]


class AdaptiveDynamics:
    """Integrates the full dynamics piece by piece, under the low-level law or under a held force.

    What acts on a piece is named: `law`, where the law (7) follows its acceleration at every instant; `ticks`, where
    the law sets the force once, at its beginning; `force`, where a generalized force is held.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._integrators = {lawful: _integrator(model, lawful) for lawful in (False, True)}

    def under(self, what: str, state: np.ndarray, times: np.ndarray, inputs: np.ndarray) -> Flow:
        """Return the states from a state (nq + n,) on.

        Args:
            what: What acts: `law`, `ticks` or `force`.
            state: State at the first of the times.
            times: Ends of the pieces (K + 1,) [s].
            inputs: Accelerations [m/s^2, rad/s^2], or generalized forces [N, N m], of the pieces (K, n). Under the law
                a spatial robot's are those of a plan, in its chart, each with the chart's anchor behind it (K, n + 4).
        """
        states = [state[:, None]]
        integrator = self._integrators[what == "law"]
        for given, dt in zip(inputs, np.diff(times), strict=True):
            state = states[-1][:, -1]
            if what == "ticks":
                given = self._model.computed_torque(state[: self._model.nq], state[self._model.nq :], given)
            states.append(np.asarray(integrator(x0=state, p=np.r_[given, dt])["xf"]))
        parts = np.arange(1, INSIDE + 1) / INSIDE
        inside = (times[:-1, None] + np.diff(times)[:, None] * parts).ravel()
        return Flow(np.concatenate([times[:1], inside]), np.hstack(states).T)


def _integrator(model: RobotModel, lawful: bool) -> ca.Function:
    """Return the integrator of one piece, its time scaled to 1, under the law or under a held force."""
    n = model.n
    nq = model.nq
    w = model.nominal.vector
    state = ca.SX.sym("x", nq + n)
    anchor = model.space.n_anchor if lawful else 0
    p = ca.SX.sym("p", n + anchor + 1)
    Q = state[:nq]
    v = state[nq:]
    u = p[:n]
    vdot = model.space.acceleration_at(Q, v, u, p[n:-1]) if lawful else u
    F = model.law()(Q, v, vdot, w) if lawful else p[:n]
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    ode = p[-1] * ca.vertcat(*Qdot, model.dynamics.forward(Q, v, F, w))
    options: dict[str, Any] = {
        "abstol": TOLERANCE,
        "reltol": TOLERANCE,
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
    }
    parts = [float(part) for part in np.arange(1, INSIDE + 1) / INSIDE]
    problem: dict[str, ca.SX] = {"x": state, "p": p, "ode": ode}
    return ca.integrator("piece", "cvodes", problem, 0.0, parts, options)
