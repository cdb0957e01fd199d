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

    def integrate(
        self, acting: str, state: np.ndarray, times: np.ndarray, inputs: np.ndarray, stored: np.ndarray | None = None
    ) -> Flow:
        """Integrate the full dynamics over pieces of constant input, to check the plants and plans by another method.

        Args:
            acting: What the inputs are. `law`: accelerations that the low-level law follows at every instant; `ticks`:
                accelerations that it turns into a force where each piece begins, as a plant does; `force`: generalized
                forces.
            state: State [Q; v] at the first of the times (nq + n,).
            times: When the K pieces begin, and when the last one ends (K + 1,) [s].
            inputs: Accelerations [m/s^2, rad/s^2] or generalized forces [N, N m] of the pieces (K, n). Under `law` a
                spatial robot's are those of a plan, in its chart, each with the chart's anchor behind it (K, n + 4).
            stored: What wheels store at these times, along the base's axes (K + 1, n_stored) [N m s]; by default
                nothing. The force on the base then includes that of the motors of the wheels.

        Returns:
            Times and states: the first, then `INSIDE` for each piece, equally spaced, the last of them at its end.
        """
        if stored is None:
            stored = np.zeros((len(times), self.n_stored))
        states = [state[:, None]]  # columns, as the integrator returns them
        integrator = self._integrators[acting == "law"]
        for piece_input, dt, before, after in zip(inputs, np.diff(times), stored[:-1], stored[1:], strict=True):
            state = states[-1][:, -1]
            if acting == "ticks":  # the force of the law where the piece begins is held over it
                law = self._model.nominal.storing(before) if self.n_stored else None
                Q, v = np.split(state, [self._model.nq])
                piece_input = self._model.computed_torque(Q, v, piece_input, law)
            states.append(np.asarray(integrator(x0=state, p=np.r_[before, after, piece_input, dt])["xf"]))
        shares_of_piece = np.arange(1, INSIDE + 1) / INSIDE
        times_inside = (times[:-1, None] + np.diff(times)[:, None] * shares_of_piece).ravel()
        return Flow(np.concatenate([times[:1], times_inside]), np.hstack(states).T)


def stored_that_acts(model: RobotModel) -> int:
    """Return the number of components of what wheels store: 3 in space; 0 in the plane, where it has no effect."""
    return n_stored(model.spec) if model.dimension > 2 else 0


def _integrator(model: RobotModel, under_law: bool) -> ca.Function:
    """Build the integrator of the full dynamics over one piece of constant input, with an adaptive step.

    It is the reference with which `psmpc verify` checks the fixed steps of plants, and plans.

    Time runs from 0 to 1, so that one integrator serves pieces of any length: the length, which is the last parameter,
    multiplies the rates. Outputs are at `INSIDE` equidistant times.

    Args:
        model: The robot.
        under_law: Whether the input is an acceleration that the low-level law follows at every instant, of coordinates
            in a chart: three numbers for the attitude near that of its anchor, which is a parameter. Otherwise the
            input is a generalized force, held over the piece.

    Returns:
        CasADi integrator with the initial state x0 = [Q; v] (nq + n,) and the parameters p = [what wheels store at the
        beginning; at the end; input; anchor; length]. Its result xf has a state in each column (nq + n, INSIDE).
    """
    n = model.n
    nq = model.nq
    inertial_parameters: Any = model.nominal.vector
    state = ca.SX.sym("x", nq + n)
    time = ca.SX.sym("t")
    anchor_size = model.space.n_anchor if under_law else 0
    stored_sizes = [stored_that_acts(model)] * 2
    parameters = ca.SX.sym("p", sum(stored_sizes) + n + anchor_size + 1)
    before, after, u, anchor, length = ca.vertsplit(
        parameters, np.cumsum([0, *stored_sizes, n, anchor_size, 1]).tolist()
    )
    if stored_that_acts(model):
        stored = before + time * (after - before)
        inertial_parameters = with_stored(model.spec, ca.SX(inertial_parameters), stored)
    Q = state[:nq]
    v = state[nq:]
    vdot = model.space.acceleration_at(Q, v, u, anchor) if under_law else u
    F = model.law()(Q, v, vdot, inertial_parameters) if under_law else u  # otherwise the input is the force
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    ode = length * ca.vertcat(*Qdot, model.dynamics.forward(Q, v, F, inertial_parameters))
    options: dict[str, Any] = {
        "abstol": TOLERANCE,
        "reltol": TOLERANCE,
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
    }
    output_times = [float(time) for time in np.arange(1, INSIDE + 1) / INSIDE]
    dae: dict[str, ca.SX] = {"t": time, "x": state, "p": parameters, "ode": ode}
    return ca.integrator("piece", "cvodes", dae, 0.0, output_times, options)
