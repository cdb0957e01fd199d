"""What a controller knows between measurement and action: the state foreseen over a known delay, and a disturbance."""

from collections import deque

import numpy as np

from psmpc_cli.specs.task import ControllerSpec


class Estimator:
    """Foresees the state over a known delay of c samples, and estimates a disturbance under offset-free control.

    The state in which a command acts follows from the one measured c samples before and the accelerations planned
    since. The disturbance, an acceleration on top of the commanded one, is taken for constant: integral action.

    Attributes:
        d: Estimated disturbance (n,) [m/s^2, rad/s^2]; zero without offset-free control.
    """

    def __init__(self, spec: ControllerSpec, tick: float, n: int) -> None:
        """Start with what is known before the first sample: no control was planned or commanded.

        Args:
            spec: The controller.
            tick: Length of a tick of the low-level loop [s].
            n: Number of coordinates.
        """
        self.spec, self.d = spec, np.zeros(n)
        self._tick, self._v = tick, np.full(n, np.nan)
        none = np.zeros((round(spec.sample_time / tick), n))
        self._planned = deque([none] * spec.known_delay)
        self._commanded = deque([none[0]] * spec.known_delay)
        self._first = True

    def foreseen(self, x: np.ndarray) -> np.ndarray:
        """Return the state [Q; v] (2n,) in which the next command acts.

        The robot has accelerated as planned since: the disturbance adds what was taken off the planned accelerations.

        Args:
            x: State measured now, or known_delay samples before (2n,).
        """
        if not self._planned:
            return x
        n, u = len(self.d), np.vstack(self._planned)
        v = x[n:] + self._tick * np.vstack([np.zeros(n), np.cumsum(u, axis=0)])
        Q = x[:n] + np.sum(self._tick * v[:-1] + self._tick**2 / 2 * u, axis=0)
        return np.concatenate([Q, v[-1]])

    def command(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the accelerations to command in a sample (M, n), the disturbance taken off the planned ones.

        What the velocity changed by over the last sample that was measured, less what was commanded in it, passes a
        first-order filter, d + gain ((v - v_before) / T_s - u - d). Where a measurement is not finite, d stays.

        Args:
            u: Accelerations planned over its ticks (M, n) [m/s^2, rad/s^2].
            v: Velocity measured last (n,) [m/s, rad/s]: now, or known_delay samples before.
        """
        if self._planned:
            self._planned.popleft()
            self._planned.append(u)
        if not self.spec.offset_free:
            return u
        if not self._first:
            surplus = (v - self._v) / self.spec.sample_time - self._commanded.popleft()
            filtered = self.d + self.spec.offset_gain * (surplus - self.d)
            self.d = np.where(np.isfinite(surplus), filtered, self.d)
        self._first, self._v = False, v
        self._commanded.append((u - self.d).mean(axis=0))
        return u - self.d
