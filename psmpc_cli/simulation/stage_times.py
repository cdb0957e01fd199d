"""When the stages ended and started, kept up to date record by record."""

import numpy as np

from psmpc_cli.logs.record import Record
from psmpc_cli.logs.write import StageTimes


class StageClock:
    """Follows switching instants and actual starts. Section "what is measured" of docs/formulation.md.

    The actual start of a stage is the first sample at which its presence in the control reaches a threshold; a stage
    that never does so before its time starts at the instant that ends the stage before it.
    """

    def __init__(self, stages: int, epsilon: float, series: tuple[float, ...]) -> None:
        self.epsilon, self.series = epsilon, series
        self.switch_time = np.full(stages, np.nan)
        self._early = np.full((stages, len(series) + 1), np.nan)  # the default threshold stands last

    def update(self, record: Record) -> bool:
        """Take in one record; return whether anything changed."""
        return self.note(record.time, record.switches, record.presence)

    def note(self, time: float, switches: tuple[tuple[int, float], ...], presence: dict[int, float]) -> bool:
        """Take in the hand-overs and the presences at a sample [s]; return whether anything changed."""
        self.hand_over(switches)
        thresholds, changed = np.array([*self.series, self.epsilon]), bool(switches)
        for stage, found in presence.items():
            starts = (found >= thresholds) & np.isnan(self._early[stage])
            self._early[stage, starts] = time
            changed |= bool(starts.any())
        return changed

    def hand_over(self, switches: tuple[tuple[int, float], ...]) -> None:
        """Take in the instants that ended stages."""
        for stage, time in switches:
            self.switch_time[stage] = time

    @property
    def times(self) -> StageTimes:
        """The times as known so far."""
        regular = np.r_[0.0, self.switch_time[:-1]]
        starts = np.where(np.isnan(self._early), regular[:, None], self._early)
        return StageTimes(
            switch_time=self.switch_time.copy(),
            actual_start=starts[:, -1],
            premature=~np.isnan(self._early[:, -1]),
            by_epsilon=starts[:, :-1],
        )
