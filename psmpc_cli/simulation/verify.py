"""Between the nodes: what the physics does along the plans of a log and along its closed loop."""

from collections.abc import Callable, Iterator, Sequence

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


def verify(log: Run, every: int = 1, watch: Callable[[int], None] = lambda sample: None) -> "Verification":
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
    verification = Verification(log)
    for sample in range(len(log.time)):
        verification.take(sample, sample % every == 0)
        watch(sample)
    return verification


Found = Iterator[tuple[str, Vector, Vector, Sequence[str]]]
"""What is measured of a sample: its name in `QUANTITIES`, values (T, names), times (T,) [s] and names."""


class Verification:
    """What the physics does along the plans and the closed loop of a log, gone through sample by sample.

    Attributes:
        horizons, loop: The largest values along the plans of the horizons, and along the closed loop.
        count, samples, left_out: Numbers of horizons and of samples of the loop integrated, and of those left out.
    """

    def __init__(self, log: Run) -> None:
        self._log, self._problem, self._model = log, log.problem, log.problem.model
        self._physics = AdaptiveDynamics(self._model)
        self._levels = "levels/solved" in log
        task = self._problem.spec
        self._uncertain = task.uncertainty.in_force or task.controller.offset_free
        self.horizons: Peaks = {}
        self.loop: Peaks = {}
        self.count, self.samples, self.left_out = 0, 0, 0
        self._plan: Plan | None = None

    def take(self, sample: int, horizon: bool) -> None:
        """Integrate the closed loop after a sample, and its horizon if asked for."""
        if not self._log["events/solve_failed"][sample]:
            solve = logged_solve(self._log, sample)
            self._plan = solve.plan
            if horizon:
                self.count += 1
                _keep(self.horizons, sample, self._of_horizon(solve.plan, solve.window))
        if self._uncertain:
            return
        known = None if self._levels or self._log["events/braking"][sample] else self._plan
        flow = self._flow(sample, known)
        self.samples, self.left_out = self.samples + (flow is not None), self.left_out + (flow is None)
        if flow is not None:
            _keep(self.loop, sample, self._of_loop(sample, flow, known))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was left out."""
        remarks = []
        if self._levels:
            remarks.append("the log of HTMPC holds the windows of the first levels alone, and those were integrated")
        if self._uncertain:
            remarks.append(
                "the closed loop was left out: its robot is not the one the plans are made for, or its controls are "
                "not theirs"
            )
        if self.left_out:
            why = "without the plan that was applied in the log; log: {ticks: true} logs the forces"
            remarks.append(f"{self.left_out} samples of the closed loop were left out, {why}")
        return tuple(remarks)

    def _of_horizon(self, plan: Plan, window: Window) -> Found:
        """Integrate a plan; limits count by how much more than at the measured state, which the horizon leaves free."""
        u = np.hstack([plan.u, np.tile(plan.chart.anchor, (len(plan.u), 1))])
        flow = self._physics.under("law", np.hstack(plan.chart.leave(plan.X[:1]))[0], plan.times, u)
        X = plan.chart.entered(flow.between_pieces)
        yield from self._halves("", np.abs(X - plan.X), plan.times)
        for stage, N, last in zip(window.stages, window.nodes, np.cumsum(window.nodes), strict=True):
            inside, beyond = slice((last - N) * INSIDE, last * INSIDE + 1), self._beyond(stage, flow)
            yield from self._halves(" limit", np.maximum(beyond - beyond[0], 0.0)[inside], flow.times[inside])
            if stage is not window.stages[-1]:
                yield from self._end(stage, X[last], plan.times[last])

    def _flow(self, sample: int, plan: Plan | None) -> Flow | None:
        """Integrate the closed loop over a sample under its logged forces, or those of its plan; None without both."""
        log, task = self._log, self._problem.spec
        ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        edges, x = log.time[sample] + np.arange(ticks + 1) / task.plant.low_level_rate, _state(log, sample)
        if log.ticks:
            return self._physics.under("force", x, edges, log.ticks["F"][sample * ticks : (sample + 1) * ticks])
        if plan is None:
            return None
        _, v = plan.chart.leave(plan.states_at(edges))
        return self._physics.under("ticks", x, edges, np.diff(v, axis=0) / np.diff(edges)[:, None])

    def _of_loop(self, sample: int, flow: Flow, plan: Plan | None) -> Found:
        """Compare the closed loop over a sample with its plan, limits, next logged state and ends of stages."""
        log, end = self._log, flow.times[-1:]
        if plan is not None:
            yield from self._halves("", np.abs(plan.chart.entered(flow.X[-1:]) - plan.states_at(end)), end)
        beyond = self._beyond(self._problem.stages[int(log["window/first"][sample])], flow)
        yield from self._halves(" limit", beyond, flow.times)
        last = sample + 1 == len(log.time)
        after = np.concatenate([log.final["Q"], log.final["v"]]) if last else _state(log, sample + 1)
        if not last or np.isfinite(log.final["time"]):
            names = [*log.coordinates, *(f"{name} velocity" for name in log.coordinates)]
            apart = np.diff(self._chart(after).entered(np.vstack([flow.X[-1], after])), axis=0)
            yield "plant", np.abs(apart), end, names
        switch_times, chart = log.stages["switch_time"], self._chart(flow.X[0])
        for index in np.flatnonzero((switch_times > flow.times[0] + 1e-9) & (switch_times <= end + 1e-9)):
            time = float(switch_times[index])
            Q, v = chart.leave(state_at(flow.times, chart.entered(flow.X), time)[None])
            yield from self._end(*in_own_chart(self._model, self._problem.stages[index], Q[0], v[0]), time)

    def _chart(self, x: Vector) -> Chart:
        """Return the chart about the attitude in a state (nq + n,)."""
        return Chart.at(x[: self._model.nq], self._model.n)

    def _beyond(self, stage: Stage, flow: Flow) -> Vector:
        """Return by how much a motion exceeds the limits of a stage (T, 2n)."""
        X = np.hstack([self._chart(flow.X[0]).entered(flow.X)[:, : self._model.n], flow.X[:, self._model.nq :]])
        return np.asarray(np.maximum(np.maximum(stage.limits.state_low - X, X - stage.limits.state_high), 0.0))

    def _halves(self, of: str, values: Vector, times: Vector) -> Found:
        """Give what is measured of positions and of velocities, (T, 2n)."""
        for name, part in zip(("position", "velocity"), np.hsplit(values, 2), strict=True):
            yield f"{name}{of}", part, times, self._log.coordinates

    def _end(self, stage: Stage, x: Vector, time: float) -> Found:
        """Give the error of a stage's end condition over its tolerance. Paper eq. (18)."""
        error = self._problem.costs.end_error(stage, x)
        if np.isfinite(error):
            yield "end condition", np.array([[error]]), np.array([time]), [stage.name]


def _keep(peaks: Peaks, sample: int, found: Found) -> None:
    """Keep the largest values that are larger than what is known."""
    for quantity, values, times, names in found:
        row, column = np.unravel_index(int(np.argmax(values)), values.shape)
        value = float(values[row, column])
        if quantity not in peaks or not value <= peaks[quantity].value:
            peaks[quantity] = Largest(value, names[int(column)], float(times[row]), sample)


def _state(log: Run, sample: int) -> Vector:
    """Return the state measured at a sample (nq + n,)."""
    return np.concatenate([log["state/Q"][sample], log["state/Qdot"][sample]])
