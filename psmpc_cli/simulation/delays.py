"""What is under way between controller and robot: controls that are late, and what is known of the delay.

A controller that knows of a delay of c samples decides c samples ahead: from the state in which its control will act,
foreseen from the one measured and the accelerations planned since. Time here is that at which the control acts, so the
state that it decides from at sample k was measured at k - c. What is late beyond that waits here.
"""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.offset_free import Offset
from psmpc_cli.plant.ideal import double_integrator
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Delays:
    """What is under way before a sample.

    Attributes:
        tick: Of the low-level loop [s].
        late: Accelerations decided that have not reached the robot (M, n) each; as many as samples nobody knows of.
        measured: The states measured at the last c samples (2n,), the oldest first.
        planned: The accelerations that the plans had over those samples (M, n).
    """

    tick: float
    late: tuple[np.ndarray, ...]
    measured: tuple[np.ndarray, ...]
    planned: tuple[np.ndarray, ...]

    @classmethod
    def at_start(cls, task: TaskSpec, x0: np.ndarray) -> "Delays":
        """Return that of a run before its first sample: the robot drifts into its initial state x0 (2n,), as is known.

        Controls that nobody knows to be late are awaited without any; those foreseen were decided in time.
        """
        n, tick, known = len(x0) // 2, 1 / task.plant.low_level_rate, task.controller.known_delay
        drift = task.controller.sample_time * np.concatenate([x0[n:], np.zeros(n)])
        none = np.zeros((round(task.controller.sample_time * task.plant.low_level_rate), n))
        measured = tuple(x0 - back * drift for back in range(known, 0, -1))
        return cls(tick, (none,) * (task.uncertainty.delay - known), measured, (none,) * known)

    def told(self, measured: np.ndarray) -> np.ndarray:
        """Return the measured state (2n,) behind a decision where this one is measured now."""
        return self.measured[0] if self.measured else measured

    def foreseen(self, measured: np.ndarray) -> np.ndarray:
        """Return the state (2n,) to decide from where this one is measured now; itself where no delay is known."""
        if not self.measured:
            return measured
        return np.asarray(double_integrator(self.measured[0], np.vstack(self.planned), self.tick)[-1])

    def after(self, measured: np.ndarray, commanded: np.ndarray, offset: Offset | None) -> tuple[np.ndarray, "Delays"]:
        """Return the accelerations (M, n) that reach the robot in a sample, and what is under way after it.

        Args:
            measured: State measured at the sample (2n,).
            commanded: Accelerations decided for it (M, n).
            offset: The disturbance that was taken off them, which is expected to come on top again; None without one.
        """
        u, *late = *self.late, commanded
        if not self.measured:
            return u, Delays(self.tick, tuple(late), (), ())
        planned = commanded if offset is None else commanded + offset.d
        return u, Delays(self.tick, tuple(late), (*self.measured[1:], measured), (*self.planned[1:], planned))
