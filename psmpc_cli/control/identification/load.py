"""What the grippers hold, found out from the momentum of robot and load.

docs/grasp_model.md, section "A load that is estimated".
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.ocp.loads import LoadPrior
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel

OWN = 0.1
"""Deviation of the masses and inertias of the robot's bodies from the description, one sigma, as a part of them."""

UNEXPLAINED = 0.01, 5e-3
"""Deviation of a momentum that nothing explains, one sigma: a part of the impulse of the base, plus [N s, N m s]."""

PARTS = 4
"""Parts of a sample at whose middles the force of the low-level law is evaluated."""

SETTLING = 0.3
"""For how long after grippers close or open momenta are not looked at [s]: grasps give in, and swing."""

BLOCK = 3.0
"""After so long the momentum that was there before is taken as unknown again [s]: impulses sum up their errors."""

FAR = 9.0
"""Mean square of innovations over their variances beyond which the estimate does not explain what is measured: 3
sigma."""

MEMORY = 0.1
"""Share of the last innovation in that mean."""

OUTLIER = 25.0
"""What the square of one innovation counts as at most: one alone does not tell."""

LEAST = 0.02
"""Least mass and moments of inertia, as a part of the prior's."""


@dataclass(frozen=True, eq=False)
class LoadEstimate:
    """What is known of the load from the measurements so far.

    Normal equations of what is unknown: factors by which masses and inertias of the robot's bodies are off, mass and
    principal moments of the load, and the momentum at the beginning of a block of samples.

    Attributes:
        information: Their matrix.
        right: Their right side.
        numbers: Mass [kg] and principal moments [kg m^2] of the load, as a rigid body has them.
        deviation: Their standard deviations.
        begun: When the block began [s]; infinite where none is under way.
        settled_at: Before this time nothing is looked at [s].
        impulse: Of the base since then [N s, N m s].
        surprise: Mean square of the last innovations over their variances [1].
        dropped: The estimate did not explain the last measurements, and was given up for the prior.
    """

    information: np.ndarray
    right: np.ndarray
    numbers: np.ndarray
    deviation: np.ndarray
    impulse: np.ndarray
    begun: float = np.inf
    settled_at: float = -np.inf
    surprise: float = 1.0
    dropped: bool = False

    def __repr__(self) -> str:
        mass, *moments = (
            f"{value:.4g} (deviation {of:.2g})" for value, of in zip(self.numbers, self.deviation, strict=True)
        )
        dropped = "; dropped" if self.dropped else ""
        return f"<LoadEstimate: mass [kg] {mass}, moments of inertia [kg m^2] {', '.join(moments)}{dropped}>"


class _NoLoad(LoadEstimate):
    """Of a task that says what its load is, or has none."""

    def __repr__(self) -> str:
        return "<LoadEstimate: none, the load is not to be found out>"


NO_LOAD = _NoLoad(
    information=np.zeros((0, 0)), right=np.zeros(0), numbers=np.zeros(0), deviation=np.zeros(0), impulse=np.zeros(0)
)


@dataclass(frozen=True, eq=False)
class RobotAlone:
    """The robot at a sample, with empty hands.

    Attributes:
        time: Of the measurement [s].
        Q: Position of the robot (nq,).
        v: Its velocity (n,).
    """

    time: float
    Q: np.ndarray
    v: np.ndarray

    @property
    def is_loaded(self) -> bool:
        """Whether hands hold an object."""
        return False

    def load_momentum(self, model: RobotModel) -> np.ndarray:
        """Return the momentum of the load by its mass and its moments of inertia (n_twist, 1 + moments): of none."""
        return np.zeros((model.space.n_twist, 1))


@dataclass(frozen=True, eq=False)
class RobotAndObject(RobotAlone):
    """Robot and held object at a sample.

    Attributes:
        object_state: Pose and velocity of the object.
    """

    object_state: tuple[np.ndarray, np.ndarray]

    @property
    def is_loaded(self) -> bool:
        """Whether hands hold an object: they do."""
        return True

    def load_momentum(self, model: RobotModel) -> np.ndarray:
        """Return the momentum of the object by its mass and its principal moments (n_twist, 1 + moments)."""
        units = np.eye(1 + model.space.n_principal)
        columns = [FreeBody(unit[0], unit[1:].tolist()).momentum(*self.object_state) for unit in units]
        return np.array(columns, dtype=float).T


@dataclass(frozen=True, eq=False)
class RobotAndPayload(RobotAlone):
    """Robot at a sample, with a payload in its grippers that moves as the last links do.

    Attributes:
        shares: What each gripper holds of it (arms,); their sum is 1.
    """

    shares: np.ndarray

    @property
    def is_loaded(self) -> bool:
        """Whether hands hold an object: they do."""
        return True

    def load_momentum(self, model: RobotModel) -> np.ndarray:
        """Return the momentum of the payload by its mass and its moment of inertia (n_twist, 2)."""
        empty = model.nominal
        nothing = np.zeros_like(self.shares)
        without = model.momentum(self.Q, self.v, empty)
        units = empty.holding(self.shares, nothing), empty.holding(nothing, self.shares)
        return np.stack([model.momentum(self.Q, self.v, each) - without for each in units], axis=1)


class LoadEstimator:
    """Finds out the mass and the moments of inertia of what the grippers hold.

    The momentum of robot and load about the inertial origin is linear in their masses and inertias, and grows by the
    impulse of the base's force:

        P_r(Q, v) + R(Q, v) e + L(object) theta = c + impulse since the beginning of the block + noise,

    with e the errors of the robot's own bodies and c the momentum at the block's beginning. All three are unknown, with
    normal priors for e and theta: e is found out while hands are empty, else it would spoil theta. Levels since the
    beginning count, not increments, because the noise of a level does not grow.
    """

    def __init__(self, model: RobotModel, prior: LoadPrior, noise: np.ndarray) -> None:
        """Derive the momentum and its derivatives, and lay out the vector of unknowns.

        The unknowns are, in this order: factors e by which the masses of the robot's bodies are off, then their
        moments; the numbers theta of the load, its mass and its moments; the momentum c at the beginning of a block.

        Args:
            model: The robot.
            prior: What is known of the load before it is held.
            noise: Standard deviations of measured velocities (n,) [m/s, rad/s].
        """
        self._model = model
        self._prior = prior
        self._noise = noise
        self._momentum = ArrayFunction(_momentum(model))
        described = model.nominal
        bodies = len(described.mass)
        moments = described.inertia.size // bodies
        parameters = np.concatenate([described.mass, described.inertia.T.ravel()])
        # derivative of masses and moments by the factors: each moment of a body is off by the same factor
        by_factor = np.zeros((len(parameters), 2 * bodies))
        by_factor[:bodies, :bodies] = np.diag(described.mass)
        for moment in range(moments):
            rows = slice(bodies * (1 + moment), bodies * (2 + moment))
            by_factor[rows, bodies:] = np.diag(parameters[rows])
        self._parameters_by_factor = by_factor
        # where theta and c are among the unknowns
        self._of_load = slice(2 * bodies, 2 * bodies + len(prior.mean))
        self._of_offset = slice(self._of_load.stop, self._of_load.stop + model.space.n_twist)

    @property
    def first(self) -> LoadEstimate:
        """What is known before the first measurement."""
        count = self._of_offset.stop
        information = np.zeros((count, count))
        own = np.arange(self._of_load.start)
        information[own, own] = 1 / OWN**2
        estimate = LoadEstimate(
            information,
            np.zeros(count),
            self._prior.mean,
            self._prior.deviation,
            np.zeros(self._model.space.n_twist),
        )
        return self._with_prior(estimate)

    def _with_prior(self, estimate: LoadEstimate) -> LoadEstimate:
        """Return an estimate with the prior of the load in place of what was found."""
        marginal, right = _without_knowledge_of(estimate.information, estimate.right, self._of_load)
        of_load = np.arange(self._of_load.start, self._of_load.stop)
        marginal[of_load, of_load] = 1 / self._prior.deviation**2
        right[of_load] = self._prior.mean / self._prior.deviation**2
        return replace(
            estimate,
            information=marginal,
            right=right,
            numbers=self._prior.mean,
            deviation=self._prior.deviation,
            surprise=1.0,
        )

    def unsettled(self, estimate: LoadEstimate, time: float) -> LoadEstimate:
        """Return the estimate where grippers close or open at a time [s]: a new block begins later."""
        return replace(estimate, begun=np.inf, settled_at=time + SETTLING)

    def after_measurement(
        self, estimate: LoadEstimate, before: RobotAlone, now: RobotAlone, u: np.ndarray, law: LowLevelLaw
    ) -> LoadEstimate:
        """Return the estimate of the load after a measurement of the robot, and of the object if it is held.

        Momentum changes by the impulse of the base's force, and depends on the masses of robot and load: see
        `LoadEstimator`. Momenta are compared over a block of samples that begins with an unknown momentum. A new block
        begins when the old one is `BLOCK` long, when something is gripped or released, and after measurements that do
        not count.

        Args:
            estimate: That of the sample before.
            before: What was measured then.
            now: What is measured now. If it is not finite, or grippers have just closed or opened, it does not count.
            u: Accelerations that were commanded and acted in between (M, n) [m/s^2, rad/s^2].
            law: The low-level law that applied them, with the load that it then assumed.
        """
        estimate = replace(estimate, dropped=False)
        is_measured = all(np.isfinite(each).all() for each in (before.Q, before.v, now.Q, now.v))
        if now.time < estimate.settled_at or not is_measured:
            return replace(estimate, begun=np.inf)
        is_under_way = np.isfinite(estimate.begun) and before.is_loaded == now.is_loaded
        if now.time - estimate.begun > BLOCK or not is_under_way:
            information, right = _without_knowledge_of(estimate.information, estimate.right, self._of_offset)
            no_impulse = np.zeros_like(estimate.impulse)
            estimate = replace(estimate, information=information, right=right, begun=now.time, impulse=no_impulse)
        else:
            estimate = replace(estimate, impulse=estimate.impulse + self._base_impulse(before, now, u, law))
        return self._with_equations_at(estimate, now)

    def _base_impulse(self, before: RobotAlone, now: RobotAlone, u: np.ndarray, law: LowLevelLaw) -> np.ndarray:
        """Return the impulse of the base's force from one sample to the next, about the inertial origin [N s, N m s].

        The momentum of robot and load changes by this impulse. The force is that of the low-level law under the
        commanded accelerations, at states between the two measured ones. The part of it that makes up for the
        gyroscopic moment of reaction wheels is left out, since it only turns what they store.

        Args:
            before: Robot and load at the first sample.
            now: Robot and load at the second sample.
            u: Accelerations that were commanded and acted in between (M, n) [m/s^2, rad/s^2].
            law: The low-level law that applied them.

        Returns:
            Linear and angular impulse (n_twist,).
        """
        space = self._model.space
        duration = (now.time - before.time) / PARTS
        grasps = law.grasps if now.is_loaded else None
        step = np.array(space.difference(before.Q, now.Q))
        impulse = np.zeros(space.n_twist)
        for part, u_of_part in enumerate(np.array_split(u, PARTS)):
            share = (part + 0.5) / PARTS  # the middle of the part, from 0 to 1
            Q = np.array(space.integrate(before.Q, share * step))
            v = (1 - share) * before.v + share * now.v
            F = law.force(Q, v, u_of_part.mean(axis=0), grasps=grasps)
            if law.parameters.stored.any():
                # the gyroscopic moment is what the bias with stored momenta has more than the one without
                F = (
                    F
                    - self._model.bias(Q, v, self._model.nominal.storing(law.parameters.stored))
                    + self._model.bias(Q, v)
                )
            impulse += duration * np.array(space.external_wrench(Q, F), dtype=float)
        return impulse

    def _with_equations_at(self, estimate: LoadEstimate, now: RobotAlone) -> LoadEstimate:
        """Return the estimate with the equations of a measurement added to the normal equations of all unknowns.

        The measured momentum P gives one linear equation for each of its components,

            P + R e + L theta - c = impulse since the beginning of the block + noise,

        where R e is what errors of the robot's masses add, L theta the momentum of the load and c the momentum at the
        beginning of the block. Each is weighted by the covariance of its noise: that of measured velocities, and of
        what nothing explains. While a load is held, the equations are then solved for it. If they have not fitted for
        some time, what is known of the load is given up, and the estimate starts anew from the prior.
        """
        [P], by_parameters, by_v = self._momentum(now.Q, now.v)
        k = len(P)  # 3 in the plane, 6 in space
        rows = np.zeros((k, self._of_offset.stop))
        rows[:, : self._of_load.start] = by_parameters.T @ self._parameters_by_factor
        rows[:, self._of_load] = now.load_momentum(self._model)
        rows[:, self._of_offset] = -np.eye(k)
        share, least = UNEXPLAINED
        covariance = (
            2 * (by_v.T * self._noise**2) @ by_v + np.eye(k) * (share * np.linalg.norm(estimate.impulse) + least) ** 2
        )
        y = estimate.impulse - P
        surprise = self._mean_surprise(estimate, rows, y, covariance)
        if surprise > FAR and now.is_loaded:
            fresh = self._with_prior(estimate)
            return replace(fresh, begun=np.inf, dropped=True)
        weighted = np.linalg.solve(covariance, rows)
        information = estimate.information + rows.T @ weighted
        right = estimate.right + weighted.T @ y
        estimate = replace(estimate, information=information, right=right, surprise=surprise)
        if not now.is_loaded:
            return estimate
        inverse = np.linalg.inv(information)
        numbers = _as_rigid_body((inverse @ right)[self._of_load], LEAST * self._prior.mean)
        deviation = np.sqrt(np.diagonal(inverse)[self._of_load])
        return replace(estimate, numbers=numbers, deviation=deviation)

    def _mean_surprise(self, estimate: LoadEstimate, rows: np.ndarray, y: np.ndarray, covariance: np.ndarray) -> float:
        """Return the mean square of the last innovations over their variances, 1 if the estimate explains them.

        An innovation is what the measured momentum differs by from what the estimate expects.
        """
        if not estimate.information[self._of_offset, self._of_offset].any():
            return estimate.surprise
        inverse = np.linalg.inv(estimate.information)
        innovation = y - rows @ (inverse @ estimate.right)
        square = float(innovation @ np.linalg.solve(covariance + rows @ inverse @ rows.T, innovation)) / len(y)
        return (1 - MEMORY) * estimate.surprise + MEMORY * min(square, OUTLIER)


def _without_knowledge_of(information: np.ndarray, right: np.ndarray, unknowns: slice) -> tuple[np.ndarray, np.ndarray]:
    """Return normal equations in which some unknowns are unknown again, while what is known of the others stays.

    These unknowns are eliminated by the Schur complement, and their rows and columns are then 0.

    Args:
        information: Matrix of the normal equations (k, k).
        right: Their right side (k,).
        unknowns: Which unknowns.
    """
    of_them = information[unknowns, unknowns]
    information = information.copy()
    right = right.copy()
    if of_them.any():
        coupling = np.linalg.solve(of_them, information[unknowns])
        right -= coupling.T @ right[unknowns]
        information -= information[:, unknowns] @ coupling
    information[unknowns] = 0.0
    information[:, unknowns] = 0.0
    right[unknowns] = 0.0
    return information, right


def _as_rigid_body(numbers: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Return mass and principal moments as a rigid body may have them: positive, none above the sum of the others."""
    numbers = np.maximum(numbers, least)
    moments = numbers[1:]
    if len(moments) == 3:
        largest = int(np.argmax(moments))
        moments[largest] = min(moments[largest], moments.sum() - moments[largest])
    return numbers


def _momentum(model: RobotModel) -> ca.Function:
    """Return a function of Q and v: the momentum (n_twist,), its derivatives by masses and moments, and by v."""

    def derive() -> ca.Function:
        Q = ca.SX.sym("Q", model.nq)
        v = ca.SX.sym("v", model.n)
        w = ca.SX.sym("w", model.nominal.vector.size)
        P = model.dynamics.momentum(Q, v, w)
        count = model.nominal.mass.size + model.nominal.inertia.size
        outputs = P, ca.jacobian(P, w)[:, :count], ca.jacobian(P, v)
        at_nominal = ca.substitute([*outputs], [w], [ca.DM(model.nominal.vector)])
        return ca.Function("momentum_terms", [Q, v], [ca.densify(each) for each in ca.cse(at_nominal)])

    return model.derived((_momentum,), derive)
