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
        """Return the plans after a sample without a solution, and the one that is applied.

        The shifted plan goes on until it is used up; then, and where there is none yet, the robot brakes. In place of
        a first plan it rests until the end of the horizon, while every sample tries again.

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
        ramp = np.abs(applied) / steepest  # time in which what is applied vanishes
        to_brake = np.abs(v) + np.abs(applied) * ramp / 2
        at_least = np.maximum(to_brake / strongest, 2 * (ramp + np.sqrt(to_brake / steepest)))[brakes]
        duration = max(BRAKING_TIME, float(np.max(at_least, initial=0.0)))
        u = braking_under_jerk(v, duration, applied, limits.jerk_low, limits.jerk_high)
        if self.solved is None:
            first = braking_plan(time, x, duration, horizon, chart, brakes, u)
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
