"""What a sweep keeps of a closed loop, taken in sample by sample."""

from collections.abc import Mapping

import numpy as np

from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.loop import Ending
from psmpc_cli.simulation.measures import StageClock
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.simulation.smoothness import by_group
from psmpc_cli.specs.coordinates import labels

Values = Mapping[str, np.ndarray | float | int | str]


class Tally:
    """Follows a run up to the end of the studied stage; `over` says that it has come."""

    def __init__(self, stages: int, studied: int, epsilon: float, series: tuple[float, ...], n: int) -> None:
        self.studied = studied
        self.clock = StageClock(stages, epsilon, series)
        self.over = False
        self.x_end = np.full(2 * n, np.nan)
        self.stage_cost = np.zeros(stages)
        self.effort = np.zeros(3)
        self.variation, self._u = np.zeros(n), np.full(n, np.nan)
        self.detection = np.full(2, np.nan)
        self.iterations: list[int] = []
        self.wall_times: list[float] = []
        self.appended = self.postponed = self.fallbacks = self.basins = 0
        self.failure = ""

    def take(self, sample: Sample) -> None:
        """Take in a sample; the one at whose beginning the studied stage ends is no part of the run any more."""
        command, metrics = sample.command, sample.metrics
        self.clock.end(command.switches)
        if any(switch.stage == self.studied for switch in command.switches):
            self._finish(command.x)
            return
        self.clock.update(sample)
        first, last = command.sequence.first, command.sequence.last
        if last >= self.studied > first and np.isnan(self.detection[0]):
            self.detection = np.array([command.time, command.instants[self.studied - 1 - first]])
        self.effort += np.r_[metrics.control_effort, metrics.base_force, metrics.base_torque]
        if np.isfinite(self._u).all():
            self.variation += np.abs(metrics.u[0] - self._u)
        self._u = metrics.u[0]
        self.stage_cost[first] += metrics.stage_cost
        self.iterations.append(command.iterations)
        self.wall_times.append(command.solve_time)
        self.appended += "appended" in command.events
        self.postponed += "postponed" in command.events
        self.fallbacks += "solve_failed" in command.events
        self.basins += command.solution.basin > 0

    def end(self, ending: Ending) -> None:
        """Take in how the run ended."""
        self.clock.end(ending.switches)
        if any(switch.stage == self.studied for switch in ending.switches):
            self._finish(ending.x)
        else:
            self.failure = ending.reason

    def _finish(self, x: np.ndarray) -> None:
        self.over, self.x_end = True, x

    def values(self, experiment: Experiment) -> Values:
        """Return the run's numbers by the names of `CELL_QUANTITIES`."""
        times, stage = self.clock.tables, experiment.stages[self.studied]
        base_position, base_angle, joints = self._variation(experiment)
        return {
            "detection_time": self.detection[0],
            "instant_at_detection": self.detection[1],
            "switch_time": times["stages/switch_time"],
            "actual_start": times["stages/actual_start_by_epsilon"][self.studied],
            "completion_time": self.clock.switch_time[self.studied],
            "stage_cost": self.stage_cost * experiment.task.controller.sample_time,
            "final_error": self._final_error(experiment) if stage.end_rows and self.over else np.nan,
            "control_effort": self.effort[0],
            "base_force": self.effort[1],
            "base_torque": self.effort[2],
            "variation_base_position": base_position,
            "variation_base_angle": base_angle,
            "variation_joints": joints,
            "solves": len(self.iterations),
            "iterations_median": float(np.median(self.iterations)) if self.iterations else np.nan,
            "iterations_largest": max(self.iterations, default=0),
            "solve_time_median": float(np.median(self.wall_times)) if self.wall_times else np.nan,
            "solve_time_largest": max(self.wall_times, default=np.nan),
            "appended": self.appended,
            "postponed": self.postponed,
            "fallbacks": self.fallbacks,
            "basin_changes": self.basins,
        }

    def _variation(self, experiment: Experiment) -> tuple[float, float, float]:
        grouped = by_group(self.variation, labels(experiment.loaded.robot, "joint"))
        return grouped.base_position, grouped.base_angle, grouped.joints

    def _final_error(self, experiment: Experiment) -> float:
        """Return the largest error of the end condition when the studied stage ended, over its tolerance."""
        stage = experiment.stages[self.studied]
        error = experiment.costs.errors(stage, self.x_end[None])[0, list(stage.end_rows)]
        return float(np.max(np.abs(error) / stage.tolerance))
