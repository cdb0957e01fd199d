"""Between the nodes: what the physics does along the plans of a log and along its closed loop."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Largest
from psmpc_cli.ocp.plan import Chart, Plan
from psmpc_cli.ocp.problem import Stage, in_own_chart
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant.adaptive import INSIDE, AdaptiveDynamics, Flow
from psmpc_cli.simulation.measures import state_at
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.simulation.run import Experiment, build_experiment

Vector = np.ndarray

QUANTITIES = {
    "position": "position off the plan",
    "velocity": "velocity off the plan",
    "position limit": "beyond a position limit",
    "velocity limit": "beyond a velocity limit",
    "end condition": "end condition, over its tolerance",
    "plant": "logged state off the integrated one",
}
"""What is measured, as it is called."""


Peaks = dict[str, Largest]
"""The largest values by the names of `QUANTITIES`; none of what could not be measured."""


@dataclass(frozen=True, eq=False)
class Verification:
    """What the physics did.

    Attributes:
        horizons: Along the plans of so many horizons.
        count: Number of horizons integrated.
        loop: Along the closed loop.
        samples: Number of samples of it that were integrated.
        remarks: What was left out.
    """

    horizons: Peaks
    count: int
    loop: Peaks
    samples: int
    remarks: tuple[str, ...]


def verify(log: Run, every: int = 1, watch: Callable[[int], None] = lambda sample: None) -> Verification:
    """Integrate every n-th logged horizon, and the whole closed loop.

    Args:
        log: A log with plans.
        every: n.
        watch: Told the number of each sample it has done with.

    Raises:
        LogError: The log holds no plans or no samples.
    """
    if not log.has_plans or not len(log.time):
        missing = "samples" if log.has_plans else "plans"
        raise LogError(f"{log.path}: holds no {missing}; expected a log of a task with log: {{plans: true}}")
    experiment = build_experiment(log.task)
    verifier = _Verifier(log, experiment)
    for sample in range(len(log.time)):
        verifier.take(sample, sample % every == 0)
        watch(sample)
    return verifier.result()


class _Verifier:
    """Goes through a log sample by sample and keeps the largest values."""

    def __init__(self, log: Run, experiment: Experiment) -> None:
        self._log, self._experiment = log, experiment
        self._physics = AdaptiveDynamics(experiment.model)
        self._levels = "levels/solved" in log
        task = experiment.task
        self._uncertain = task.uncertainty.in_force or task.controller.offset_free
        self._horizons: Peaks = {}
        self._loop: Peaks = {}
        self._count, self._samples, self._left_out = 0, 0, 0
        self._plan: Plan | None = None

    def take(self, sample: int, horizon: bool) -> None:
        """Integrate the closed loop after a sample, and its horizon if asked for."""
        failed = bool(self._log["events/solve_failed"][sample])
        if not failed:
            solve = logged_solve(self._log, self._experiment.problem, sample)
            self._plan = solve.plan
            if horizon:
                self._take_horizon(sample, solve.plan, solve.window)
        if not self._uncertain:
            self._take_loop(sample, self._experiment.stages[int(self._log["window/first"][sample])])

    def result(self) -> Verification:
        """Return what was found."""
        remarks = []
        if self._levels:
            remarks.append("the log of HTMPC holds the windows of the first levels alone, and those were integrated")
        if self._uncertain:
            remarks.append(
                "the closed loop was left out: its robot is not the one the plans are made for, or its controls are "
                "not theirs"
            )
        if self._left_out:
            why = "without the plan that was applied in the log; log: {ticks: true} logs the forces"
            remarks.append(f"{self._left_out} samples of the closed loop were left out, {why}")
        return Verification(self._horizons, self._count, self._loop, self._samples, tuple(remarks))

    def _take_horizon(self, sample: int, plan: Plan, window: Window) -> None:
        u = np.hstack([plan.u, np.tile(plan.chart.anchor, (len(plan.u), 1))])
        flow = self._physics.under("law", np.hstack(plan.chart.leave(plan.X[:1]))[0], plan.times, u)
        self._count += 1
        self._note_deviation(self._horizons, sample, flow.between_pieces, plan.X, plan.times, plan.chart)
        ends = np.cumsum(window.nodes)
        for s, (stage, N, last) in enumerate(zip(window.stages, window.nodes, ends, strict=True)):
            first = last - N
            inside = slice(first * INSIDE, last * INSIDE + 1)
            self._note_limits(self._horizons, sample, stage, flow, inside)
            if s < len(window.stages) - 1:
                x = self._in_chart(plan.chart, flow.between_pieces)[last]
                self._note_end(self._horizons, sample, stage, x, plan.times[last])

    def _take_loop(self, sample: int, stage: Stage) -> None:
        log, task = self._log, self._experiment.task
        ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        edges = log.time[sample] + np.arange(ticks + 1) / task.plant.low_level_rate
        x, plan = _state(log, sample), self._plan
        known = plan is not None and not self._levels and not log["events/braking"][sample]
        if log.ticks:
            held = log.ticks["F"][sample * ticks : (sample + 1) * ticks]
            flow = self._physics.under("force", x, edges, held)
        elif known and plan is not None:
            _, v = plan.chart.leave(plan.states_at(edges))
            flow = self._physics.under("ticks", x, edges, np.diff(v, axis=0) / np.diff(edges)[:, None])
        else:
            self._left_out += 1
            return
        self._samples += 1
        if known and plan is not None:
            self._note_deviation(self._loop, sample, flow.X[-1:], plan.states_at(edges[-1:]), edges[-1:], plan.chart)
        self._note_limits(self._loop, sample, stage, flow, slice(None))
        self._note_plant(sample, flow)
        self._note_hand_overs(sample, flow)

    def _in_chart(self, chart: Chart, X: Vector) -> Vector:
        """Return states (K, nq + n) in a chart (K, 2n)."""
        return chart.enter(*np.split(X, [self._experiment.model.nq], axis=1))

    def _note_deviation(
        self, peaks: Peaks, sample: int, X: Vector, planned: Vector, times: Vector, chart: Chart
    ) -> None:
        """Note how far states X (K, nq + n) are from planned ones in a chart (K, 2n)."""
        n, apart = self._experiment.model.n, np.abs(self._in_chart(chart, X) - planned)
        self._note(peaks, "position", sample, apart[:, :n], times)
        self._note(peaks, "velocity", sample, apart[:, n:], times)

    def _note_limits(self, peaks: Peaks, sample: int, stage: Stage, flow: Flow, part: slice) -> None:
        """Note by how much more than at the measured state a limit is violated: the horizon leaves that state free."""
        n, nq, limits = self._experiment.model.n, self._experiment.model.nq, stage.limits
        X = np.hstack([self._in_chart(Chart.at(flow.X[0, :nq], n), flow.X)[:, :n], flow.X[:, nq:]])
        beyond = np.maximum(np.maximum(limits.state_low - X, X - limits.state_high), 0.0)
        if peaks is self._horizons:
            beyond = np.maximum(beyond - beyond[0], 0.0)
        self._note(peaks, "position limit", sample, beyond[part, :n], flow.times[part])
        self._note(peaks, "velocity limit", sample, beyond[part, n:], flow.times[part])

    def _note_plant(self, sample: int, flow: Flow) -> None:
        """Note how far the next logged state is from the integrated one."""
        log = self._log
        if sample + 1 < len(log.time):
            after = _state(log, sample + 1)
        elif np.isfinite(log.final["time"]):
            after = np.concatenate([log.final["Q"], log.final["v"]])
        else:
            return
        names = [*log.coordinates, *(f"{name} velocity" for name in log.coordinates)]
        at, both = (
            Chart.at(after[: self._experiment.model.nq], self._experiment.model.n),
            np.vstack([flow.X[-1], after]),
        )
        apart = np.abs(np.diff(self._in_chart(at, both), axis=0))
        self._note(self._loop, "plant", sample, apart, flow.times[-1:], names)

    def _note_hand_overs(self, sample: int, flow: Flow) -> None:
        """Note the end conditions of stages that ended in the course of a sample."""
        switch_times = self._log.stages["switch_time"]
        start, end = flow.times[0], flow.times[-1]
        for index in np.flatnonzero((switch_times > start + 1e-9) & (switch_times <= end + 1e-9)):
            time = float(switch_times[index])
            chart = Chart.at(flow.X[0, : self._experiment.model.nq], self._experiment.model.n)
            found = chart.leave(state_at(flow.times, self._in_chart(chart, flow.X), time)[None])
            stage, x = in_own_chart(self._experiment.model, self._experiment.stages[index], found[0][0], found[1][0])
            self._note_end(self._loop, sample, stage, x, time)

    def _note_end(self, peaks: Peaks, sample: int, stage: Stage, x: Vector, time: float) -> None:
        """Note the error of a stage's end condition over its tolerance. Paper eq. (18)."""
        error = self._experiment.costs.end_error(stage, x)
        if np.isfinite(error):
            self._note(peaks, "end condition", sample, np.array([[error]]), np.array([time]), [stage.name])

    def _note(
        self,
        peaks: Peaks,
        quantity: str,
        sample: int,
        values: Vector,
        times: Vector,
        names: list[str] | None = None,
    ) -> None:
        """Keep the largest of values (T, names) at times (T,) if it is larger than what is known."""
        row, column = np.unravel_index(int(np.argmax(values)), values.shape)
        value = float(values[row, column])
        if quantity not in peaks or not value <= peaks[quantity].value:
            where = (names or list(self._log.coordinates))[int(column)]
            peaks[quantity] = Largest(value, where, float(times[row]), sample)


def _state(log: Run, sample: int) -> Vector:
    """Return the state measured at a sample (nq + n,)."""
    return np.concatenate([log["state/Q"][sample], log["state/Qdot"][sample]])
