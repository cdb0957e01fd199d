"""The delay after which commands reach the robot, found out from what was commanded and the velocities measured since.

docs/uncertainty_model.md, section "Delays".
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from psmpc_cli.robot.low_level import LowLevelLaw

LONGEST = 1.0
"""The longest delay that is found out [s]."""

STEP = 0.01
"""Distance of the delays that are compared first [s]; then all whole ticks are that are this near the best of them."""

BLOCK = 10
"""Samples whose velocities are explained together, from one velocity at their beginning on."""

GAIN = 0.1
"""Deviation of the entries of the gain matrix from those of the identity, one sigma [1].

Masses and inertias that are wrong by 10 % change accelerations by so much, and couple coordinates.
"""

GAIN_WITH_LOAD = 0.5
"""The same while grippers hold what the low-level law does not know."""

WALK = 5e-3, 1e-4
"""Deviation of accelerations that nothing explains, drawn anew at every sample: a share of those commanded, plus
[m/s^2, rad/s^2]."""

NOISIER = 2.0
"""Where squares are this much larger than their variances velocities are noisier than declared: their noise is what the
best delay leaves of them."""

FLOOR = 1e-6
"""Least deviation of a measured velocity [m/s, rad/s]."""

PRIOR = 0.2
"""A delay that is longer by so much [s] is less likely by one e-fold before anything is measured."""

MARGIN = 2.0
"""By how much more likely another delay must be to take the place of the one in force, as a logarithm: 2 sigma."""

DEPTH = 100.0
"""How much earlier samples count at most, as a logarithm, so that a delay that changes is followed."""

SURE = 2e-3
"""A delay known so well [s] is compared with others once a block only, and with fewer of those that are far off."""

FEWER = 5
"""By how many times fewer."""

SETTLING = 0.5
"""For how long after grippers close or open velocities are not looked at [s]: grasps give in, and swing."""


class Sent(NamedTuple):
    """A command that was sent.

    Attributes:
        time: When it was sent [s].
        planned: Accelerations of the plan over its ticks (M, n) [m/s^2, rad/s^2].
        commanded: Those commanded: less the estimated disturbance (M, n).
        law: The low-level law that applies them, with what it then counts with.
    """

    time: float
    planned: np.ndarray
    commanded: np.ndarray
    law: LowLevelLaw | None = None


class Acting(NamedTuple):
    """What acted of one command between two times.

    Attributes:
        share: For which share of the time.
        u: Mean of the accelerations that were commanded (n,) [m/s^2, rad/s^2].
        law: The law that applied them; None of a robot that waits for its first command.
    """

    share: float
    u: np.ndarray
    law: LowLevelLaw | None


@dataclass(frozen=True, eq=False)
class SentCommands:
    """The last commands, the oldest first.

    A command counts until the next one arrives; its last acceleration holds where that one is late. Before the first
    one the accelerations are 0.

    Attributes:
        n: Number of velocities.
        tick: Length of a tick of the low-level loop [s].
        sent: The commands.
    """

    n: int
    tick: float
    sent: tuple[Sent, ...] = ()

    def __repr__(self) -> str:
        times = f" from {self.sent[0].time:g} s to {self.sent[-1].time:g} s" if self.sent else ""
        return f"<SentCommands: {len(self.sent)}{times}, ticks of {self.tick:g} s>"

    def after(self, command: Sent, oldest: float) -> "SentCommands":
        """Return the commands with another one, without those that no longer count at the time `oldest` [s]."""
        kept = tuple(one for one, next_one in zip(self.sent, self.sent[1:], strict=False) if next_one.time > oldest)
        return SentCommands(self.n, self.tick, (*kept, *self.sent[-1:], command))

    @property
    def last(self) -> np.ndarray:
        """The last commanded acceleration (n,)."""
        return self.sent[-1].commanded[-1] if self.sent else np.zeros(self.n)

    def planned(self, begin: float, end: float) -> np.ndarray:
        """Return the planned accelerations at the ticks between two times at which they were sent [s], (K, n)."""
        return self._between(begin, end, [one.planned for one in self.sent])

    def commanded(self, begin: float, end: float) -> np.ndarray:
        """Return the commanded accelerations at the ticks between two times at which they were sent [s], (K, n)."""
        return self._between(begin, end, [one.commanded for one in self.sent])

    def acting(self, begin: float, end: float) -> Iterator[Acting]:
        """Yield what acted of each command at the ticks between two times at which they were sent [s]."""
        commanded = self.commanded(begin, end)
        middles = begin + self.tick * (np.arange(len(commanded)) + 0.5)
        which = np.searchsorted([one.time for one in self.sent], middles, side="right") - 1
        for number in np.unique(which):
            ticks = which == number
            law = self.sent[number].law if number >= 0 else None
            yield Acting(float(ticks.mean()), commanded[ticks].mean(axis=0), law)

    def _between(self, begin: float, end: float, rows: list[np.ndarray]) -> np.ndarray:
        count = round((end - begin) / self.tick)
        if not rows:
            return np.zeros((count, self.n))
        middles = begin + self.tick * (np.arange(count) + 0.5)
        starts = np.array([one.time for one in self.sent])
        lengths = np.array([len(each) for each in rows])
        which = np.searchsorted(starts, middles, side="right") - 1
        tick = np.minimum(((middles - starts[which]) / self.tick).astype(int), lengths[which] - 1)
        first = np.cumsum(lengths) - lengths
        commanded = np.concatenate(rows)[np.where(which < 0, 0, first[which] + tick)]
        commanded[which < 0] = 0.0
        return commanded


@dataclass(frozen=True, eq=False)
class DelayEstimate:
    """What is known of the delay.

    Attributes:
        seconds: The delay that the controller counts with [s].
        deviation: Its standard deviation [s]; 0 of a delay that is given, infinite before anything tells of it.
        evidence: Logarithm of the likelihood of each delay of a whole number of ticks, by blocks that are over, (D,).
        times, velocities: Of the measurements of the block that is under way, (K,) [s] and (K, n) [m/s, rad/s].
        settled_at: Before this time nothing is looked at [s].
    """

    seconds: float
    deviation: float = 0.0
    evidence: np.ndarray = field(default_factory=lambda: np.zeros(0))
    times: tuple[float, ...] = ()
    velocities: tuple[np.ndarray, ...] = ()
    settled_at: float = -np.inf

    def __repr__(self) -> str:
        return f"<DelayEstimate: {self.seconds:.4g} s, deviation {self.deviation:.2g} s>"


class DelayEstimator:
    """Finds out after which delay commands reach the robot.

    Levels of the velocity since the beginning of a block of samples are compared with what each delay d explains:

        v(t_k) - v(t_0) = G s_k(d) + noise,   s_k(d) = integral of the commanded u(t - d) from t_0 to t_k.

    The gain matrix G is integrated out, its entries normal about those of the identity: masses that are wrong couple
    coordinates. Noise is that of both measurements and a random walk for what nothing explains; where the best delay
    leaves more than that, the likelihoods count as much less. Phases of constant acceleration tell nothing, changes of
    the command do.

    Args:
        noise: Standard deviations of measured velocities (n,) [m/s, rad/s].
        acted_on: Which velocities commands act on (n,): not those of a base without thrusters.
        tick: Length of a tick [s]; the delay is a whole number of them.
        sample_time: Time between two samples [s].
        largest: Delays are less than this [s].
    """

    def __init__(
        self, noise: np.ndarray, acted_on: np.ndarray, tick: float, sample_time: float, largest: float
    ) -> None:
        self._noise = np.maximum(noise[acted_on], FLOOR)
        self._acted_on = acted_on
        self._tick = tick
        self._sample_time = sample_time
        self._delays = tick * np.arange(max(round(min(LONGEST, largest - sample_time) / tick), 1) + 1)
        self._stride = max(round(STEP / tick), 1)

    @property
    def reach(self) -> float:
        """For how long what was commanded is needed [s]."""
        return float(self._delays[-1]) + (BLOCK + 1) * self._sample_time

    @property
    def first(self) -> DelayEstimate:
        """What is known before the first measurement: nothing, so that no delay is counted with."""
        return DelayEstimate(0.0, np.inf, np.zeros(len(self._delays)))

    def after_measurement(
        self, estimate: DelayEstimate, time: float, v: np.ndarray, commands: SentCommands, is_loaded: bool = False
    ) -> DelayEstimate:
        """Return the estimate of the delay of commands after velocities were measured.

        Measurements are collected in blocks of `BLOCK` samples. The velocities of a block are compared with those to
        which the commands would have led under each delay. What a block has told is added to the *evidence*, the
        log-likelihood of each delay, once the block is complete. Until then the block under way counts on top of it,
        anew at every sample; but if the delay is well known already, it is looked at only when it is complete.

        Args:
            estimate: That of the sample before.
            time: Of the measurement [s].
            v: Measured velocities (n,) [m/s, rad/s]; if one of them is not finite, the measurement is left out.
            commands: What was commanded so far.
            is_loaded: Grippers hold something that the low-level law does not know.
        """
        v = v[self._acted_on]
        if time < estimate.settled_at or not np.isfinite(v).all():
            return estimate
        times = (*estimate.times, time)
        velocities = (*estimate.velocities, v)
        is_complete = len(times) > BLOCK  # the first measurement of a block is the last of the block before
        estimate = replace(estimate, times=times, velocities=velocities)
        is_sure = estimate.deviation <= SURE
        if len(times) == 1 or (is_sure and not is_complete):
            return estimate
        log_likelihoods = self._log_likelihoods_of_block(
            times=np.array(times),
            v=np.array(velocities),
            commands=commands,
            is_loaded=is_loaded,
            stride=self._stride * (FEWER if is_sure else 1),
            in_force=round(estimate.seconds / self._tick),
        )
        evidence = estimate.evidence
        if log_likelihoods is not None:
            total = evidence + log_likelihoods
            estimate = self._with_most_likely_delay(estimate, total)
            # no delay is ruled out for ever, because the true one may change
            evidence = np.maximum(total - total.max(), -DEPTH)
        if is_complete:
            estimate = replace(estimate, evidence=evidence, times=times[-1:], velocities=velocities[-1:])
        return estimate

    def unsettled(self, estimate: DelayEstimate, time: float) -> DelayEstimate:
        """Return the estimate without the block under way, since commands do not explain velocities at a time [s].

        Grippers that close make velocities jump, and several grippers that hold one body are a closed chain.
        """
        return replace(estimate, times=(), velocities=(), settled_at=time + SETTLING)

    def _log_likelihoods_of_block(
        self, times: np.ndarray, v: np.ndarray, commands: SentCommands, is_loaded: bool, stride: int, in_force: int
    ) -> np.ndarray | None:
        """Return the log-likelihood of each of D delays, by the measurements of one block.

        `DelayEstimator` has the model. The likelihood of a delay is that of the measured changes of velocity, given
        those to which the commands led if they arrived so much later. It is computed for delays that are a stride
        apart, and for all near the delay in force and near the most likely one; between others it is interpolated. If
        the model explains velocities much worse than their noise allows, log-likelihoods are scaled down.

        Args:
            times: Of the measurements (K + 1,) [s].
            v: Measured velocities on which commands act (K + 1, n) [m/s, rad/s].
            commands: What was commanded so far.
            is_loaded: Grippers hold something that the low-level law does not know.
            stride: Distance of the delays that are compared first [ticks].
            in_force: The delay that the controller counts with [ticks].

        Returns:
            The log-likelihoods of delays of 0, 1, ... ticks (D,); None if nothing was commanded, which tells nothing.
        """
        begin = times[0] - self._delays[-1]
        u = commands.commanded(begin, times[-1])[:, self._acted_on]
        if not u.any():
            return None
        # what commands add to the velocity until the end of each tick
        summed = np.vstack([np.zeros(u.shape[1]), self._tick * np.cumsum(u, axis=0)])
        gain = GAIN_WITH_LOAD if is_loaded else GAIN
        share, least = WALK
        walk = (share * np.sqrt((u**2).mean()) + least) * self._sample_time

        def commanded_velocities(delays: np.ndarray) -> np.ndarray:
            ticks = np.rint((times - self._delays[delays, None] - begin) / self._tick).astype(int)
            return np.asarray(summed[np.clip(ticks, 0, len(u))])

        first = np.union1d(np.arange(0, len(self._delays), stride), self._delays_within_stride(in_force))
        model = _VelocityModel(v, gain, walk, self._noise)
        best, log_likelihoods, surplus = self._refine_about_most_likely(first, commanded_velocities, model)
        if surplus > NOISIER:
            model = model.with_noise_of(commanded_velocities(np.array([best])))
            _, log_likelihoods, surplus = self._refine_about_most_likely(first, commanded_velocities, model)
        return np.asarray(log_likelihoods / max(1.0, surplus))

    def _refine_about_most_likely(
        self, first: np.ndarray, commanded_velocities: Callable[[np.ndarray], np.ndarray], model: "_VelocityModel"
    ) -> tuple[int, np.ndarray, float]:
        """Find the most likely delay: compare some delays, then all near the best of them, until it stays the best.

        Delays are numbers of ticks.

        Args:
            first: Delays that are compared at first.
            commanded_velocities: Delays (D,) -> velocities to which the commands lead under each of them (D, K + 1, n).
            model: Says how likely the measured velocities are, given these.

        Returns:
            The most likely delay; the log-likelihoods of all delays (D,), interpolated between those that were
            compared; and the mean square of what the most likely delay leaves unexplained, over its variance: 1 if the
            noise is as declared.
        """
        every = np.arange(len(self._delays))
        log_likelihoods = np.full(len(every), -np.inf)
        squares = np.zeros(len(every))
        wanted = first
        while len(wanted):
            log_likelihoods[wanted], squares[wanted] = model.log_likelihoods_under(commanded_velocities(wanted))
            best = int(np.argmax(log_likelihoods))
            # it is the highest nearby if both of its neighbours were compared, too
            is_highest = np.isfinite(log_likelihoods[max(best - 1, 0) : best + 2]).all()
            wanted = every[:0] if is_highest else self._delays_within_stride(best)
        known = np.flatnonzero(np.isfinite(log_likelihoods))
        return best, np.interp(every, known, log_likelihoods[known]), float(squares[best]) / model.v[1:].size

    def _delays_within_stride(self, delay: int) -> np.ndarray:
        """Return the delays that are near one, all in ticks."""
        return np.arange(max(delay - self._stride, 0), min(delay + self._stride + 1, len(self._delays)))

    def _with_most_likely_delay(self, estimate: DelayEstimate, evidence: np.ndarray) -> DelayEstimate:
        """Return the estimate with the most likely delay, where it is clearly more likely than the one in force."""
        likely = evidence - self._delays / PRIOR
        best = int(np.argmax(likely))
        weights = np.exp(likely - likely[best])
        weights /= weights.sum()
        variance = float(weights @ (self._delays - weights @ self._delays) ** 2) + self._tick**2 / 12
        deviation = float(np.sqrt(variance))
        in_force = round(estimate.seconds / self._tick)
        if likely[best] - likely[in_force] < MARGIN:
            return replace(estimate, deviation=deviation)
        least = in_force - round(self._sample_time / (2 * self._tick))  # so that time goes on for the plans
        return replace(estimate, seconds=self._tick * max(best, least), deviation=deviation)


@dataclass(frozen=True, eq=False)
class _VelocityModel:
    """How measured velocities of a block differ from those to which commands lead.

    Attributes:
        v: The velocities (K + 1, n).
        gain: Standard deviation of the entries of the gain matrix.
        walk: That of what a velocity changes by from one to the next unexplained.
        noise: Standard deviations of v (n,).
    """

    v: np.ndarray
    gain: float
    walk: float
    noise: np.ndarray

    def log_likelihoods_under(self, commanded_velocities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how likely the measured velocities are under each of D delays of the commands.

        The measured changes of velocity since the block's beginning, less the commanded ones s, are normal with the
        covariance gain^2 s s' + that of noise and random walk; gain^2 s s' is what an unknown gain of the commands
        adds. With the Cholesky factor L of the covariance and the residual r, the log-likelihood is

            -|L^-1 r|^2 / 2 - log det L + constant.

        Args:
            commanded_velocities: Velocities to which the commands lead (D, K + 1, n), up to a constant.

        Returns:
            Log-likelihoods up to a constant (D,), and the sums of squares |L^-1 r|^2 (D,).
        """
        s, residual = self._residual(commanded_velocities)
        squares = np.zeros(len(s))
        logarithms = np.zeros(len(s))
        for rows, unexplained in self._unexplained():
            factor = np.linalg.cholesky(self.gain**2 * s @ np.swapaxes(s, 1, 2) + unexplained)
            squares += (np.linalg.solve(factor, residual[:, :, rows]) ** 2).sum(axis=(1, 2))
            logarithms += rows.sum() * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return -squares / 2 - logarithms, squares

    def with_noise_of(self, commanded_velocities: np.ndarray) -> "_VelocityModel":
        """Return the model with the noise that is left where commands lead to velocities (1, K + 1, n)."""
        s, residual = self._residual(commanded_velocities)
        noise = self.noise.copy()
        for rows, unexplained in self._unexplained():
            covariance = self.gain**2 * s[0] @ s[0].T + unexplained
            left = unexplained @ np.linalg.solve(covariance, residual[0][:, rows])
            noise[rows] = max(noise[rows][0], np.sqrt((left**2).mean() / 2))
        return replace(self, noise=noise)

    def _residual(self, commanded_velocities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the changes of velocity that commands lead to (D, K, n), and those measured less these."""
        s = commanded_velocities[:, 1:] - commanded_velocities[:, :1]
        return s, self.v[1:] - self.v[0] - s

    def _unexplained(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield coordinates of one noise (n,), and the covariance of what commands do not explain of them (K, K)."""
        since = np.arange(1, len(self.v))
        of_walk = self.walk**2 * np.minimum(since, since[:, None])
        for deviation in np.unique(self.noise):
            yield self.noise == deviation, of_walk + deviation**2 * (np.eye(len(since)) + 1)
