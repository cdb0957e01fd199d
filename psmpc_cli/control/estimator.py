"""The state that a controller decides from: filtered measurements, foreseen over the delay; delay and disturbance."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.identification.delay import DelayEstimate, DelayEstimator, Sent, SentCommands
from psmpc_cli.control.interface import State
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.motion import over_ticks, slew_limited
from psmpc_cli.specs.controller import ControllerSpec

PROCESS_NOISE = 0.2, 0.01
"""How far the robot's acceleration is from the planned one, one sigma: a share of it, plus [m/s^2, rad/s^2].

Masses that are wrong by 10 % and a payload of a tenth of the robot's mass change accelerations by a fifth; the rest is
friction, and what holds the estimate open for new measurements while nothing moves.
"""

SURE = 3.0
"""A measured velocity that is fewer sigma of its noise from the prediction says nothing of the plan's error."""

RESERVE_DECAY = 0.95
"""What is left of a reserve of speed after a sample: half of it after 1.4 s at ten samples a second."""

GATE = 5.0
"""A coordinate whose measurement is this many sigma from its prediction has jumped: its estimate starts anew."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of the robot from the measurements so far.

    Attributes:
        time: Of the last measurement [s].
        state: Estimated state then.
        covariance: Of the error of each coordinate and its velocity, (n, 2, 2) [m, rad, m/s, rad/s].
        disturbance: Acceleration on top of the commanded one, (n,); zero without offset-free control.
        velocity: Velocity as measured last (n,); NaN where nothing was measured.
        commands: What was planned and commanded so far.
        delay: What is known of the delay after which commands reach the robot.
        speed_reserve: By how much plans stay below limits of velocities, (n,) [m/s, rad/s]; (0,) where they do not.
    """

    time: float
    state: State
    covariance: np.ndarray
    disturbance: np.ndarray
    velocity: np.ndarray
    commands: SentCommands
    delay: DelayEstimate
    speed_reserve: np.ndarray

    def __repr__(self) -> str:
        return f"<Estimate at {self.time:g} s: {self.state}, {self.delay}>"

    @property
    def acts_at(self) -> float:
        """When the next command begins to act [s]."""
        return self.time + self.delay.seconds

    @property
    def applied(self) -> np.ndarray:
        """The acceleration that was commanded last (n,)."""
        return self.commands.last


class Estimator:
    """Estimates state and disturbance.

    State: a Kalman filter for each coordinate, in space for the rotation vector from the predicted attitude to the
    measured one. Its model is the plan, q'' = u + w, with white noise w whose velocity after a sample of length T has
    the deviation sigma T, sigma = 0.2 |u| + 0.01:

        P <- F P F' + Q,  F = [1 T; 0 1],  Q = sigma^2 T [T^2/3 T/2; T/2 1],
        x <- x + K (z - x),  K = P (P + R)^-1,  P <- (I - K) P.

    A coordinate that jumps (grippers close, a blow) is taken as measured: K = I. One that is not measured is predicted:
    K = 0. Without measurement noise the measured state is the estimate.
    Source: Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation (2001), section 6.2.

    Delay: the state in which a command acts follows from the estimate and the accelerations on their way. How long
    they take is given, or found out by `DelayEstimator`.

    Disturbance: an acceleration that is constant over a sample, on top of the commanded one. What the measured velocity
    changed by, less what was commanded, passes a first-order filter: integral action. A base without thrusters has
    none, since nothing can be commanded against it.

    Reserve of speed: measured velocities differ from the plan's where masses are not as described, thrusters fire in
    pulses, or two hands hold one body. A plan that uses all of a limit is then beyond it as often as not. So plans stay
    below limits by c times the error e of the predicted velocity, the largest of late:

        e = max(|v - v_before - integral of the planned acceleration| - 3 sqrt(2) sigma, 0),   sigma that of the noise,
        reserve <- max(c e, 0.95 reserve),   c being `controller.speed_reserve`.
    """

    def __init__(
        self,
        spec: ControllerSpec,
        space: ConfigurationSpace,
        actuated: np.ndarray,
        noise: np.ndarray,
        tick: float,
        finds_delay: bool = True,
    ) -> None:
        """Build the estimator of one task.

        Args:
            spec: The controller's settings.
            space: Configuration space of the robot: how coordinates differ, and how velocities change them.
            actuated: Which velocity coordinates have a force of their own in any stage (n,).
            noise: Standard deviations of the measured coordinates and velocities, (2n,) [m, rad, m/s, rad/s]; if all
                are 0, states are taken as they are measured.
            tick: Length of a tick of the low-level loop [s].
            finds_delay: Whether the delay of commands is estimated if the settings say `auto`; else it is as they give
                it, or 0.
        """
        self._space = space
        self._actuated = actuated
        self._spec = spec
        self._tick = tick
        self._filters = bool(noise.any())
        n = len(noise) // 2
        # covariances of a coordinate and its velocity as they are measured
        self._noise = np.zeros((n, 2, 2))
        self._noise[:, 0, 0] = noise[:n] ** 2
        self._noise[:, 1, 1] = noise[n:] ** 2
        # a delay is a whole number of ticks
        given = 0.0 if spec.delay == "auto" else tick * round(spec.delay / tick)
        self._given_delay = None if finds_delay and spec.delay == "auto" else given
        self._delays = DelayEstimator(noise[n:], actuated, tick, spec.sample_time, spec.horizon)

    def after_measurement(
        self,
        estimate: Estimate | None,
        time: float,
        state: State,
        grippers_moved: bool = False,
        shares_load: bool = False,
        is_loaded: bool = False,
        actuated: np.ndarray | None = None,
    ) -> Estimate:
        """Return the estimate of delay, disturbance and state after a measurement of the state.

        The controller decides from this state, predicted over the delay. Without measurement noise it is the measured
        state, with noise a Kalman filter's.

        Args:
            estimate: That of the sample before; None at the first, before which no control was planned or commanded.
            time: Of the measurement [s].
            state: Measured then. Numbers that are not finite were not measured.
            grippers_moved: Grippers have closed or opened since the sample before. Velocities have jumped, so that
                nothing is learned of the delay, and of how far plans are to stay below limits.
            shares_load: Several grippers hold one body, which cannot do what they are commanded to do differently:
                nothing is learned of the delay.
            is_loaded: Grippers hold something that the low-level law does not know, so that accelerations may differ
                more from the commanded ones.
            actuated: Which velocity coordinates have a force of their own now (n,); by default those that have one in
                any stage. The others have no disturbance, since nothing can be commanded against it.
        """
        if estimate is None:
            return self._first_estimate(time, state)
        is_unexplained = grippers_moved or shares_load
        estimate = replace(
            estimate,
            delay=self._delay_after_measurement(estimate, time, state, is_unexplained, is_loaded),
            speed_reserve=self._speed_reserve_after_measurement(estimate, time, state.v, grippers_moved),
        )
        covariance = estimate.covariance
        disturbance = estimate.disturbance
        if self._spec.offset_free:
            actuated = self._actuated if actuated is None else actuated
            disturbance = np.where(actuated, self._disturbance_after_measurement(estimate, time, state.v), 0.0)
        velocity = state.v
        if self._filters:
            u = self._accelerations_acting(estimate, estimate.time, time)
            state, covariance = self._kalman_update(estimate.state, covariance, u, state)
        return replace(
            estimate, time=time, state=state, covariance=covariance, disturbance=disturbance, velocity=velocity
        )

    def _first_estimate(self, time: float, state: State) -> Estimate:
        """Return the estimate after the first measurement [s], before which nothing was commanded.

        The state is taken as it is measured, so that its covariance is that of the noise. The disturbance is 0. The
        delay is the given one, or is taken as unknown and to be estimated.
        """
        n = len(state.v)
        commands = SentCommands(n, self._tick)
        if self._given_delay is None:
            delay = self._delays.after_measurement(self._delays.first, time, state.v, commands)
        else:
            delay = DelayEstimate(self._given_delay)
        return Estimate(
            time=time,
            state=state,
            covariance=self._noise,
            disturbance=np.zeros(n),
            velocity=state.v,
            commands=commands,
            delay=delay,
            speed_reserve=np.zeros(n * (self._spec.speed_reserve > 0.0)),
        )

    def _delay_after_measurement(
        self, estimate: Estimate, time: float, state: State, is_unexplained: bool, is_loaded: bool
    ) -> DelayEstimate:
        """Return what is known of the delay after a measurement."""
        if self._given_delay is not None:
            return estimate.delay
        delay = self._delays.unsettled(estimate.delay, time) if is_unexplained else estimate.delay
        return self._delays.after_measurement(delay, time, state.v, estimate.commands, is_loaded)

    def _speed_reserve_after_measurement(
        self, estimate: Estimate, time: float, v: np.ndarray, grippers_moved: bool
    ) -> np.ndarray:
        """Return by how much plans are to stay below limits of velocities after v (n,) is measured at a time [s].

        The formula is the class's. Where a measurement is not finite, the reserve decays.
        """
        if not len(estimate.speed_reserve):
            return estimate.speed_reserve
        remaining = RESERVE_DECAY * estimate.speed_reserve
        if grippers_moved:
            return remaining
        planned = self._tick * self._accelerations_acting(estimate, estimate.time, time).sum(axis=0)
        of_noise = SURE * np.sqrt(2 * self._noise[:, 1, 1])  # a difference of two measurements
        error = np.abs(v - estimate.velocity - planned) - of_noise
        return np.asarray(np.fmax(self._spec.speed_reserve * error, remaining))

    def _accelerations_acting(self, estimate: Estimate, begin: float, end: float) -> np.ndarray:
        """Return the planned accelerations that act at the ticks between two times [s], (K, n)."""
        late = estimate.delay.seconds
        return estimate.commands.planned(begin - late, end - late)

    def _kalman_update(self, state: State, P: np.ndarray, u: np.ndarray, measured: State) -> tuple[State, np.ndarray]:
        """Predict the state under planned accelerations, then correct it by a measurement: one step of a Kalman filter.

        Each coordinate has a filter of its own, with its position and its velocity as the state. Measurements so far
        from the prediction that they must come of a jump are taken as they are; what was not measured is predicted.

        Args:
            state: Estimated state at the sample before.
            P: Covariances then (n, 2, 2).
            u: Accelerations that the plan had over the ticks since then (M, n) [m/s^2, rad/s^2].
            measured: Measured state now.

        Returns:
            The estimated state now, and its covariances (n, 2, 2).
        """
        T = self._tick * len(u)
        # white noise of the acceleration with deviation sigma, integrated over T
        share, least = PROCESS_NOISE
        sigma = share * np.abs(u).mean(axis=0) + least
        F = np.array([[1.0, T], [0.0, 1.0]])
        Q = sigma[:, None, None] ** 2 * T * np.array([[T**2 / 3, T / 2], [T / 2, 1.0]])
        predicted = self._after_accelerations(state, u)
        P = F @ P @ F.T + Q

        difference = self._space.difference(predicted.Q, measured.Q)
        innovation = np.column_stack([difference, measured.v - predicted.v])
        is_measured = np.isfinite(innovation).all(axis=1)
        innovation[~is_measured] = 0.0
        S = P + self._noise
        # squared Mahalanobis distance of each coordinate from its prediction
        distance = (innovation * np.linalg.solve(S, innovation[..., None])[..., 0]).sum(axis=1)
        K = np.swapaxes(np.linalg.solve(S, P), 1, 2)  # P S^-1, since both are symmetric
        K[distance > GATE**2] = np.eye(2)
        K[~is_measured] = 0.0

        correction = (K @ innovation[..., None])[..., 0]
        Q_estimated = np.array(self._space.integrate(predicted.Q, correction[:, 0]))
        # Joseph's form, which holds for any gain: K = I leaves the covariance of the measurement.
        remaining = np.eye(2) - K
        P = remaining @ P @ np.swapaxes(remaining, 1, 2) + K @ self._noise @ np.swapaxes(K, 1, 2)
        return State(Q_estimated, predicted.v + correction[:, 1]), P

    def predicted_over_delay(self, estimate: Estimate) -> State:
        """Return the state in which the next command begins to act: the estimate, predicted over the delay.

        The robot accelerates as planned meanwhile: the disturbance adds what was taken off the planned accelerations.

        Args:
            estimate: After the measurement of this sample.
        """
        if estimate.delay.seconds == 0.0:
            return estimate.state
        return self._after_accelerations(
            estimate.state, self._accelerations_acting(estimate, estimate.time, estimate.acts_at)
        )

    def _after_accelerations(self, state: State, u: np.ndarray) -> State:
        """Return the state after accelerations u (M, n) [m/s^2, rad/s^2] that hold for a tick each."""
        Q, v = over_ticks(self._space, state.Q, state.v, u, self._tick)
        return State(Q[-1], v[-1])

    def _disturbance_after_measurement(self, estimate: Estimate, time: float, v: np.ndarray) -> np.ndarray:
        """Return the disturbance (n,) after velocities v (n,) are measured at a time [s].

        d <- d + gain ((v - v_before) / T - mean(commanded) - d). Where a measurement is not finite, d stays.
        """
        d = estimate.disturbance
        late = estimate.delay.seconds
        commanded = estimate.commands.commanded(estimate.time - late, time - late)
        surplus = (v - estimate.velocity) / (self._tick * len(commanded)) - commanded.mean(axis=0)
        filtered = d + self._spec.offset_gain * (surplus - d)
        return np.where(np.isfinite(surplus), filtered, d)

    def command(
        self,
        estimate: Estimate,
        u: np.ndarray,
        changes: np.ndarray | None = None,
        law: LowLevelLaw | None = None,
    ) -> tuple[Estimate, np.ndarray]:
        """Return the accelerations to command for a plan, and the estimate that remembers them as sent.

        The estimated disturbance adds to what is commanded. So it is subtracted from the planned accelerations, and the
        robot accelerates as planned. What is sent is remembered because it explains the velocities to come: delay and
        disturbance are estimated from it.

        Args:
            estimate: After the measurement of this sample.
            u: Accelerations planned over the ticks of the sample (M, n) [m/s^2, rad/s^2].
            changes: By how much accelerations may change to each tick, down and up (2, M, n); None without such limits.
            law: The low-level law that is to apply them.

        Returns:
            The estimate with the command among those that were sent; and the accelerations to command (M, n): the
            planned ones less the disturbance, changed no faster than the limits allow.
        """
        commanded = u - estimate.disturbance
        if changes is not None:
            limited = slew_limited(commanded, estimate.applied, *changes)
            u = u + (limited - commanded)  # what of the plan remains
            commanded = limited
        # commands that acted before this time explain nothing that is still to be measured
        oldest = (
            estimate.time
            - (self._delays.reach if self._given_delay is None else self._spec.sample_time)
            - estimate.delay.seconds
        )
        sent = estimate.commands.after(Sent(estimate.time, u, commanded, law), oldest)
        return replace(estimate, commands=sent), commanded
