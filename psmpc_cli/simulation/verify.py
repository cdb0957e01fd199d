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
"""The largest value of each quantity, by its name in `QUANTITIES`; quantities that could not be measured are absent."""

QuantitySeries = tuple[str, Vector, Vector, Sequence[str]]
"""One quantity at some times: its name in `QUANTITIES`, values (T, columns), times (T,) [s], names of the columns."""


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
            every: Only the plan of every n-th sample is integrated, to save time; the closed loop always is.
            watch: Called with the progress.

        Raises:
            LogError: The log holds no plans or no samples, or a motion that cannot be integrated.
        """
        self._log = log
        self._problem = log.problem
        self._model = log.problem.model
        task = self._problem.spec
        has_mount = bool(task.stages_on_mount(self._model.spec))
        self._free_dynamics = AdaptiveDynamics(self._model)
        self._mounted_dynamics = AdaptiveDynamics(self._model.mounted) if has_mount else self._free_dynamics
        has_levels = "levels/solved" in log  # of HTMPC, which solves for one priority level after the other
        # then the dynamics here are not those of the run, or the logged controls are not those of the plans
        is_uncertain = task.is_uncertain or task.controller.offset_free
        states = np.hstack([log.motion.Q_seen, log.motion.v_seen])
        # the state after the last sample; of a run that was killed it is not known, and this row of NaN stands for it
        self._states = np.vstack([states, np.full_like(states[:1], np.nan)])
        self.horizons: Peaks = {}
        self.loop: Peaks = {}
        self.count = 0
        self.samples = 0
        plan_in_force = None  # that of the last solve that did not fail
        work = Work("samples", len(log.time), watch, small_parts=True)
        for sample in range(len(log.time)):
            if not log["events/solve_failed"][sample]:
                solve = logged_solve(log, sample)
                plan_in_force = None if has_levels else solve.plan  # the log has the first level, the last is applied
                if sample % every == 0:
                    self.count += 1
                    _update_peaks(self.horizons, sample, self._measure_horizon(solve.plan, solve.window))
            applied_plan = None if log["events/braking"][sample] else plan_in_force
            if not is_uncertain and (flow := self._integrate_sample(sample, applied_plan)) is not None:
                self.samples += 1
                _update_peaks(self.loop, sample, self._measure_loop(sample, flow, applied_plan))
            work.advance()
        reasons = ["without the plan that was applied in the log"]
        if has_mount:
            reasons.insert(0, "in which a mount closes or opens")
        if self._free_dynamics.n_stored:
            reasons.append("without what wheels store at its ticks")
        self.remarks = tuple(_remarks_on_omissions(has_levels, is_uncertain, len(log.time) - self.samples, reasons))

    def _measure_horizon(self, plan: Plan, window: Window) -> Iterator[QuantitySeries]:
        """Integrate the robot under its low-level law along a plan, and measure how far the motion is from the plan.

        The integration works in [Q; v] and returns `INSIDE` states in each interval of the plan. They are compared in
        the plan's chart, the local coordinates in which the plan is written.

        Args:
            plan: The plan.
            window: Its window, with stages, limits and mesh.

        Yields:
            First the differences of states at the plan's nodes. Then for each stage by how much limits are violated
            within it, less what the measured state violates them by, which no plan can change; and the error of the end
            condition if the stage ends in the window. Positions and velocities are separate quantities.
        """
        # the accelerations of a spatial plan are those of its chart, so the integrator takes the chart's anchor too
        u_and_anchor = np.hstack([plan.u, np.tile(plan.chart.anchor, (len(plan.u), 1))])
        initial_state = np.hstack(plan.chart.from_chart(plan.X[:1]))[0]
        flow = self._integrate("law", initial_state, plan.times, u_and_anchor)
        X = plan.chart.states_in_chart(flow.between_pieces)
        yield from self._positions_and_velocities("", np.abs(X - plan.X), plan.times)
        last_nodes = np.cumsum(window.nodes)
        for stage, N, last_node in zip(window.stages, window.nodes, last_nodes, strict=True):
            times_of_stage = slice((last_node - N) * INSIDE, last_node * INSIDE + 1)
            violations = self._limit_violations(stage, flow)
            added_violations = np.maximum(violations - violations[0], 0.0)
            yield from self._positions_and_velocities(
                " limit", added_violations[times_of_stage], flow.times[times_of_stage]
            )
            if stage is not window.stages[-1]:  # the last one does not end in the window
                yield self._end_error(stage, X[last_node], plan.times[last_node])

    def _integrate(
        self,
        acting: str,
        state: Vector,
        times: Vector,
        inputs: Vector,
        is_held: bool = False,
        stored: Vector | None = None,
    ) -> Flow:
        """Integrate the full dynamics over pieces of constant input, by `AdaptiveDynamics.integrate`.

        Args:
            acting: What acts: `law`, accelerations that the low-level law follows at every instant; `ticks`,
                accelerations that it turns into a force where each piece begins; `force`, generalized forces.
            state: State [Q; v] at the first of the times (nq + n,).
            times: Ends of the K pieces (K + 1,) [s].
            inputs: The accelerations [m/s^2, rad/s^2] or forces [N, N m] of the pieces (K, n); under `law` each with
                the anchor of the plan's chart behind it.
            is_held: Whether a mount holds the base, which moves otherwise.
            stored: What wheels store at the ends of the pieces, along the base's axes (K + 1, 3) [N m s]; by default
                nothing.

        Raises:
            LogError: The integrator failed: the numbers are not those of a motion.
        """
        dynamics = self._mounted_dynamics if is_held else self._free_dynamics
        try:
            return dynamics.integrate(acting, state, times, inputs, stored)
        except RuntimeError:
            raise LogError(f"{self._log.path}: the motion from {times[0]:g} s on cannot be integrated") from None

    def _integrate_sample(self, sample: int, plan: Plan | None) -> Flow | None:
        """Integrate the closed loop over one sample from its logged state, as a check of the plant that simulated it.

        What acts are the logged forces; where the log has none, the accelerations of the plan.

        Args:
            sample: The number of the sample.
            plan: The plan that is applied; None if it is not known.

        Returns:
            The motion; None where neither forces nor plan are known, where a mount closes or opens during the sample,
            or where wheels act on the motion and the log does not have what they store.
        """
        log = self._log
        task = self._problem.spec
        ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        tick_times = log.time[sample] + np.arange(ticks + 1) / task.plant.low_level_rate
        ticks_of_sample = slice(sample * ticks, (sample + 1) * ticks)
        state = self._states[sample]
        forces = log.ticks["F"][ticks_of_sample] if log.ticks else np.zeros(0)
        is_held_in_stages = self._is_held_in_stages(sample)
        if len(set(is_held_in_stages)) > 1:  # the mount closes or opens
            return None
        is_held = is_held_in_stages[0]
        wheels_act = self._free_dynamics.n_stored > 0
        if len(forces) and np.isfinite(forces).all():  # those of a loop of the user's own may be unknown
            stored = self._stored_momenta(ticks_of_sample) if wheels_act else None
            return self._integrate("force", state, tick_times, forces, is_held, stored)
        if plan is None or wheels_act:
            return None
        _, v = plan.chart.from_chart(plan.states_at(tick_times))
        rates = np.diff(v, axis=0) / np.diff(tick_times)[:, None]
        return self._integrate("ticks", state, tick_times, rates, is_held)

    def _stored_momenta(self, ticks: slice) -> Vector:
        """Return what wheels store at the ends of logged ticks, along the base's axes (ticks + 1, 3) [N m s]."""
        momenta = self._log["ticks/wheel_momentum"][ticks]  # of each wheel, where each tick begins
        last_torque = self._log["ticks/motor_torque"][ticks][-1]
        at_end = momenta[-1] + last_torque / self._problem.spec.plant.low_level_rate
        return np.vstack([momenta, at_end]) @ Wheels.of(self._model.spec).axes.T

    def _is_held_in_stages(self, sample: int) -> list[bool]:
        """Tell whether a mount holds the base, for each stage from the current one at a sample to that at the next."""
        current_stages = self._log["window/first"][sample : sample + 2].astype(int)  # at this sample and at the next
        stages_on_mount = self._problem.spec.stages_on_mount(self._model.spec)
        return [stage in stages_on_mount for stage in range(current_stages[0], max(current_stages) + 1)]

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
            difference_from_plan = plan.chart.states_in_chart(flow.states[-1:]) - plan.states_at(end_time)
            yield from self._positions_and_velocities("", np.abs(difference_from_plan), end_time)
        stages = log.problem_at(float(log.time[sample])).stages
        violations = self._limit_violations(stages[int(log["window/first"][sample])], flow)
        yield from self._positions_and_velocities(" limit", violations, flow.times)
        names = [*log.coordinates, *(f"{name} velocity" for name in log.coordinates)]
        # the difference of attitudes is taken in the chart at the logged one, where it is a rotation vector
        next_logged_state = self._states[sample + 1]
        both_states = np.vstack([flow.states[-1], next_logged_state])
        X_of_both = self._chart_at(next_logged_state).states_in_chart(both_states)
        yield "plant", np.abs(np.diff(X_of_both, axis=0)), end_time, names
        chart = self._chart_at(flow.states[0])
        rounding = 1e-9  # of sums of sample times [s]
        for index, time in log.switches:
            if not flow.times[0] + rounding < time <= end_time[0] + rounding:
                continue  # the stage ends in another sample
            x_at_switch = interpolate_state(flow.times, chart.states_in_chart(flow.states), time)
            Q, v = chart.from_chart(x_at_switch[None])
            # a stage is evaluated in the chart about its own state, its target relative to the object as it was then
            stage, x = in_own_chart(self._model, stages[index], Q[0], v[0], object_state=log.object_state_at(time))
            yield self._end_error(stage, x, time)

    def _chart_at(self, state: Vector) -> Chart:
        """Return the chart about the attitude in a state (nq + n,)."""
        return self._model.space.chart_at(state[: self._model.nq])

    def _limit_violations(self, stage: Stage, flow: Flow) -> Vector:
        """Return by how much a motion exceeds the limits of a stage at its T times (T, 2n); 0 within them."""
        Q_in_chart = self._chart_at(flow.states[0]).states_in_chart(flow.states)[:, : self._model.n]
        v = flow.states[:, self._model.nq :]  # limits hold for v, not for the rates of the chart's coordinates
        X = np.hstack([Q_in_chart, v])
        return np.asarray(np.maximum(np.maximum(stage.limits.state_low - X, X - stage.limits.state_high), 0.0))

    def _positions_and_velocities(self, suffix: str, values: Vector, times: Vector) -> Iterator[QuantitySeries]:
        """Split values that belong to states (T, 2n) into a quantity of positions and one of velocities.

        Args:
            suffix: What follows "position" and "velocity" in their names in `QUANTITIES`.
            values: The values.
            times: Times of the rows (T,) [s].
        """
        for name, part in zip(("position", "velocity"), np.hsplit(values, 2), strict=True):
            yield f"{name}{suffix}", part, times, self._log.coordinates

    def _end_error(self, stage: Stage, x: Vector, time: float) -> QuantitySeries:
        """Measure the error of a stage's end condition over its tolerance. Paper eq. (18)."""
        error = self._problem.costs.end_error(stage, x)
        return "end condition", np.array([[error]]), np.array([time]), [stage.name]


def _remarks_on_omissions(has_levels: bool, is_uncertain: bool, left_out: int, reasons: Sequence[str]) -> Iterator[str]:
    """Say in sentences for the user what was left out of a verification, and why.

    Args:
        has_levels: Whether the log is of HTMPC, which solves for one priority level after the other.
        is_uncertain: Whether the robot differs from the one that the controller knows.
        left_out: Number of samples of the closed loop that were not integrated.
        reasons: What such samples are, as ends of a sentence.
    """
    if has_levels:
        yield "the log of HTMPC holds the windows of the first levels alone, and those were integrated"
    if is_uncertain:
        why = "its robot is not the one the plans are made for, or its controls are not theirs"
        yield f"the closed loop was left out: {why}"
    elif left_out:
        why = f"{', or '.join(reasons)}; log: {{ticks: true}} logs the forces"
        yield f"{left_out} samples of the closed loop were left out, {why}"


def _update_peaks(peaks: Peaks, sample: int, measured: Iterator[QuantitySeries]) -> None:
    """Replace the largest value of each quantity so far where a larger one was measured at a sample."""
    for quantity, values, times, names in measured:
        peak = largest(values, names, times, sample)
        if peak is not None and (quantity not in peaks or peak.value > peaks[quantity].value):
            peaks[quantity] = peak
