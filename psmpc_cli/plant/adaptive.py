"""The full rigid-body dynamics by an adaptive integrator of a library: SUNDIALS CVODES, as CasADi ships it.

Only for verification: the plants step at the rate of the low-level loop. The order adapts too (Adams methods), and the
control is constant over each piece, so that the right-hand side is smooth within it.

What reaction wheels store changes at the constant rate of their torques over a piece. In space it acts on the base.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.robot.dynamics import n_stored, with_stored
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

    Attributes:
        n_stored: Number of components of what wheels store where that acts on the motion: 3 in space, else 0.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.n_stored = stored_that_acts(model)
        self._integrators = {lawful: _integrator(model, lawful) for lawful in (False, True)}

    def under(
        self, what: str, state: np.ndarray, times: np.ndarray, inputs: np.ndarray, stored: np.ndarray | None = None
    ) -> Flow:
        """Return the states from a state (nq + n,) on.

        Args:
            what: What acts: `law`, `ticks` or `force`.
            state: State at the first of the times.
            times: Ends of the pieces (K + 1,) [s].
            inputs: Accelerations [m/s^2, rad/s^2], or generalized forces [N, N m], of the pieces (K, n). Under the law
                a spatial robot's are those of a plan, in its chart, each with the chart's anchor behind it (K, n + 4).
            stored: What wheels store at the ends of the pieces, along the base's axes (K + 1, n_stored) [N m s]; by
                default nothing. The force on the base is that with the motors of the wheels.
        """
        if stored is None:
            stored = np.zeros((len(times), self.n_stored))
        states = [state[:, None]]
        integrator = self._integrators[what == "law"]
        for given, dt, before, after in zip(inputs, np.diff(times), stored[:-1], stored[1:], strict=True):
            state = states[-1][:, -1]
            if what == "ticks":
                law = self._model.nominal.storing(before) if self.n_stored else None
                given = self._model.computed_torque(state[: self._model.nq], state[self._model.nq :], given, law)
            states.append(np.asarray(integrator(x0=state, p=np.r_[before, after, given, dt])["xf"]))
        parts = np.arange(1, INSIDE + 1) / INSIDE
        inside = (times[:-1, None] + np.diff(times)[:, None] * parts).ravel()
        return Flow(np.concatenate([times[:1], inside]), np.hstack(states).T)


def stored_that_acts(model: RobotModel) -> int:
    """Return the number of components of what wheels store: 3 in space; in the plane it has no effect, 0."""
    return n_stored(model.spec) if model.dimension > 2 else 0


def _integrator(model: RobotModel, lawful: bool) -> ca.Function:
    """Return the integrator of one piece, its time scaled to 1, under the law or under a held force."""
    n = model.n
    nq = model.nq
    w: Any = model.nominal.vector
    state = ca.SX.sym("x", nq + n)
    anchor = model.space.n_anchor if lawful else 0
    ends = 2 * stored_that_acts(model)
    parameters = ca.SX.sym("p", ends + n + anchor + 1)
    p = parameters[ends:]
    time = ca.SX.sym("t")
    if ends:
        before, after = ca.vertsplit(parameters[:ends], ends // 2)
        w = with_stored(model.spec, ca.SX(w), before + time * (after - before))
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
    problem: dict[str, ca.SX] = {"t": time, "x": state, "p": parameters, "ode": ode}
    return ca.integrator("piece", "cvodes", problem, 0.0, parts, options)
