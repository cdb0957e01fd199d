"""The state that a controller decides from: filtered measurements, foreseen over a known delay; and a disturbance."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.interface import State
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.motion import over_ticks
from psmpc_cli.specs.task import ControllerSpec

PROCESS_NOISE = 0.2, 0.01
"""How far the robot's acceleration is from the planned one, one sigma: a share of it, plus [m/s^2, rad/s^2].

Masses that are wrong by 10 % and a payload of a tenth of the robot's mass change accelerations by a fifth; the rest is
friction, and what holds the estimate open for new measurements while nothing moves.
"""

GATE = 5.0
"""A coordinate whose measurement is this many sigma from its prediction has jumped: its estimate starts anew."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of the robot from the measurements so far.

    Attributes:
        state: Estimated state at the time of the last measurement.
        covariance: Of the error of each coordinate and its velocity, (n, 2, 2) [m, rad, m/s, rad/s].
        planned: Accelerations planned over each sample since the last measurement but one, the oldest first, (M, n)
            each [m/s^2, rad/s^2].
        disturbance: Acceleration on top of the commanded one, (n,); zero without offset-free control.
        velocity: Velocity as measured last (n,), now or over a known delay ago; NaN before the first measurement.
        commanded: Mean accelerations commanded over each sample since the one before `velocity`'s, (n,) each.
    """

    state: State
    covariance: np.ndarray
    planned: tuple[np.ndarray, ...]
    disturbance: np.ndarray
    velocity: np.ndarray
    commanded: tuple[np.ndarray, ...]


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

    Delay: the state in which a command acts follows from the estimate and the accelerations planned since.

    Disturbance: an acceleration that is constant over a sample, on top of the commanded one. What the measured velocity
    changed by, less what was commanded, passes a first-order filter: integral action. A base without thrusters has
    none, since nothing can be commanded against it.

    Args:
        spec: The controller.
        space: Of the robot.
        actuated: Which of its velocity coordinates have a force of their own (n,).
        noise: Standard deviations of the measured coordinates and velocities, (2n,) [m, rad, m/s, rad/s].
        tick: Length of a tick of the low-level loop [s].
    """

    def __init__(
        self,
        spec: ControllerSpec,
        space: ConfigurationSpace,
        actuated: np.ndarray,
        noise: np.ndarray,
        tick: float,
    ) -> None:
        self._space = space
        self._actuated = actuated
        self._spec = spec
        self._tick = tick
        self._filters = bool(noise.any())
        n = len(noise) // 2
        self._noise = np.zeros((n, 2, 2))
        self._noise[:, 0, 0] = noise[:n] ** 2
        self._noise[:, 1, 1] = noise[n:] ** 2

    def measured(self, estimate: Estimate | None, state: State) -> Estimate:
        """Return the estimate after a measurement.

        Args:
            estimate: That of the sample before; None at the first, before which no control was planned or commanded.
            state: Measured now, or `known_delay` samples before. What is not finite is not measured.
        """
        if estimate is None:
            return self._begun(state)
        if not self._filters:
            return replace(estimate, state=state)
        filtered, covariance = self._filtered(estimate.state, estimate.covariance, estimate.planned[0], state)
        return replace(estimate, state=filtered, covariance=covariance)

    def _begun(self, state: State) -> Estimate:
        """Return the estimate after the first measurement, before which nothing was commanded.

        The state is taken as measured, so its covariance is that of the noise. There is no earlier velocity to compare
        with. Accelerations of this sample, and of those in which a command is on its way, are zero: planned ones tick
        by tick, commanded ones by their means.
        """
        n = len(state.v)
        at_rest = np.zeros((round(self._spec.sample_time / self._tick), n))
        samples = self._spec.known_delay + 1
        return Estimate(
            state=state,
            covariance=self._noise,
            planned=(at_rest,) * samples,
            disturbance=np.zeros(n),
            velocity=np.full(n, np.nan),
            commanded=(at_rest[0],) * samples,
        )

    def _filtered(self, state: State, P: np.ndarray, u: np.ndarray, measured: State) -> tuple[State, np.ndarray]:
        """Return state and covariance after a sample under planned accelerations u (M, n) and a measurement."""
        T = self._spec.sample_time
        share, least = PROCESS_NOISE
        sigma = share * np.abs(u).mean(axis=0) + least
        F = np.array([[1.0, T], [0.0, 1.0]])
        Q = sigma[:, None, None] ** 2 * T * np.array([[T**2 / 3, T / 2], [T / 2, 1.0]])
        predicted = self._advanced(state, u)
        P = F @ P @ F.T + Q

        difference = self._space.difference(predicted.Q, measured.Q)
        innovation = np.column_stack([difference, measured.v - predicted.v])
        is_measured = np.isfinite(innovation).all(axis=1)
        innovation[~is_measured] = 0.0
        S = P + self._noise
        distance = (innovation * np.linalg.solve(S, innovation[..., None])[..., 0]).sum(axis=1)
        K = np.swapaxes(np.linalg.solve(S, P), 1, 2)
        K[distance > GATE**2] = np.eye(2)
        K[~is_measured] = 0.0

        correction = (K @ innovation[..., None])[..., 0]
        Q_estimated = np.array(self._space.integrate(predicted.Q, correction[:, 0]))
        # Joseph's form, which holds for any gain: K = I leaves the covariance of the measurement.
        remaining = np.eye(2) - K
        P = remaining @ P @ np.swapaxes(remaining, 1, 2) + K @ self._noise @ np.swapaxes(K, 1, 2)
        return State(Q_estimated, predicted.v + correction[:, 1]), P

    def foreseen(self, estimate: Estimate) -> State:
        """Return the state in which the next command acts.

        The robot accelerates as planned meanwhile: the disturbance adds what was taken off the planned accelerations.

        Args:
            estimate: After the measurement of this sample.
        """
        since = estimate.planned[1:]
        return self._advanced(estimate.state, np.vstack(since)) if since else estimate.state

    def _advanced(self, state: State, u: np.ndarray) -> State:
        """Return the state after accelerations u (M, n) [m/s^2, rad/s^2] that hold for a tick each."""
        Q, v = over_ticks(self._space, state.Q, state.v, u, self._tick)
        return State(Q[-1], v[-1])

    def command(self, estimate: Estimate, u: np.ndarray, v: np.ndarray) -> tuple[Estimate, np.ndarray]:
        """Return the estimate after a decision, and the accelerations to command (M, n): less the disturbance.

        d <- d + gain ((v - v_before) / T - mean(commanded) - d). Where a measurement is not finite, d stays.

        Args:
            estimate: After the measurement of this sample.
            u: Accelerations planned over the ticks of the sample (M, n) [m/s^2, rad/s^2].
            v: Velocity measured last (n,) [m/s, rad/s]: now, or `known_delay` samples before.
        """
        d = estimate.disturbance
        if self._spec.offset_free:
            surplus = (v - estimate.velocity) / self._spec.sample_time - estimate.commanded[0]
            filtered = d + self._spec.offset_gain * (surplus - d)
            d = np.where(np.isfinite(surplus) & self._actuated, filtered, d)
        commanded = u - d
        after = replace(
            estimate,
            planned=(*estimate.planned[1:], u),
            disturbance=d,
            velocity=v,
            commanded=(*estimate.commanded[1:], commanded.mean(axis=0)),
        )
        return after, commanded
