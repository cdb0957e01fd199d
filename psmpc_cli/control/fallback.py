"""The plan that is applied at a sample: the solved one, else the one before it, else one that brakes."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.plan import Plan, braking_plan
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.robot.motion import braking_under_jerk
from psmpc_cli.specs.robots.robot import Limits

BRAKING_TIME = 0.5
"""Time within which a robot without a plan comes to rest [s], longer where limits of acceleration or jerk need it."""


@dataclass(frozen=True, eq=False)
class PlansInForce:
    """The plans that outlast a sample.

    Attributes:
        solved: The last plan that was solved for, or that took the place of the first one; None before.
        braking: The plan that brakes to rest, where the other is used up.
        trusted_until: How far the solved plan may be followed [s]: to its end when the state was last measured
            completely, or to where it ends a stage that the object has to end.
        sequence: The stages of the solved plan; None before.
    """

    solved: Plan | None = None
    braking: Plan | None = None
    trusted_until: float = np.inf
    sequence: MovingSequence | None = None

    @property
    def current(self) -> Plan | None:
        """The plan in force; None before the first."""
        return self.solved if self.braking is None else self.braking

    @property
    def is_solved(self) -> bool:
        """Whether the plan in force came of a solve: others are of few intervals, at whose ends accelerations jump."""
        return self.braking is None and self.sequence is not None

    def in_chart(self, chart: Chart) -> "PlansInForce":
        """Return the plans in another chart."""
        solved = None if self.solved is None else self.solved.in_chart(chart)
        braking = None if self.braking is None else self.braking.in_chart(chart)
        return replace(self, solved=solved, braking=braking)

    def expires_before_next(self, time: float, sample_time: float) -> bool:
        """Tell whether the solved plan, or the trust in it, ends before the next sample."""
        end = np.inf if self.solved is None else self.solved.end
        return time > min(end, self.trusted_until) - sample_time

    def on_success(self, plan: Plan, sequence: MovingSequence) -> "PlansInForce":
        """Return the plans after a sample whose solve for these stages succeeded."""
        return replace(self, solved=plan, braking=None, sequence=sequence)

    def trusted_to_end_of(self, stage: int) -> "PlansInForce":
        """Return the plans with the solved one trusted no further than to where it ends a stage, if it does."""
        if self.sequence is None:
            return self
        ends = self.sequence.switch_times[stage - self.sequence.first :]
        if not len(ends):
            return self
        return replace(self, trusted_until=min(self.trusted_until, float(ends[0])))

    def on_failure(
        self,
        time: float,
        x: np.ndarray,
        limits: Limits,
        horizon: float,
        sample_time: float,
        chart: Chart,
        brakes: np.ndarray,
        applied: np.ndarray,
    ) -> tuple["PlansInForce", Plan]:
        """Return the plans after a sample whose solves have failed, and the plan that is applied.

        The last solved plan goes on, shifted in time, until it is used up. Then a plan takes over that brakes the robot
        to rest. If no solve has succeeded yet, the robot brakes at once and rests until the end of the horizon, and
        that counts as the solved plan, while every sample tries again.

        Braking takes `BRAKING_TIME`, or longer where limits need it. A coordinate whose acceleration first falls from
        what is applied now, a, to 0 with the jerk j changes its velocity v to |v| + |a| (|a| / j) / 2 at most. To
        brake from that takes this velocity over the largest acceleration; and, with ramps of the acceleration at both
        ends, twice the time |a| / j + sqrt(velocity / j).

        Args:
            time: Of the sample [s].
            x: Measured state (2n,).
            limits: Of the current stage.
            horizon: T_h [s].
            sample_time: Time between two samples [s].
            chart: The chart of x.
            brakes: Which coordinates can brake (n,): not those of a base without thrusters.
            applied: Acceleration that was commanded last (n,).
        """
        strongest = np.minimum(limits.acceleration_high, -limits.acceleration_low)
        steepest = np.minimum(limits.jerk_high, -limits.jerk_low)
        v = x[len(x) // 2 :]
        ramp_time = np.abs(applied) / steepest
        to_brake = np.abs(v) + np.abs(applied) * ramp_time / 2
        least_times = np.maximum(to_brake / strongest, 2 * (ramp_time + np.sqrt(to_brake / steepest)))[brakes]
        duration = max(BRAKING_TIME, float(np.max(least_times, initial=0.0)))
        u = braking_under_jerk(v, duration, applied, limits.jerk_low, limits.jerk_high)
        if self.solved is None:
            first = braking_plan(time, x, duration, horizon, chart=chart, brakes=brakes, u=u)
            return replace(self, solved=first), first
        if self.braking is not None:
            return self, self.braking
        if self.expires_before_next(time, sample_time):
            braking = braking_plan(time, x, duration, chart=chart, brakes=brakes, u=u)
            return replace(self, braking=braking), braking
        return self, self.solved

    def fully_trusted(self) -> "PlansInForce":
        """Return the plans after a sample that measured all of the state: the current one is trusted to its end."""
        if self.braking is not None or self.solved is None:
            return self
        return replace(self, trusted_until=self.solved.end)
