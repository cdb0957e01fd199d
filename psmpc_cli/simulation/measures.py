"""What is measured of a run: margins to limits, efforts, balances, starts and ends of stages, presence and shares.

Presence and shares come from counterfactual solves: windows over other stages than the applied one. The presence of a
waiting stage in the control says when it first acts (docs/formulation.md, section 8), the shares how much of the
applied control each stage makes up (paper Fig. 1).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.optimize import nnls

from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, make_read_only
from psmpc_cli.control.sequence import MovingSequence, Switch
from psmpc_cli.logs.schema import PendingSample, Sample
from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.plan import Plan, shift, states_of
from psmpc_cli.ocp.problem import ObjectState, in_own_chart
from psmpc_cli.ocp.stage import PlacedStage, Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant import ForceLimits, Ticks
from psmpc_cli.plant.grasp import MISSED_BY, Capture
from psmpc_cli.plant.uncertainty import Contact, Uncertainty, force_limits_of
from psmpc_cli.plant.wheels import WheelTicks
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.simulation.clearance import ClearanceMeter
from psmpc_cli.solvers import Solution
from psmpc_cli.specs.robot import Limits
from psmpc_cli.specs.task import OnsetSpec
from psmpc_cli.specs.uncertainty import standard_deviations

DISTINCT = 1e-3
"""Controls nearer to each other than this are the same [m/s^2, rad/s^2]."""

NOT_CUT = 5e-4
"""A force that is beyond its limit by no larger part of it does not count as cut [1]: tables, which write a tenth of a
percent, write 100.0 %. A plan keeps to limits at the ends of its intervals, and exceeds them between by such parts."""


class Meter:
    """Measures the samples of one run, and follows its balances of momentum and energy.

    Tracking uses the true state, where that is not the one the controller saw. Metrics that no decision needs are
    computed lazily, of one sample or of several at once; to the bit, their number and order do not matter.
    """

    def __init__(
        self,
        counterfactuals: "Counterfactuals",
        uncertainty: Uncertainty | None,
        capture: Capture | None,
        initial_state: np.ndarray,
        wheels: np.ndarray | None = None,
    ) -> None:
        """Set up what is measured.

        Args:
            counterfactuals: Solves what is measured alone.
            uncertainty: What the controller does not know.
            capture: The object and its grasps.
            initial_state: Initial state [Q; v] (nq + n,).
            wheels: What wheels store at first (W,) [N m s]; None of a robot without any.
        """
        problem = counterfactuals.problem
        self._capture = capture
        self._counterfactuals = counterfactuals
        self._uncertainty = uncertainty
        self._problem = problem
        self._sees_the_state = problem.spec.sees_the_state
        self._shares = problem.spec.log.shares
        self._noise = standard_deviations(problem.spec.uncertainty.noise, problem.model.spec)
        self._force_limits = force_limits_of(problem.spec, problem.model.spec)
        self._clearance = ClearanceMeter(problem) if problem.spec.keeps_clear else None
        self._acts_in_task_space = problem.spec.acts_in_task_space
        self._base = problem.model.parts["base"]
        self._slides = np.array([joint.prismatic for joint in problem.model.spec.joints], bool)
        self._number = 0
        self._tick = 1 / problem.spec.plant.low_level_rate
        self._wheels = Wheels.of(problem.model.spec)
        self._expected = self._momentum_and_energy(0, initial_state[None])[0] + (
            0.0 if capture is None else capture.kept
        )
        if wheels is not None:
            self._expected = (
                self._expected + self._wheels.balance(initial_state[None, : problem.model.nq], wheels[None])[0]
            )

    def measure(
        self,
        command: Command,
        ticks: Ticks,
        state: np.ndarray,
        u: np.ndarray,
        contact: Contact | None,
        in_force: Command,
    ) -> Sample:
        """Collect what the metrics of a sample are computed from; they are when they are first read.

        Only what later samples could change is computed here: the counterfactual solves (which stages are present in
        the control, and their shares of it), and the momentum and energy that robot and load should have by now, which
        are summed up from sample to sample.

        Args:
            command: What the controller decided.
            ticks: What the plant did.
            state: True state (nq + n,), before anything is taken up or let go. Where nothing is uncertain the one that
                the controller saw counts, which is the same.
            u: Accelerations that reached the robot over the ticks (M, n).
            contact: Effect of taking up or letting go at the sample; None without a payload.
            in_force: The command that acts when the sample begins, an earlier one where commands are late.

        Returns:
            The sample, whose metrics are still to be computed.
        """
        change = ticks.impulse_and_work
        if contact is not None:
            change = change + contact.momentum_and_energy
        self._expected = self._expected + change
        if "returned" in command.events:
            self._counterfactuals.begin_again()
        pending = PendingSample(
            command=command,
            ticks=ticks,
            presence=self._counterfactuals.presence(command),
            shares=self._counterfactuals.shares(command) if self._shares else {},
            state=command.state if self._sees_the_state and command.delay == 0.0 else state,
            in_force=in_force,
            u=u,
            contact=contact,
            of_object=0.0 if self._capture is None else self._capture.kept,
            expected=self._expected,
        )
        sample = Sample(pending, self._number, len(self._problem.stages), self.metrics)
        self._number += 1
        return sample

    def metrics(self, samples: Sequence[PendingSample]) -> list[dict[str, Any]]:
        """Compute the metrics of samples, by their paths in the log, those of one stage at once."""
        stages = groupby(samples, lambda sample: sample.in_force.stage)
        return [row for _, of_stage in stages for row in self._metrics_in_stage(list(of_stage))]

    def _metrics_in_stage(self, samples: Sequence[PendingSample]) -> list[dict[str, Any]]:
        """Compute the metrics of K samples of one stage, by their paths in the log.

        All are in one chart. In space each sample has a chart, and so a placed stage, of its own: there K is 1.
        """
        command = samples[0].in_force
        stage = command.stage
        chart = command.solution.window.chart
        charted = [chart.entered(sample.ticks.states) for sample in samples]
        columns = {
            "window/presence": [sample.presence for sample in samples],
            "window/share": [sample.shares for sample in samples],
            **self._states_and_costs(stage, chart, samples),
            **self._margins(stage.limits, samples, charted),
            **self._efforts_and_peaks(stage, samples),
            **self._deviations(chart, samples, charted),
            **self._balances(stage.index, samples),
            "force/own_axes": self._along_base_axes([sample.ticks for sample in samples]),
            **self._wheel_use([sample.ticks.wheels for sample in samples]),
            **({} if self._force_limits is None else self._force_use(self._force_limits, samples)),
            **({} if self._clearance is None else self._clearances(self._clearance, stage.index, chart, samples)),
        }
        rows = list(zip(*columns.values(), strict=True))
        for row in rows:
            make_read_only(*row)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def _states_and_costs(
        self, stage: PlacedStage, chart: Chart, samples: Sequence[PendingSample]
    ) -> dict[str, np.ndarray]:
        """Return true states and poses at samples, the first control after them, and what the stage's cost is there."""
        model = self._problem.model
        states = np.array([sample.state for sample in samples])
        Q = states[:, : model.nq]
        u = np.array([sample.u[0] for sample in samples])
        since = np.array([sample.ticks.time[0] - sample.in_force.sequence.progress.entered for sample in samples])
        columns = {
            "state/Q_true": Q,
            "state/Qdot_true": states[:, model.nq :],
            "control/u": u,
            "pose/xi": model.poses(Q).reshape(len(states), -1),
            "cost/current_stage": self._problem.costs.at(stage, chart.entered(states), u, since),
        }
        if self._acts_in_task_space:
            columns["pose/condition"] = model.task_space_condition(Q)
        return columns

    def _margins(
        self, limits: Limits, samples: Sequence[PendingSample], charted: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return the smallest margins to limits of states over the ticks of samples, as simulated and as planned.

        Args:
            limits: The limits.
            samples: The samples.
            charted: States of the ticks of each in the chart (M + 1, 2n).
        """
        n = self._problem.model.n
        passed = np.stack([X[1:] for X in charted], axis=1)
        v = [sample.ticks.states[1:, self._problem.model.nq :] for sample in samples]
        passed[:, :, n:] = np.stack(v, axis=1)  # limits are of v
        planned = np.array([_along_plan(sample.in_force, sample.ticks) for sample in samples])
        margin = _margins(passed, limits)
        planned_margin = _margins(planned.swapaxes(0, 1), limits)
        return {
            "margin/position": margin[:, :n],
            "margin/velocity": margin[:, n:],
            "margin/planned_position": planned_margin[:, :n],
            "margin/planned_velocity": planned_margin[:, n:],
        }

    def _efforts_and_peaks(self, stage: PlacedStage, samples: Sequence[PendingSample]) -> dict[str, np.ndarray]:
        """Return integrals of controls and forces over the ticks of samples, and their largest values in them."""
        ticks = [sample.ticks for sample in samples]
        force, torque, joint_torque, sliding_force = self._norms(np.array([of_sample.F for of_sample in ticks]))
        accelerations = np.array([sample.u for sample in samples])
        linear, angular, joint, sliding = self._norms(accelerations)
        # a base that nothing moves has no control
        controls = accelerations * self._problem.model.actuated(stage.moved_by)
        # T_s |dv / T_s|^2, with dv the integral of the commanded accelerations over a sample of length T_s
        mean = controls.mean(axis=1)
        sample_time = self._tick * accelerations.shape[1]
        return {
            "effort/control": sample_time * (mean**2).sum(axis=1),
            "effort/squared_acceleration": self._tick * (controls**2).sum(axis=(1, 2)),
            "effort/base_force": self._tick * force.sum(axis=1),
            "effort/base_torque": self._tick * self._torque_of_thrusters(ticks, torque).sum(axis=1),
            "peak/base_force": force.max(axis=1),
            "peak/base_torque": torque.max(axis=1),
            "peak/joint_torque": joint_torque.max(axis=1),
            "peak/base_acceleration": linear.max(axis=1),
            "peak/base_angular_acceleration": angular.max(axis=1),
            "peak/joint_acceleration": joint.max(axis=1),
            "peak/sliding_force": sliding_force.max(axis=1),
            "peak/sliding_acceleration": sliding.max(axis=1),
        }

    def _deviations(
        self, chart: Chart, samples: Sequence[PendingSample], charted: Sequence[np.ndarray]
    ) -> dict[str, Any]:
        """Return how far samples end from their plans, and the errors of stages that end in them.

        Args:
            chart: The chart of the samples.
            samples: The samples.
            charted: States of the ticks of each in the chart (M + 1, 2n).
        """
        model = self._problem.model
        n = model.n
        ends = np.array([sample.ticks.states[-1] for sample in samples])
        plans = [sample.in_force.plan for sample in samples]
        Q, v = chart.from_chart(states_of(plans, [sample.ticks.time[-1] for sample in samples]))
        about = model.space.chart_at(Q[0])
        deviation = np.hstack([(about.entered(ends) - about.to_chart(Q, v))[:, :n], ends[:, model.nq :] - v])
        end_errors = [self._ends(sample.in_force, sample.ticks, X) for sample, X in zip(samples, charted, strict=True)]
        return {
            "deviation/Q": deviation[:, :n],
            "deviation/Qdot": deviation[:, n:],
            "deviation/end": [{stage: error for stage, (error, _) in errors.items()} for errors in end_errors],
            "deviation/end_noise": [{stage: error for stage, (_, error) in errors.items()} for errors in end_errors],
        }

    def _balances(self, stage: int, samples: Sequence[PendingSample]) -> dict[str, Any]:
        """Return drifts of momentum and energy at the ends of samples of a stage, and what a payload does to energy.

        The drift is what robot, object and wheels have, less what they should have by impulse and work so far.
        """
        ends = np.array([sample.ticks.states[-1] for sample in samples])
        of_object = np.array([sample.of_object for sample in samples]).reshape(len(ends), -1)
        expected = np.array([sample.expected for sample in samples])
        drift = self._momentum_and_energy(stage, ends) + of_object - expected
        drift = drift + self._of_wheels(ends, [sample.ticks.wheels for sample in samples])
        held = self._uncertainty is not None and self._uncertainty.holds(stage)
        contacts = [sample.contact for sample in samples]
        return {
            "balance/momentum": drift[:, :-1],
            "balance/energy": drift[:, -1],
            "payload/held": [held] * len(samples),
            "payload/energy": [0.0 if contact is None else contact.momentum_and_energy[-1] for contact in contacts],
        }

    def _of_wheels(self, states: np.ndarray, ticks: Sequence[WheelTicks | None]) -> np.ndarray | float:
        """Return momentum and energy of wheels at the ends of samples in states X (K, nq + n); 0 without any."""
        known = [of_sample.momentum[-1] for of_sample in ticks if of_sample is not None]
        if len(known) < len(states):
            return 0.0
        return self._wheels.balance(states[:, : self._problem.model.nq], np.array(known))

    def _torque_of_thrusters(self, ticks: Sequence[Ticks], torque: np.ndarray) -> np.ndarray:
        """Return norms of the torques on the base (K, M) without what the motors of wheels give.

        Args:
            ticks: Of K samples.
            torque: Norms of all torques on the base (K, M) [N m].
        """
        along_base = self._wheels.along_base  # in the order of plants: nothing is left but what thrusters give
        by_wheels = [
            np.transpose(along_base(list(of_sample.wheels.torque.T)))
            for of_sample in ticks
            if of_sample.wheels is not None
        ]
        if len(by_wheels) < len(ticks):
            return torque
        all_torques = np.array([of_sample.F for of_sample in ticks])[..., self._problem.model.space.rotation]
        return np.asarray(np.linalg.norm(all_torques + np.array(by_wheels), axis=-1))

    def _wheel_use(self, ticks: Sequence[WheelTicks | None]) -> dict[str, list[np.ndarray]]:
        """Return what wheels store at samples, and their torques furthest from 0 until the next, by path in the log."""
        known = [of_sample for of_sample in ticks if of_sample is not None]
        if len(known) < len(ticks):
            return {}
        furthest = [np.abs(of_sample.torque).argmax(axis=0) for of_sample in known]
        return {
            "wheels/momentum": [of_sample.momentum[0] for of_sample in known],
            "wheels/torque": [
                np.take_along_axis(of_sample.torque, at[None], axis=0)[0]
                for of_sample, at in zip(known, furthest, strict=True)
            ],
        }

    def _along_base_axes(self, ticks: Sequence[Ticks]) -> np.ndarray:
        """Return the forces at samples, those of the base along its own axes, (K, n)."""
        Q = np.array([of_sample.states[0, : self._problem.model.nq] for of_sample in ticks])
        F = np.array([of_sample.F[0] for of_sample in ticks])
        return np.column_stack(self._problem.model.space.along_base_axes(Q.T, F.T))

    def _force_use(self, limits: ForceLimits, samples: Sequence[PendingSample]) -> dict[str, np.ndarray]:
        """Return how near commanded forces come to their limits, and how often they are cut, by path in the log."""
        model = self._problem.model
        F = np.array([sample.ticks.F for sample in samples])
        commanded = np.array([sample.commanded for sample in samples])
        Q = np.array([sample.ticks.states[:-1, : model.nq] for sample in samples])
        utilization = limits.utilization(model.space, Q, commanded)
        is_cut = (commanded != F).any(axis=2) & (utilization > 1 + NOT_CUT).any(axis=2)
        return {
            "force/utilization": utilization.max(axis=1),
            "force/saturated": np.where(np.isnan(F).any(axis=2), np.nan, is_cut).mean(axis=1),
        }

    def _clearances(
        self, meter: ClearanceMeter, stage: int, chart: Chart, samples: Sequence[PendingSample]
    ) -> dict[str, np.ndarray]:
        """Return how near bodies come to each other over samples of a stage, by path in the log."""
        measured = [meter.measure(stage, chart, sample.ticks) for sample in samples]
        smallest = np.array([distance for distance, _ in measured])
        return {
            "clearance/distance": smallest,
            "clearance/points": np.array([points for _, points in measured]).reshape(
                len(measured), len(meter.pairs), 6
            ),
            "clearance/margin": smallest - meter.margins[stage],
        }

    def _norms(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return linear and angular norms of the base's forces or rates (K, M, n), and the joints' largest (K, M).

        The largest are those of the joints that turn, and of those that slide.
        """
        d = self._problem.model.dimension
        of_base = values[..., self._base]
        joints = np.abs(np.delete(values, self._base, axis=-1))
        linear = np.linalg.norm(of_base[..., :d], axis=-1)
        angular = np.linalg.norm(of_base[..., d:], axis=-1)
        turning, sliding = (joints[..., chosen].max(axis=-1, initial=0.0) for chosen in (~self._slides, self._slides))
        return linear, angular, turning, sliding

    def _momentum_and_energy(self, stage: int, states: np.ndarray) -> np.ndarray:
        """Return momentum [N s, N m s] and energy [J] of the robot at states (K, nq + n) in a stage, (K, 4 or 7)."""
        nq = self._problem.model.nq
        uncertainty = self._uncertainty
        robot = None if uncertainty is None else uncertainty.true_parameters(stage)
        return self._problem.model.balance(states[:, :nq], states[:, nq:], robot)

    def _ends(self, command: Command, ticks: Ticks, X: np.ndarray) -> dict[int, tuple[float, float]]:
        """Return the end errors of stages that end with a sample, by stage index: see `_end_errors`.

        By the plan before the next sample, at their planned switch times, which may lie up to `SHORTEST` after it: so
        far the motion is carried on. Or by the measured state, at the sample. A target relative to the object is where
        the object is then, not where it was foreseen. X are the states of the ticks in the chart of the sample (M + 1,
        2n).
        """
        stages = command.problem.stages
        chart = command.solution.window.chart
        Q, v = np.split(ticks.states[0], [self._problem.model.nq])
        errors = {
            index: self._errors_at(stages[index], Q, v, ticks, time)
            for index, time in command.switches
            if time == command.acts_at
        }
        for stage, switch_time in zip(command.solution.window.stages, command.switch_times, strict=False):
            if switch_time > ticks.time[-1] + SHORTEST:
                continue
            time = float(switch_time)
            x = state_at(ticks.time, X, time)
            if stage.on_object:
                Q, v = (rows[0] for rows in chart.from_chart(x[None]))
                errors[stage.index] = self._errors_at(stages[stage.index], Q, v, ticks, time)
            else:
                errors[stage.index] = self._end_errors(stage, x)
        return errors

    def _errors_at(self, stage: Stage, Q: np.ndarray, v: np.ndarray, ticks: Ticks, time: float) -> tuple[float, float]:
        """Return the end errors of a stage in a state, with the object where it is at a time [s]; NaN if unknown."""
        object_state = self._object_state(ticks, time)
        if stage.on_object and object_state is None:
            return np.nan, np.nan
        return self._end_errors(*in_own_chart(self._problem.model, stage, Q, v, object_state=object_state))

    def _object_state(self, ticks: Ticks, time: float) -> ObjectState | None:
        """Return pose and velocity of an object with a mass at a time [s]; since the tick before it moves freely."""
        target_object = ticks.target_object
        if target_object is None or self._capture is None:
            return None
        tick = int(np.clip(np.searchsorted(ticks.time, time, side="right") - 1, 0, len(ticks.time) - 1))
        since = time - float(ticks.time[tick])
        return self._capture.body.predicted(target_object.pose[tick], target_object.v[tick], since)

    def _end_errors(self, stage: Stage, x: np.ndarray) -> tuple[float, float]:
        """Return the error of a stage's end condition over its tolerance, and over that plus 2 sigma of the rows."""
        costs = self._problem.costs
        if not stage.end.has_condition:
            return np.nan, np.nan
        allowance = 2 * costs.end_deviations(stage, x, self._noise)
        return costs.end_error(stage, x), costs.end_error(stage, x, allowance)


def _margins(X: np.ndarray, limits: Limits) -> np.ndarray:
    """Return the smallest distances of [Q; v] to their limits over the ticks, (K, 2n), of states (ticks, K, 2n)."""
    return np.asarray(np.minimum(X.min(axis=0) - limits.state_low, limits.state_high - X.max(axis=0)))


def _along_plan(command: Command, ticks: Ticks) -> np.ndarray:
    """Return [Q; v] of a sample's plan at the ticks after the first (M, 2n), Q in the plan's chart."""
    X = command.plan.states_at(ticks.time[1:])
    _, v = command.plan.chart.from_chart(X)
    return np.hstack([X[:, : v.shape[1]], v])


def state_at(times: np.ndarray, X: np.ndarray, time: float) -> np.ndarray:
    """Interpolate the state (2n,) at a time [s] among or soon after the times (M,) of states X (M, 2n).

    Between two of them the acceleration is taken for constant, and after the last it stays what it was.
    """
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    n = X.shape[1] // 2
    since = time - times[k]
    acceleration = (X[k + 1, n:] - X[k, n:]) / (times[k + 1] - times[k])
    Qdot = X[k, n:] + since * acceleration
    return np.concatenate([X[k, :n] + since / 2 * (X[k, n:] + Qdot), Qdot])


class Counterfactuals:
    """Solves windows for what is measured, never for what is applied; each starts from its own last plan."""

    def __init__(self, controller: Controller) -> None:
        self.problem = controller.problem
        self.onset = controller.problem.spec.onset
        self._solver = controller.law.solver
        self._builder = controller.law.builder
        self._last: dict[tuple[int, int], tuple[Plan, Solution]] = {}
        self._started: set[int] = set()

    def begin_again(self) -> None:
        """Forget plans and early starts: the sequence has returned to an earlier stage, and stages start anew."""
        self._last.clear()
        self._started.clear()

    def presence(self, command: Command) -> dict[int, float]:
        """Measure how much of each waiting stage is in the mean control over the sample, by stage index.

        With `onset: control` that is the norm of what the stage adds [m/s^2, rad/s^2]: the difference to the window
        up to the stage before it. With `closeness` it is the `closeness` to the stage's own optimum [1]. Both are in
        the stage's onset coordinates. A stage is measured until it reaches the largest threshold.
        """
        sequence = command.sequence
        presence = {}
        if sequence.count == 1 or "braking" in command.events:
            return {}
        edges = command.edges[[0, -1]]
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self._started:
                continue
            shorter = sequence.up_to(stage - 1)
            without, _ = self._plan(shorter, command)
            rows = list(command.stages[stage].onset_rows)
            applied, other = (plan.mean_control(edges)[0, rows] for plan in (command.plan, without))
            if self.onset.kind == "control":
                presence[stage] = float(np.linalg.norm(applied - other))
            else:
                alone, usable = self._plan(MovingSequence.of(stage, command.acts_at), command)
                if not usable:
                    continue
                presence[stage] = closeness(applied, other, alone.mean_control(edges)[0, rows])
            if presence[stage] >= max(self.onset.epsilon, *self.onset.series):
                self._started.add(stage)
        return presence

    def shares(self, command: Command) -> dict[int, float]:
        """Compute the share of each stage in the control of the first tick, by stage index.

        Every stage in the window, or every level, is solved for alone. The shares are the weights of the convex
        combination of their controls that is nearest to the applied one. There are none where the stages agree, where
        one has no solution, or where the robot brakes without a plan.
        """
        first = command.sequence.first
        count = max(command.sequence.count, len(command.levels))
        if "braking" in command.events:
            return {}
        if count == 1:
            return {first: 1.0}
        controls = []
        edges = command.edges[:2]
        for stage in range(first, first + count):
            alone = MovingSequence.of(stage, command.acts_at)
            if stage == first:
                alone = command.sequence.up_to(stage)
            plan, usable = self._plan(alone, command)
            if not usable:
                return {}
            controls.append(plan.mean_control(edges)[0])
        u = np.array(controls)
        if np.ptp(u, axis=0).max() < DISTINCT:
            return {}
        weights = nearest_combination(u, command.plan.mean_control(edges)[0])
        return dict(enumerate(map(float, weights), start=first))

    def _plan(self, sequence: MovingSequence, command: Command) -> tuple[Plan, bool]:
        """Return the plan of the window over a sequence, and whether it is a solution or its last plan, shifted."""
        key = (sequence.first, sequence.last)
        plan, previous = self._last.get(key, (None, None))
        if plan is not None and previous is not None and plan.start >= command.acts_at:
            return plan, previous.outcome.usable
        prediction = command.prediction
        x = command.solution.window.x0
        chart = command.solution.window.chart
        if plan is not None:
            prediction = shift(plan.in_chart(chart), command.acts_at, command.solution.window.horizon, x)
        applied = command.solution.window.applied
        window = self._builder.build(sequence, command.stages, prediction, previous or command.solution, applied)
        guess = sequence.guess(prediction)
        solution = self._solver.solve(_on_mesh_of(command.solution.window, window), guess, previous)
        self._last[key] = solution.plan if solution.outcome.usable else prediction, solution
        return self._last[key][0], solution.outcome.usable


def _on_mesh_of(applied: Window, window: Window) -> Window:
    """Return a window with the nodes of the applied one in all stages that end in both.

    What a stage adds to a control is to be seen, not what a finer mesh does.
    """
    counts = {stage.index: N for stage, N in zip(applied.stages[:-1], applied.nodes, strict=False)}
    ending = zip(window.stages[:-1], window.nodes, strict=False)
    return replace(window, nodes=(*(counts.get(stage.index, N) for stage, N in ending), window.nodes[-1]))


def closeness(applied: np.ndarray, without: np.ndarray, alone: np.ndarray) -> float:
    """Compute how far the applied control has come from the one without a stage towards the stage's own optimum.

    0 where it is as far from the own optimum as without the stage, 1 where it is the own optimum, negative where it
    is farther away than without the stage; never more than what the stage adds over the distance of the two. Paper
    section III-E, made a number.

    Args:
        applied: Control of the window's solution in the onset coordinates [m/s^2, rad/s^2].
        without: Control of the window without the stage.
        alone: Control of the window over the stage alone.
    """
    distance = float(np.linalg.norm(without - alone))
    return (distance - float(np.linalg.norm(applied - alone))) / max(distance, DISTINCT)


def nearest_combination(u: np.ndarray, applied: np.ndarray) -> np.ndarray:
    """Compute the weights (S,) of the convex combination of controls u (S, n) that is nearest to the applied one (n,).

    With differences D = (u - applied)', nonnegative w that minimize |D w|^2 + (sum w - 1)^2 are a multiple of the
    weights: for w = s c with sum c = 1 the minimum over s is d^2 / (1 + d^2), d = |D c|, which rises with d.
    """
    differences = (u - applied).T
    scale = max(float(np.linalg.norm(differences, axis=0).max()), DISTINCT)
    weights, _ = nnls(np.vstack([differences / scale, np.ones(len(u))]), np.r_[np.zeros(len(applied)), 1.0])
    return np.asarray(weights / weights.sum())


class StageClock:
    """Follows switch times and actual starts. Section "what is measured" of docs/formulation.md.

    The actual start of a stage is the first sample at which its presence in the control reaches a threshold; a stage
    that never does so before its time starts at the switch time that ends the stage before it. Of a stage that comes
    again, because the object was missed or lost, the last time counts.
    """

    def __init__(self, stages: int, onset: OnsetSpec) -> None:
        self.thresholds = np.array([*onset.series, onset.epsilon])
        self.switch_time = np.full(stages, np.nan)
        self._early = np.full((stages, len(self.thresholds)), np.nan)
        self._begins_again = np.full(stages, np.nan)

    def update(self, sample: Sample) -> bool:
        """Take in a sample; return whether anything changed."""
        command = sample.command
        self.end(command.switches)
        changed = bool(command.switches)
        if "returned" in command.events:
            stages_again = slice(command.sequence.first, None)
            self.switch_time[stages_again] = np.nan
            self._early[stages_again] = np.nan
            self._begins_again[stages_again] = np.nan
            self._begins_again[command.sequence.first] = command.time
            changed = True
        for stage, presence in sample.presence.items():
            starts = (presence >= self.thresholds) & np.isnan(self._early[stage])
            self._early[stage, starts] = sample.command.acts_at
            changed |= bool(starts.any())
        return changed

    def end(self, switches: tuple[Switch, ...]) -> None:
        """Take in the switch times of stages that ended."""
        for switch in switches:
            self.switch_time[switch.stage] = switch.time

    @property
    def tables(self) -> dict[str, np.ndarray]:
        """The times as known so far, by their paths in the log."""
        after_another = np.r_[0.0, self.switch_time[:-1]]
        regular = np.where(np.isnan(self._begins_again), after_another, self._begins_again)
        starts = np.where(np.isnan(self._early), regular[:, None], self._early)
        return {
            "stages/switch_time": self.switch_time.copy(),
            "stages/actual_start": starts[:, -1],
            "stages/early": ~np.isnan(self._early[:, -1]),
            "stages/actual_start_by_epsilon": starts[:, :-1],
        }


class GraspRecord:
    """Follows the grasps of a run: when, and how near, each closed, when and why it opened, where the object was.

    Each time the grippers are to close the record begins anew, so that at the end it is that of the last try.
    """

    def __init__(self, capture: Capture) -> None:
        self._grippers = list(capture.law.grippers)
        self._tried_at = np.nan
        self._none = {
            "object/left_at": np.array(np.nan),
            "object/left_pose": np.full_like(capture.pose_and_velocity[0], np.nan),
            "object/left_velocity": np.full_like(capture.pose_and_velocity[1], np.nan),
        }
        self.tables = self._untried

    @property
    def _untried(self) -> dict[str, np.ndarray]:
        """What the record holds before the grippers are to close."""
        count = len(self._grippers)
        return {
            "grasp/closed_at": np.full(count, np.nan),
            "grasp/missed_by": np.full((count, len(MISSED_BY)), np.nan),
            "grasp/opened_at": np.full(count, np.nan),
            "grasp/lost": np.full(count, -1),
            **self._none,
        }

    def update(self, sample: Sample) -> bool:
        """Take in a sample; return whether anything changed."""
        target_object = sample.ticks.target_object
        if target_object is None:
            return False
        for event in target_object.events:
            if event.what in ("closed", "missed") and event.time != self._tried_at:
                self.tables = self._untried
                self._tried_at = event.time
            tables = self.tables
            i = self._grippers.index(event.gripper)
            if event.what in ("closed", "missed"):
                tables["grasp/missed_by"][i] = event.values
            if event.what == "closed":
                tables["grasp/closed_at"][i] = event.time
            elif event.what != "missed":
                tables["grasp/opened_at"][i] = event.time
                tables["grasp/lost"][i] = event.what == "lost"
                if np.isnan(tables["object/left_at"]):
                    tick = int(np.argmin(np.abs(sample.ticks.time - event.time)))
                    tables["object/left_at"] = np.array(event.time)
                    tables["object/left_pose"] = target_object.pose[tick]
                    tables["object/left_velocity"] = target_object.v[tick]
        return bool(target_object.events)
