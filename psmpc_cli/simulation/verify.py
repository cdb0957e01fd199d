"""Between the nodes: what the physics does along the plans of a log and along its closed loop."""

from collections.abc import Iterator, Sequence

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Largest, largest
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant.adaptive import INSIDE, AdaptiveDynamics, Flow
from psmpc_cli.progress import Watch, Work
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.simulation.measures import interpolate_state
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

QuantitySeries = tuple[str, Vector, Vector, Sequence[str]]
"""What is measured of a sample: its name in `QUANTITIES`, values (T, names), times (T,) [s] and names."""


class Verification:
    """What the physics does along every n-th plan of a log, and along its closed loop.

    Attributes:
        horizons, loop: The largest values along the plans of the horizons, and along the closed loop.
        count, samples: Numbers of horizons and of samples of the loop that were integrated.
        remarks: What was left out.
    """

    def __init__(self, log: Run, every: int = 1, watch: Watch = lambda progress: None) -> None:
        """Integrate the full dynamics along the plans and the closed loop of a run, and keep the largest deviations.

        Plans are computed with accelerations that are constant over an interval, and limits hold at its ends. This
        shows how far the exact motion is from them in between.

        Args:
            log: A run with plans.
            every: Only the plan of every n-th sample is integrated.
            watch: Called with the progress.

        Raises:
            LogError: The log holds no plans or no samples, or a motion that cannot be integrated.
        """
        self._log = log
        self._problem = log.problem
        self._model = log.problem.model
        task = self._problem.spec
        self._is_mounted = bool(task.stages_on_mount(self._model.spec))
        self._physics = AdaptiveDynamics(self._model)
        self._held = AdaptiveDynamics(self._model.mounted) if self._is_mounted else self._physics
        has_levels = "levels/solved" in log
        is_uncertain = task.is_uncertain or task.controller.offset_free
        states = np.hstack([log.motion.Q_seen, log.motion.v_seen])
        self._states = np.vstack([states, np.full_like(states[:1], np.nan)])  # after a kill the last one is not known
        self.horizons: Peaks = {}
        self.loop: Peaks = {}
        self.count = 0
        self.samples = 0
        plan = None
        work = Work("samples", len(log.time), watch, small_parts=True)
        for sample in range(len(log.time)):
            if not log["events/solve_failed"][sample]:
                solve = logged_solve(log, sample)
                plan = None if has_levels else solve.plan  # of HTMPC the log has the first level, another is applied
                if sample % every == 0:
                    self.count += 1
                    _update_peaks(self.horizons, sample, self._measure_horizon(solve.plan, solve.window))
            applied_plan = None if log["events/braking"][sample] else plan
            if not is_uncertain and (flow := self._integrate_sample(sample, applied_plan)) is not None:
                self.samples += 1
                _update_peaks(self.loop, sample, self._measure_loop(sample, flow, applied_plan))
            work.advance()
        reasons = ["without the plan that was applied in the log"]
        if self._is_mounted:
            reasons.insert(0, "in which a mount closes or opens")
        if self._physics.n_stored:
            reasons.append("without what wheels store at its ticks")
        self.remarks = tuple(_remarks(has_levels, is_uncertain, len(log.time) - self.samples, reasons))

    def _measure_horizon(self, plan: Plan, window: Window) -> Iterator[QuantitySeries]:
        """Integrate the robot under its low-level law along a plan, and measure how far the motion is from the plan.

        The integration works in [Q; v] and has `INSIDE` states an interval; they are compared in the plan's chart.

        Args:
            plan: The plan.
            window: Its window, with stages, limits and mesh.

        Yields:
            By position and velocity: the differences of states at the plan's nodes; by how much limits are violated
            within each stage, less what the measured state violates them by, which no plan can change; and the error of
            the end condition where a stage ends.
        """
        u = np.hstack([plan.u, np.tile(plan.chart.anchor, (len(plan.u), 1))])
        flow = self._integrate("law", np.hstack(plan.chart.from_chart(plan.X[:1]))[0], plan.times, u)
        X = plan.chart.states_in_chart(flow.between_pieces)
        yield from self._positions_and_velocities("", np.abs(X - plan.X), plan.times)
        for stage, N, last in zip(window.stages, window.nodes, np.cumsum(window.nodes), strict=True):
            times_of_stage = slice((last - N) * INSIDE, last * INSIDE + 1)
            violations = self._limit_violations(stage, flow)
            yield from self._positions_and_velocities(
                " limit", np.maximum(violations - violations[0], 0.0)[times_of_stage], flow.times[times_of_stage]
            )
            if stage is not window.stages[-1]:
                yield self._end_error(stage, X[last], plan.times[last])

    def _integrate(
        self,
        what: str,
        state: Vector,
        times: Vector,
        inputs: Vector,
        is_held: bool = False,
        stored: Vector | None = None,
    ) -> Flow:
        """Integrate the physics as `AdaptiveDynamics.integrate` does, of a base that a mount holds or that moves.

        Raises:
            LogError: The numbers are not those of a motion.
        """
        try:
            return (self._held if is_held else self._physics).integrate(what, state, times, inputs, stored)
        except RuntimeError:
            raise LogError(f"{self._log.path}: the motion from {times[0]:g} s on cannot be integrated") from None

    def _integrate_sample(self, sample: int, plan: Plan | None) -> Flow | None:
        """Integrate the closed loop over one sample from its logged state, as a check of the plant that simulated it.

        What acts are the logged forces; where the log has none, the accelerations of the plan.

        Args:
            sample: The number of the sample.
            plan: The plan that is applied; None if it is not known.

        Returns:
            The motion; None where neither forces nor plan are known.
        """
        log = self._log
        task = self._problem.spec
        ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        tick_times = log.time[sample] + np.arange(ticks + 1) / task.plant.low_level_rate
        state = self._states[sample]
        forces = log.ticks["F"][sample * ticks : (sample + 1) * ticks] if log.ticks else np.zeros(0)
        is_held = self._is_held(sample)
        if len(set(is_held)) > 1:
            return None
        if len(forces) and np.isfinite(forces).all():  # those of a loop of the user's own may be unknown
            stored = self._stored(slice(sample * ticks, (sample + 1) * ticks)) if self._physics.n_stored else None
            return self._integrate("force", state, tick_times, forces, is_held[0], stored)
        if plan is None or self._physics.n_stored:
            return None
        _, v = plan.chart.from_chart(plan.states_at(tick_times))
        rates = np.diff(v, axis=0) / np.diff(tick_times)[:, None]
        return self._integrate("ticks", state, tick_times, rates, is_held=is_held[0])

    def _stored(self, ticks: slice) -> Vector:
        """Return what wheels store at the ends of logged ticks, along the base's axes (ticks + 1, 3) [N m s]."""
        momenta = self._log["ticks/wheel_momentum"][ticks]
        last = momenta[-1] + self._log["ticks/motor_torque"][ticks][-1] / self._problem.spec.plant.low_level_rate
        return np.vstack([momenta, last]) @ Wheels.of(self._model.spec).axes.T

    def _is_held(self, sample: int) -> list[bool]:
        """Tell whether a mount holds the base in each stage of a sample; in that at its end alone it may just do so."""
        stages = self._log["window/first"][sample : sample + 2].astype(int)
        held = self._problem.spec.stages_on_mount(self._model.spec)
        return [stage in held for stage in range(stages[0], max(stages) + 1)]

    def _measure_loop(self, sample: int, flow: Flow, plan: Plan | None) -> Iterator[QuantitySeries]:
        """Measure how far the integrated motion over one sample is from its plan, limits, and the logged motion.

        Args:
            sample: The number of the sample.
            flow: The integrated motion.
            plan: The plan that is applied; None if it is not known.

        Yields:
            Differences from the plan at the end of the sample; by how much limits are violated; the difference from the
            next logged state; and errors of end conditions of stages that end in the sample.
        """
        log = self._log
        end_time = flow.times[-1:]
        if plan is not None:
            yield from self._positions_and_velocities(
                "", np.abs(plan.chart.states_in_chart(flow.states[-1:]) - plan.states_at(end_time)), end_time
            )
        stages = log.problem_at(float(log.time[sample])).stages
        violations = self._limit_violations(stages[int(log["window/first"][sample])], flow)
        yield from self._positions_and_velocities(" limit", violations, flow.times)
        names = [*log.coordinates, *(f"{name} velocity" for name in log.coordinates)]
        next_logged_state = self._states[sample + 1]
        yield (
            "plant",
            np.abs(
                np.diff(
                    self._chart_at(next_logged_state).states_in_chart(np.vstack([flow.states[-1], next_logged_state])),
                    axis=0,
                )
            ),
            end_time,
            names,
        )
        switches = [switch for switch in log.switches if flow.times[0] + 1e-9 < switch[1] <= end_time[0] + 1e-9]
        chart = self._chart_at(flow.states[0])
        for index, time in switches:
            Q, v = chart.from_chart(interpolate_state(flow.times, chart.states_in_chart(flow.states), time)[None])
            stage = stages[index]
            object_state = log.object_state_at(time)
            yield self._end_error(*in_own_chart(self._model, stage, Q[0], v[0], object_state=object_state), time)

    def _chart_at(self, state: Vector) -> Chart:
        """Return the chart about the attitude in a state (nq + n,)."""
        return self._model.space.chart_at(state[: self._model.nq])

    def _limit_violations(self, stage: Stage, flow: Flow) -> Vector:
        """Return by how much a motion exceeds the limits of a stage (T, 2n); 0 within them."""
        X = np.hstack(
            [
                self._chart_at(flow.states[0]).states_in_chart(flow.states)[:, : self._model.n],
                flow.states[:, self._model.nq :],
            ]
        )
        return np.asarray(np.maximum(np.maximum(stage.limits.state_low - X, X - stage.limits.state_high), 0.0))

    def _positions_and_velocities(self, of: str, values: Vector, times: Vector) -> Iterator[QuantitySeries]:
        """Split what is measured of states (T, 2n) into quantities of positions and of velocities."""
        for name, part in zip(("position", "velocity"), np.hsplit(values, 2), strict=True):
            yield f"{name}{of}", part, times, self._log.coordinates

    def _end_error(self, stage: Stage, x: Vector, time: float) -> QuantitySeries:
        """Measure the error of a stage's end condition over its tolerance. Paper eq. (18)."""
        error = self._problem.costs.end_error(stage, x)
        return "end condition", np.array([[error]]), np.array([time]), [stage.name]


def _remarks(levels: bool, uncertain: bool, left_out: int, reasons: Sequence[str]) -> Iterator[str]:
    """Say what was left out of a verification, and why."""
    if levels:
        yield "the log of HTMPC holds the windows of the first levels alone, and those were integrated"
    if uncertain:
        why = "its robot is not the one the plans are made for, or its controls are not theirs"
        yield f"the closed loop was left out: {why}"
    elif left_out:
        why = f"{', or '.join(reasons)}; log: {{ticks: true}} logs the forces"
        yield f"{left_out} samples of the closed loop were left out, {why}"


def _update_peaks(peaks: Peaks, sample: int, measured: Iterator[QuantitySeries]) -> None:
    """Replace peaks by what was found at a sample, where that is larger."""
    for quantity, values, times, names in measured:
        peak = largest(values, names, times, sample)
        if peak is not None and (quantity not in peaks or peak.value > peaks[quantity].value):
            peaks[quantity] = peak
