"""Masses and inertias of the robot's bodies, and of what its grippers hold, found out from forces and accelerations.

docs/uncertainty_model.md, section "Wrong masses".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.control.identification.delay import Acting
from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel

BODIES = 0.1
"""Deviation of masses and inertias of the robot's bodies from the description, one sigma, as a share of them."""

HELD = 0.1, 0.005
"""Deviation of mass and inertia of what a gripper holds from 0, one sigma, as shares of the robot's mass [1, m^2]."""

UNEXPLAINED = 0.02, 5e-3
"""Deviation of an acceleration that nothing explains, one sigma: a share of those commanded, plus [m/s^2, rad/s^2]."""

GATE = 5.0
"""Accelerations so many sigma from what is expected, root mean square, count with the deviation that explains them."""

ITERATIONS = 8
"""Linearizations of an update at most."""

CONVERGED = 1e-3
"""Change of the shares below which there is no other."""

SETTLING = 0.5
"""For how long after grippers close or open accelerations are not looked at [s]: velocities jump, grasps swing."""

LEAST = 0.2
"""Least mass and inertia of a body, as a share of the described ones."""


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """Motion of the robot between two samples.

    Attributes:
        begin, end: Of the two measurements [s].
        Q: Position in the middle (nq,) [m, rad].
        v: Mean of both velocities (n,) [m/s, rad/s].
        vdot: Change of the velocity over the time between (n,) [m/s^2, rad/s^2].
    """

    begin: float
    end: float
    Q: np.ndarray
    v: np.ndarray
    vdot: np.ndarray

    @property
    def is_measured(self) -> bool:
        """Whether all of it was measured."""
        return bool(np.isfinite(self.Q).all() and np.isfinite(self.vdot).all())


@dataclass(frozen=True, eq=False)
class InertiaEstimate:
    """What is known of masses and inertias.

    Attributes:
        shares: By which masses, then inertias, of the bodies differ from the described ones [1]; then masses and
            inertias held by each gripper, as multiples of their deviations before anything is measured.
        covariance: Of these.
        bodies: Number of bodies.
        is_loaded: Grippers hold something.
        settled_at: Before this time nothing is looked at [s].
    """

    shares: np.ndarray
    covariance: np.ndarray
    bodies: int
    is_loaded: bool = False
    settled_at: float = -np.inf

    def __repr__(self) -> str:
        masses, inertias = (
            f"{factors.min():.3f} to {factors.max():.3f}" for factors in (self.mass_factor, self.inertia_factor)
        )
        return f"<InertiaEstimate of {self.bodies} bodies: {masses} of the described masses, {inertias} of inertias>"

    @property
    def mass_factor(self) -> np.ndarray:
        """Masses of the bodies over the described ones (bodies,)."""
        return 1 + self.shares[: self.bodies]

    @property
    def inertia_factor(self) -> np.ndarray:
        """Inertias of the bodies over the described ones (bodies,)."""
        return 1 + self.shares[self.bodies : 2 * self.bodies]

    @property
    def mass_deviation(self) -> np.ndarray:
        """Standard deviations of the factors of masses (bodies,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)[: self.bodies]))

    @property
    def inertia_deviation(self) -> np.ndarray:
        """Standard deviations of the factors of inertias (bodies,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)[self.bodies : 2 * self.bodies]))


class _NoInertia(InertiaEstimate):
    """Of a controller that counts with the described masses and inertias."""

    def __repr__(self) -> str:
        return "<InertiaEstimate: none, masses and inertias are not to be found out>"


NO_INERTIA = _NoInertia(shares=np.zeros(0), covariance=np.zeros((0, 0)), bodies=0)


class InertiaEstimator:
    """Finds out masses and inertias of the robot's bodies, and of what its grippers hold rigidly.

    Under the force F that the low-level law has applied the robot has the accelerations

        vdot(x) = H(w)^-1 (F - C(w) v) + noise,    w = w_0 + S x,

    with x how far masses and inertias are from the described ones. The noise is that of two measured velocities and of
    what nothing explains. Prior to measurements x is normal about 0; an iterated extended Kalman filter without process
    noise follows it. Its derivatives are taken at the accelerations that the estimate expects, not at measured ones,
    whose noise would bias it. What grippers hold is unknown anew whenever they close. Since H and C are linear in w,

        dvdot/dx = -H^-1 Y S,    Y = d(H vdot + C v) / dw.

    Sources: Atkeson, An, Hollerbach: Estimation of inertial parameters of manipulator loads and links (1986); Bell,
    Cathey: The iterated Kalman filter update as a Gauss-Newton method (1993).

    """

    def __init__(self, model: RobotModel, noise: np.ndarray) -> None:
        """Derive how the dynamics depend on masses and inertias, and lay out the vector of unknowns.

        The unknowns are shares: for every body one by which its mass differs from the described one, then one for its
        inertia, about all axes alike; then the masses and the inertias of what each gripper holds.

        Args:
            model: The robot.
            noise: Standard deviations of measured velocities (n,) [m/s, rad/s].
        """
        self._model = model
        self._noise = noise
        self._rows_that_move = model.space.joint_rates if not model.spec.moved_by.moves else slice(0, model.n)
        self._force_by = ArrayFunction(_force_by_parameters(model))
        described = model.nominal
        bodies = len(described.mass)
        grippers = len(described.held_mass)
        self._of_load = slice(2 * bodies, 2 * bodies + 2 * grippers)
        total = described.mass.sum()
        held = np.repeat(np.array(HELD) * total, grippers)
        # parameters that a share of 1 stands for [kg, kg m^2]
        self._scales = np.concatenate([described.mass, described.inertia.T.ravel(), held])
        self._least = np.zeros(self._of_load.stop)
        self._least[: 2 * bodies] = LEAST - 1  # a share of 0 is the described mass
        # the derivative of all inertial parameters by the shares: all moments of a body have one share
        moments = described.inertia.shape[1]
        by_share = np.eye(self._of_load.stop)
        rows = [np.arange(bodies), *[bodies + np.arange(bodies)] * moments, np.arange(2 * bodies, len(by_share))]
        self._parameters_by_share = self._scales[:, None] * by_share[np.concatenate(rows)]

    @property
    def first(self) -> InertiaEstimate:
        """What is known before the first measurement, with empty hands."""
        count = self._of_load.stop
        covariance = np.zeros((count, count))
        bodies = np.arange(self._of_load.start)
        covariance[bodies, bodies] = BODIES**2
        return InertiaEstimate(np.zeros(count), covariance, len(self._model.nominal.mass))

    def parameters(self, estimate: InertiaEstimate, is_loaded: bool) -> InertialParameters:
        """Return the most likely inertial parameters, with what grippers hold where they are loaded."""
        described = self._model.nominal
        bodies, moments = described.inertia.shape
        held = is_loaded * estimate.shares[self._of_load] * self._scales[bodies * (1 + moments) :]
        held_mass, held_inertia = np.split(held, 2)
        return replace(
            described,
            mass=described.mass * estimate.mass_factor,
            inertia=described.inertia * estimate.inertia_factor[:, None],
            held_mass=held_mass,
            held_inertia=held_inertia,
        )

    def holding(self, estimate: InertiaEstimate, is_loaded: bool, time: float) -> InertiaEstimate:
        """Return the estimate with grippers that hold something, or nothing, from a time [s] on."""
        if is_loaded == estimate.is_loaded:
            return estimate
        shares = estimate.shares.copy()
        covariance = estimate.covariance.copy()
        of_load = np.arange(self._of_load.start, self._of_load.stop)
        shares[of_load] = 0.0
        covariance[of_load] = 0.0
        covariance[:, of_load] = 0.0
        covariance[of_load, of_load] = float(is_loaded)
        return replace(estimate, shares=shares, covariance=covariance, is_loaded=is_loaded, settled_at=time + SETTLING)

    def after_measurement(
        self,
        estimate: InertiaEstimate,
        motion: MeasuredMotion,
        acting: Sequence[Acting],
        uncertain: np.ndarray | None = None,
    ) -> InertiaEstimate:
        """Return the estimate of masses and inertias after a motion between two samples was measured.

        The accelerations that the robot had are compared with those that it would have under the applied force with
        the estimated parameters. The update is that of an iterated extended Kalman filter, see `InertiaEstimator`:
        derivatives are taken anew at each iterate. Accelerations that are far from what is expected get a larger noise,
        so that an unmodelled blow does not spoil the estimate.

        Args:
            estimate: That of the sample before.
            motion: The motion. If it was not measured, or grippers have just closed or opened, it is left out.
            acting: The commands that acted meanwhile.
            uncertain: Standard deviation of the commanded accelerations (n,), by default 0. If it is not finite, the
                motion is left out.
        """
        uncertain = np.zeros(self._model.n) if uncertain is None else uncertain
        if motion.begin < estimate.settled_at or not (motion.is_measured and np.isfinite(uncertain).all()):
            return estimate
        # the mean force that the low-level law has applied
        F = np.zeros(self._model.n)
        stored = self._model.nominal.stored
        for command in acting:
            law = command.law or LowLevelLaw(self._model)
            stored = law.parameters.stored
            F += command.share * law.force(motion.Q, motion.v, command.u)
        u = np.array([command.u for command in acting])
        share, least = UNEXPLAINED
        unexplained = share * np.sqrt((u**2).mean()) + least
        duration = motion.end - motion.begin
        variance = 2 * (self._noise / duration) ** 2 + uncertain**2 + unexplained**2
        noise = np.diag(variance[self._rows_that_move])
        P = estimate.covariance
        shares = estimate.shares
        for iteration in range(ITERATIONS):
            parameters = self.parameters(replace(estimate, shares=shares), is_loaded=estimate.is_loaded)
            parameters = parameters.storing(stored)
            vdot = self._model.forward_dynamics(motion.Q, motion.v, F, parameters)
            surplus = (motion.vdot - vdot)[self._rows_that_move]
            # With Y at the measured accelerations the first step is exact without noise, however large it is.
            rows = self._acceleration_by_shares(motion, motion.vdot if iteration == 0 else vdot, parameters)
            if iteration == 0:
                square = float(surplus @ np.linalg.solve(rows @ P @ rows.T + noise, surplus)) / len(surplus)
                noise *= max(1.0, square / GATE**2)  # `square` is the mean square of the deviations, in sigma^2
            gain = np.linalg.solve(rows @ P @ rows.T + noise, rows @ P).T
            # iterate i + 1 is x_0 + K (surplus - dvdot/dx (x_0 - x_i)), with the estimate x_0 before the measurement
            before = shares
            shares = estimate.shares + gain @ (surplus - rows @ (estimate.shares - shares))
            shares = np.maximum(shares, self._least)
            if np.abs(shares - before).max() < CONVERGED:
                break
        # Joseph's form keeps the covariance symmetric and positive
        remaining = np.eye(len(P)) - gain @ rows
        covariance = remaining @ P @ remaining.T + gain @ noise @ gain.T
        return replace(estimate, shares=shares, covariance=covariance)

    def _acceleration_by_shares(
        self, motion: MeasuredMotion, vdot: np.ndarray, parameters: InertialParameters
    ) -> np.ndarray:
        """Return derivatives of the accelerations under a given force by the shares, at accelerations vdot (n,).

        Of H vdot + C v = F, in which H and C are linear in the parameters: dvdot = -H^-1 Y dw.
        """
        [Y] = self._force_by(motion.Q, motion.v, vdot)
        H = self._model.mass_matrix(motion.Q, parameters)[self._rows_that_move, self._rows_that_move]
        return -np.linalg.solve(H, (Y.T @ self._parameters_by_share)[self._rows_that_move])


def _force_by_parameters(model: RobotModel) -> ca.Function:
    """Return the regressor of the dynamics, a function of Q, v, vdot: Y = dF / dtheta (n, parameters).

    The generalized force F (n,) of a motion is linear in theta: masses and moments of inertia of the bodies, then
    masses and inertias of what each gripper holds. So measured motions under known forces tell of theta by linear least
    squares. The function is derived once for all models of the robot.
    """

    def derive() -> ca.Function:
        """Derive dF / d(masses, inertias, held masses and inertias) as a function of Q, v, vdot."""
        Q = ca.SX.sym("Q", model.nq)
        v = ca.SX.sym("v", model.n)
        vdot = ca.SX.sym("vdot", model.n)
        described = model.nominal
        mass, inertia, offset, stored, held = (
            ca.SX.sym(name, size)
            for name, size in (
                ("mass", described.mass.size),
                ("inertia", described.inertia.size),
                ("offset", described.offset.size),
                ("stored", described.stored.size),
                ("held", 2 * described.held_mass.size),
            )
        )
        w = ca.vertcat(mass, inertia, offset, stored, held)
        F = model.dynamics.inverse(Q, v, vdot, w)
        Y = ca.jacobian(F, ca.vertcat(mass, inertia, held))
        # it is independent of theta, but depends on the centres of mass and the stored momentum, as described
        [Y_described] = ca.substitute([Y], [w], [ca.DM(described.vector)])
        return ca.Function("force_by_parameters", [Q, v, vdot], [ca.densify(Y_described)])

    return model.derived((_force_by_parameters,), derive)
