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
from psmpc_cli.specs.robots.robot import Limits
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
        wheel_momenta: np.ndarray | None = None,
    ) -> None:
        """Prepare the measurement of a run, and compute momentum and energy of robot, object and wheels at its start.

        From these, impulse and work, it is known throughout the run what momentum and energy there should be; a
        difference is an error of the simulation.

        Args:
            counterfactuals: Solves windows that are measured and never applied. From them follow the presence of stages
                (how much a stage that waits already acts on the control) and their shares of the applied control.
            uncertainty: What differs between the true robot and the one that the controller knows; None where nothing
                does.
            capture: The object with its grasps; None without an object that has a mass.
            initial_state: Initial state [Q; v] (nq + n,).
            wheel_momenta: Angular momenta that reaction wheels store at first (W,) [N m s]; None of a robot without
                any.
        """
        problem = counterfactuals.problem
        self._capture = capture
        self._counterfactuals = counterfactuals
        self._uncertainty = uncertainty
        self._problem = problem
        # without noise and delay the state that the controller saw is the true one
        self._sees_the_state = problem.spec.sees_the_state
        self._logs_shares = problem.spec.log.shares
        self._noise = standard_deviations(problem.spec.uncertainty.noise, problem.model.spec)
        self._force_limits = force_limits_of(problem.spec, problem.model.spec)
        self._clearance = ClearanceMeter(problem) if problem.spec.keeps_clear else None
        self._acts_in_task_space = problem.spec.acts_in_task_space
        self._base_rates = problem.model.parts["base"]
        self._is_sliding_joint = np.array([joint.prismatic for joint in problem.model.spec.joints], bool)
        self._sample_number = 0
        self._tick_length = 1 / problem.spec.plant.low_level_rate
        self._wheels = Wheels.of(problem.model.spec)
        # momentum and energy that there should be (4,) or (7,): those at the start, then impulse and work are added
        expected_balance = self._momentum_and_energy_of_robot(0, initial_state[None])[0]
        expected_balance = expected_balance + (0.0 if capture is None else capture.momentum_and_energy)
        if wheel_momenta is not None:
            initial_Q = initial_state[None, : problem.model.nq]
            expected_balance = expected_balance + self._wheels.momentum_and_energy(initial_Q, wheel_momenta[None])[0]
        self._expected_balance = expected_balance

    def measure(
        self,
        command: Command,
        ticks: Ticks,
        state: np.ndarray,
        u: np.ndarray,
        contact: Contact | None,
        in_force: Command,
    ) -> Sample:
        """Collect what the metrics of a sample are computed from when they are first read.

        Computed at once is only what later samples would change. These are the presence of stages (how much a stage
        that waits already acts on the control) and their shares of the control, which take further solves; and the
        momentum and energy that robot and load should have by now, which are summed up from sample to sample.

        Args:
            command: What the controller decided.
            ticks: What the plant did, tick by tick, until the next sample.
            state: True state [Q; v] (nq + n,), before anything is taken up or let go.
            u: Accelerations that reached the robot over the M ticks (M, n).
            contact: Effect of taking up or letting go of a payload at the sample; None without a payload.
            in_force: The command that acts when the sample begins, an earlier one where commands are late.

        Returns:
            The sample, whose metrics are still to be computed.
        """
        impulse_and_work = ticks.impulse_and_work
        if contact is not None:
            impulse_and_work = impulse_and_work + contact.momentum_and_energy
        self._expected_balance = self._expected_balance + impulse_and_work
        if "returned" in command.events:  # to an earlier stage, after grippers missed or lost the object
            self._counterfactuals.forget_plans()
        pending = PendingSample(
            command=command,
            ticks=ticks,
            presence=self._counterfactuals.presence(command),
            shares=self._counterfactuals.shares(command) if self._logs_shares else {},
            # without uncertainty the controller saw the true state, to the bit
            state=command.state if self._sees_the_state and command.delay == 0.0 else state,
            in_force=in_force,
            u=u,
            contact=contact,
            object_balance=0.0 if self._capture is None else self._capture.momentum_and_energy,
            expected_balance=self._expected_balance,
        )
        sample = Sample(pending, number=self._sample_number, stages=len(self._problem.stages), measure=self.metrics)
        self._sample_number += 1
        return sample

    def metrics(self, samples: Sequence[PendingSample]) -> list[dict[str, Any]]:
        """Compute the metrics of samples, by their paths in the log; consecutive samples of one stage at once."""
        stages = groupby(samples, lambda sample: sample.in_force.stage)
        return [row for _, of_stage in stages for row in self._metrics_in_stage(list(of_stage))]

    def _metrics_in_stage(self, samples: Sequence[PendingSample]) -> list[dict[str, Any]]:
        """Compute the metrics of K samples of one stage at once for the log, which is faster than one by one.

        Args:
            samples: The samples. All share one chart (local coordinates of configurations). Spatial robots have a chart
                of its own at each sample, so there K is 1.

        Returns:
            For each sample its metrics, by their paths in the log.
        """
        command = samples[0].in_force  # the command that acts, an earlier one than the sample's where commands are late
        stage = command.stage
        chart = command.solution.window.chart
        X_of_samples = [chart.states_in_chart(sample.ticks.states) for sample in samples]
        values_by_path = {
            "window/presence": [sample.presence for sample in samples],
            "window/share": [sample.shares for sample in samples],
            **self._states_and_costs(stage, chart, samples),
            # the task's own limits: those of the placed stage are tighter by a reserve of speed
            **self._margins(self._problem.stages[stage.index].limits, samples, X_of_samples),
            **self._speed_reserve(samples),
            **self._efforts_and_peaks(stage, samples),
            **self._deviations(chart, samples, X_of_samples),
            **self._balances(stage.index, samples),
            "force/own_axes": self._along_base_axes([sample.ticks for sample in samples]),
            **self._wheel_use([sample.ticks.wheels for sample in samples]),
            **({} if self._force_limits is None else self._force_use(self._force_limits, samples)),
            **({} if self._clearance is None else self._clearances(self._clearance, stage.index, chart, samples)),
        }
        # from one column for each path to one row for each sample
        values_of_samples = list(zip(*values_by_path.values(), strict=True))
        for values_of_sample in values_of_samples:
            make_read_only(*values_of_sample)  # whoever watches the run must not change its log
        return [dict(zip(values_by_path, values_of_sample, strict=True)) for values_of_sample in values_of_samples]

    def _states_and_costs(
        self, stage: PlacedStage, chart: Chart, samples: Sequence[PendingSample]
    ) -> dict[str, np.ndarray]:
        """Compute true states and poses at K samples, the first control after them, and the stage's running cost there.

        Args:
            stage: The stage with its target at the samples.
            chart: Local coordinates of configurations in which the cost is written.
            samples: The samples.

        Returns:
            Arrays with a row for each sample, by path in the log.
        """
        model = self._problem.model
        states = np.array([sample.state for sample in samples])
        Q = states[:, : model.nq]
        u = np.array([sample.u[0] for sample in samples])
        # time since the stage began [s], by which a moving target is read
        since_entry = np.array([sample.ticks.time[0] - sample.in_force.sequence.progress.entered for sample in samples])
        columns = {
            "state/Q_true": Q,
            "state/Qdot_true": states[:, model.nq :],
            "control/u": u,
            "pose/xi": model.poses(Q).reshape(len(states), -1),
            "cost/current_stage": self._problem.costs.at(stage, chart.states_in_chart(states), u, since_entry),
        }
        if self._acts_in_task_space:
            columns["pose/condition"] = model.task_space_condition(Q)
        return columns

    def _margins(
        self, limits: Limits, samples: Sequence[PendingSample], X_of_samples: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Compute how near states come to their limits over the ticks of K samples, as simulated and as planned.

        Args:
            limits: Limits of positions, and of velocities v.
            samples: The samples.
            X_of_samples: For each the states [Q; Qdot] in the chart (local coordinates) at its M + 1 ticks
                (M + 1, 2n).

        Returns:
            The smallest margins (K, n) of positions [m, rad] and velocities [m/s, rad/s], by path in the log; negative
            beyond a limit.
        """
        n = self._problem.model.n
        # the first tick is left out: it is the last one of the sample before
        simulated = np.stack([X[1:] for X in X_of_samples], axis=1)  # (M, K, 2n)
        # limits hold for v; in a chart of a spatial robot the rates Qdot of attitude differ from it
        v = [sample.ticks.states[1:, self._problem.model.nq :] for sample in samples]
        simulated[:, :, n:] = np.stack(v, axis=1)
        planned = np.array([_planned_states(sample.in_force, sample.ticks) for sample in samples])  # (K, M, 2n)
        margin = _smallest_margins(simulated, limits)
        planned_margin = _smallest_margins(planned.swapaxes(0, 1), limits)
        return {
            "margin/position": margin[:, :n],
            "margin/velocity": margin[:, n:],
            "margin/planned_position": planned_margin[:, :n],
            "margin/planned_velocity": planned_margin[:, n:],
        }

    def _speed_reserve(self, samples: Sequence[PendingSample]) -> dict[str, list[np.ndarray]]:
        """Return by how much the plans of K samples were to stay below limits of velocities, (n,) each, by path.

        Empty in a task whose plans may use all of their limits.
        """
        if not self._problem.spec.controller.speed_reserve:
            return {}
        return {"margin/speed_reserve": [sample.in_force.stage.speed_reserve.max(axis=0) for sample in samples]}

    def _efforts_and_peaks(self, stage: PlacedStage, samples: Sequence[PendingSample]) -> dict[str, np.ndarray]:
        """Integrate controls and forces over the ticks of K samples, and find their largest values.

        Positions and angles have different units, so forces and accelerations are reduced to four numbers: of the base
        linear and angular, and of joints that turn and that slide.

        Args:
            stage: The stage of the samples, which tells what moves the base.
            samples: The samples.

        Returns:
            Efforts and peaks (K,), by path in the log. An effort is an integral over the sample: of a force or torque
            [N s, N m s], or of squared accelerations.
        """
        ticks = [sample.ticks for sample in samples]
        forces = np.array([ticks_of_sample.F for ticks_of_sample in ticks])
        force, torque, joint_torque, sliding_force = self._norms_by_unit(forces)
        accelerations = np.array([sample.u for sample in samples])
        linear, angular, joint, sliding = self._norms_by_unit(accelerations)
        # the accelerations of a base that nothing moves are reactions, not controls, and cost no effort
        controls = accelerations * self._problem.model.actuated(stage.moved_by)
        # effort of control: T_s |dv / T_s|^2, with dv the integral of the accelerations over a sample of length T_s
        mean_controls = controls.mean(axis=1)
        sample_time = self._tick_length * accelerations.shape[1]
        return {
            "effort/control": sample_time * (mean_controls**2).sum(axis=1),
            "effort/squared_acceleration": self._tick_length * (controls**2).sum(axis=(1, 2)),
            "effort/base_force": self._tick_length * force.sum(axis=1),
            "effort/base_torque": self._tick_length * self._torque_of_thrusters(ticks, torque).sum(axis=1),
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
        self, chart: Chart, samples: Sequence[PendingSample], X_of_samples: Sequence[np.ndarray]
    ) -> dict[str, Any]:
        """Compute how far the true states at the ends of K samples are from their plans, and errors of end conditions.

        Args:
            chart: Local coordinates of configurations, of the samples.
            samples: The samples.
            X_of_samples: For each the states [Q; Qdot] in the chart at its M + 1 ticks (M + 1, 2n).

        Returns:
            By path in the log: deviations of Q and of v (K, n); and for each sample the errors of the end conditions of
            stages that end in it, by stage index [1]: over their tolerances, and over tolerances that are widened by
            the noise of measurements.
        """
        model = self._problem.model
        n = model.n
        end_states = np.array([sample.ticks.states[-1] for sample in samples])
        plans = [sample.in_force.plan for sample in samples]
        planned_Q, planned_v = chart.from_chart(states_of(plans, [sample.ticks.time[-1] for sample in samples]))
        # the difference of attitudes is taken in a chart about the planned one, where it is a rotation vector; a robot
        # in space has one sample here, and one in the plane the same chart everywhere, so the first row serves for all
        chart_of_plan = model.space.chart_at(planned_Q[0])
        X_difference = chart_of_plan.states_in_chart(end_states) - chart_of_plan.to_chart(planned_Q, planned_v)
        end_errors = [
            self._errors_of_ended_stages(sample.in_force, sample.ticks, X_of_sample)
            for sample, X_of_sample in zip(samples, X_of_samples, strict=True)
        ]
        return {
            "deviation/Q": X_difference[:, :n],
            "deviation/Qdot": end_states[:, model.nq :] - planned_v,
            "deviation/end": [{stage: error for stage, (error, _) in by_stage.items()} for by_stage in end_errors],
            "deviation/end_noise": [
                {stage: error for stage, (_, error) in by_stage.items()} for by_stage in end_errors
            ],
        }

    def _balances(self, stage: int, samples: Sequence[PendingSample]) -> dict[str, Any]:
        """Check the simulation by its balances: compute drifts of momentum and energy at the ends of K samples.

        A balance is one vector (4,) in the plane or (7,) in space: linear and angular momentum, then kinetic energy
        [N s, N m s, J]. The drift is the balance of robot, object and wheels, less what they should have by impulse and
        work since the start. A payload changes the robot's energy when it is taken up, which is returned as well.

        Args:
            stage: Index of the stage of the samples.
            samples: The samples.

        Returns:
            A value or row for each sample, by path in the log.
        """
        end_states = np.array([sample.ticks.states[-1] for sample in samples])
        # one column of zeros, which is broadcast below, without an object
        object_balance = np.array([sample.object_balance for sample in samples]).reshape(len(end_states), -1)
        expected_balance = np.array([sample.expected_balance for sample in samples])
        drift = self._momentum_and_energy_of_robot(stage, end_states) + object_balance - expected_balance
        drift = drift + self._momentum_and_energy_of_wheels(end_states, [sample.ticks.wheels for sample in samples])
        holds_payload = self._uncertainty is not None and self._uncertainty.holds(stage)
        contacts = [sample.contact for sample in samples]
        return {
            "balance/momentum": drift[:, :-1],
            "balance/energy": drift[:, -1],
            "payload/held": [holds_payload] * len(samples),
            "payload/energy": [0.0 if contact is None else contact.momentum_and_energy[-1] for contact in contacts],
        }

    def _momentum_and_energy_of_wheels(
        self, states: np.ndarray, ticks: Sequence[WheelTicks | None]
    ) -> np.ndarray | float:
        """Return momentum and energy of wheels at the ends of samples in states (K, nq + n), (K, 4 or 7).

        Args:
            states: True states [Q; v] at the ends of K samples (K, nq + n).
            ticks: What the wheels did in each sample; None of a robot without wheels, for which 0 is returned.
        """
        stored = [wheels_of_sample.momentum[-1] for wheels_of_sample in ticks if wheels_of_sample is not None]
        if len(stored) < len(states):
            return 0.0
        return self._wheels.momentum_and_energy(states[:, : self._problem.model.nq], np.array(stored))

    def _torque_of_thrusters(self, ticks: Sequence[Ticks], torque_norms: np.ndarray) -> np.ndarray:
        """Compute the norms of the torques that thrusters put on the base, since wheels use no propellant.

        The torque on the base is the sum of both. The motor of a wheel accelerates the wheel with a torque, and the
        base feels the opposite: so thrusters give the torque on the base plus the torques of the motors.

        Args:
            ticks: What the plant did over K samples of M ticks.
            torque_norms: Norms of all torques on the base (K, M) [N m].

        Returns:
            Norms (K, M) [N m]; of a robot without wheels `torque_norms`.
        """
        sum_along_base_axes = self._wheels.along_base  # in the order in which plants do it: exactly 0 without thrust
        motor_torques = [
            np.transpose(sum_along_base_axes(list(ticks_of_sample.wheels.torque.T)))
            for ticks_of_sample in ticks
            if ticks_of_sample.wheels is not None
        ]
        if len(motor_torques) < len(ticks):
            return torque_norms
        rotation = self._problem.model.space.rotation  # the coordinates of the base's turn
        base_torques = np.array([ticks_of_sample.F for ticks_of_sample in ticks])[..., rotation]
        return np.asarray(np.linalg.norm(base_torques + np.array(motor_torques), axis=-1))

    def _wheel_use(self, wheel_ticks: Sequence[WheelTicks | None]) -> dict[str, list[np.ndarray]]:
        """Return the momenta of wheels when K samples begin, and the largest torques of their motors in each sample.

        A largest torque has its sign: it is the one that is furthest from 0.

        Args:
            wheel_ticks: Momenta (M + 1, W) and torques (M, W) of the W wheels at the ticks of each sample; None without
                wheels.

        Returns:
            For each sample an array (W,) [N m s] and [N m], by path in the log; empty without wheels.
        """
        wheels_of_samples = [wheels_of_sample for wheels_of_sample in wheel_ticks if wheels_of_sample is not None]
        if len(wheels_of_samples) < len(wheel_ticks):
            return {}
        # the tick at which each motor has its largest torque
        peak_ticks = [np.abs(wheels_of_sample.torque).argmax(axis=0) for wheels_of_sample in wheels_of_samples]
        return {
            "wheels/momentum": [wheels_of_sample.momentum[0] for wheels_of_sample in wheels_of_samples],
            "wheels/torque": [
                np.take_along_axis(wheels_of_sample.torque, peak_tick[None], axis=0)[0]
                for wheels_of_sample, peak_tick in zip(wheels_of_samples, peak_ticks, strict=True)
            ],
        }

    def _along_base_axes(self, ticks: Sequence[Ticks]) -> np.ndarray:
        """Return the forces at samples, those of the base along its own axes, (K, n)."""
        Q = np.array([of_sample.states[0, : self._problem.model.nq] for of_sample in ticks])
        F = np.array([of_sample.F[0] for of_sample in ticks])
        return np.column_stack(self._problem.model.space.along_base_axes(Q.T, F.T))

    def _force_use(self, limits: ForceLimits, samples: Sequence[PendingSample]) -> dict[str, np.ndarray]:
        """Compute how near commanded forces come to their limits in K samples, and how often the plant cuts them.

        Args:
            limits: Limits at which the plant cuts generalized forces.
            samples: The samples, of M ticks each.

        Returns:
            By path in the log: the largest utilization of each coordinate's limit in the sample (K, n) [1], 1 at the
            limit; and the fraction of ticks with a force that is cut (K,) [1], NaN where forces are not known.
        """
        model = self._problem.model
        F = np.array([sample.ticks.F for sample in samples])  # (K, M, n)
        commanded = np.array([sample.commanded for sample in samples])
        Q = np.array([sample.ticks.states[:-1, : model.nq] for sample in samples])
        utilization = limits.utilization(model.space, Q, commanded)  # (K, M, n)
        # a force that differs from a commanded one within its limits was not cut at them
        is_cut = (commanded != F).any(axis=2) & (utilization > 1 + NOT_CUT).any(axis=2)
        is_unknown = np.isnan(F).any(axis=2)  # in a loop of the user's own
        return {
            "force/utilization": utilization.max(axis=1),
            "force/saturated": np.where(is_unknown, np.nan, is_cut).mean(axis=1),
        }

    def _clearances(
        self, meter: ClearanceMeter, stage: int, chart: Chart, samples: Sequence[PendingSample]
    ) -> dict[str, np.ndarray]:
        """Collect how near bodies that keep clear of each other come over K samples of a stage, for the log.

        Args:
            meter: Measures the P pairs of bodies.
            stage: Index of the stage.
            chart: Local coordinates of configurations, of the samples.
            samples: The samples.

        Returns:
            By path in the log: the smallest distance of each pair in the sample (K, P) [m]; the two points of the
            bodies between which it is, in the inertial frame (K, P, 6) [m]; and the distance less the margin that the
            stage is to keep (K, P) [m].
        """
        measured = [meter.measure(stage, chart, sample.ticks) for sample in samples]
        smallest = np.array([distance for distance, _ in measured])
        return {
            "clearance/distance": smallest,
            "clearance/points": np.array([points for _, points in measured]).reshape(
                len(measured), len(meter.pairs), 6
            ),
            "clearance/margin": smallest - meter.margins[stage],
        }

    def _norms_by_unit(self, generalized: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Reduce generalized forces or accelerations to four numbers a tick, each over components of the same unit.

        Args:
            generalized: Generalized forces or accelerations (K, M, n), of the base first.

        Returns:
            Norms (K, M) of the base's linear and of its angular part; the largest absolute values (K, M) among joints
            that turn, and among joints that slide, 0 where there are none.
        """
        dimension = self._problem.model.dimension
        base = generalized[..., self._base_rates]
        joints = np.abs(np.delete(generalized, self._base_rates, axis=-1))
        linear = np.linalg.norm(base[..., :dimension], axis=-1)
        angular = np.linalg.norm(base[..., dimension:], axis=-1)
        turning = joints[..., ~self._is_sliding_joint].max(axis=-1, initial=0.0)
        sliding = joints[..., self._is_sliding_joint].max(axis=-1, initial=0.0)
        return linear, angular, turning, sliding

    def _momentum_and_energy_of_robot(self, stage: int, states: np.ndarray) -> np.ndarray:
        """Return momentum [N s, N m s] and energy [J] of the robot at states (K, nq + n) in a stage, (K, 4 or 7)."""
        nq = self._problem.model.nq
        uncertainty = self._uncertainty
        robot = None if uncertainty is None else uncertainty.true_parameters(stage)
        return self._problem.model.balance(states[:, :nq], states[:, nq:], robot)

    def _errors_of_ended_stages(
        self, command: Command, ticks: Ticks, X_of_ticks: np.ndarray
    ) -> dict[int, tuple[float, float]]:
        """Compute how well the stages that end in a sample met their end conditions, for the log.

        A stage ends at its planned switch time, or at the sample where the measured state meets its condition. A
        planned time may lie up to `SHORTEST` after the next sample: so far the motion is extrapolated. A target
        relative to the object is where the object really is then, not where it was predicted.

        Args:
            command: The command in force.
            ticks: What the plant did over the sample.
            X_of_ticks: The states at its M + 1 ticks, in the chart of the sample (M + 1, 2n).

        Returns:
            By index of the stages that end: the error of the end condition over its tolerance [1], and the same with
            the tolerance widened by what the noise of measurements may do.
        """
        stages = command.problem.stages
        chart = command.solution.window.chart
        Q, v = np.split(ticks.states[0], [self._problem.model.nq])
        # stages that the measured state ended, at the beginning of the sample
        errors = {
            stage_index: self._end_errors_with_object(stages[stage_index], Q, v, ticks, time)
            for stage_index, time in command.switches
            if time == command.acts_at
        }
        # stages whose planned end is in the sample; the window's last one has no switch time
        for stage, switch_time in zip(command.solution.window.stages, command.switch_times, strict=False):
            if switch_time > ticks.time[-1] + SHORTEST:
                continue
            time = float(switch_time)
            x = interpolate_state(ticks.time, X_of_ticks, time)
            if stage.on_object:
                Q, v = (one_row[0] for one_row in chart.from_chart(x[None]))
                errors[stage.index] = self._end_errors_with_object(stages[stage.index], Q, v, ticks, time)
            else:
                errors[stage.index] = self._end_errors(stage, x)
        return errors

    def _end_errors_with_object(
        self, stage: Stage, Q: np.ndarray, v: np.ndarray, ticks: Ticks, time: float
    ) -> tuple[float, float]:
        """Return the two errors of `_end_errors` of a stage, whose target is relative to the object as it really moves.

        Args:
            stage: The stage, without the object's state.
            Q: Coordinates of the robot at the stage's end (nq,).
            v: Its velocities then (n,).
            ticks: What the plant did over the sample, the object's motion included.
            time: When the stage ends [s].

        Returns:
            The errors; NaN if the target is on an object whose motion is not known.
        """
        object_state = self._object_state(ticks, time)
        if stage.on_object and object_state is None:
            return np.nan, np.nan
        return self._end_errors(*in_own_chart(self._problem.model, stage, Q, v, object_state=object_state))

    def _object_state(self, ticks: Ticks, time: float) -> ObjectState | None:
        """Return pose and velocity of the object at a time [s], moved freely since the tick before; None if unknown."""
        target_object = ticks.target_object
        if target_object is None or self._capture is None:
            return None
        tick = int(np.clip(np.searchsorted(ticks.time, time, side="right") - 1, 0, len(ticks.time) - 1))
        since = time - float(ticks.time[tick])
        return self._capture.body.predicted(target_object.pose[tick], target_object.v[tick], since)

    def _end_errors(self, stage: Stage, x: np.ndarray) -> tuple[float, float]:
        """Return the error of a stage's end condition at a state x (2n,) over its tolerance, without and with noise.

        With noise, twice the standard deviation that measurements have is added to the tolerance. Both are NaN for a
        stage without an end condition.
        """
        costs = self._problem.costs
        if not stage.end.has_condition:
            return np.nan, np.nan
        allowance = 2 * costs.end_deviations(stage, x, self._noise)
        return costs.end_error(stage, x), costs.end_error(stage, x, allowance)


def _smallest_margins(X: np.ndarray, limits: Limits) -> np.ndarray:
    """Return the smallest distances of [Q; v] to their limits over the ticks, (K, 2n), of states (ticks, K, 2n)."""
    return np.asarray(np.minimum(X.min(axis=0) - limits.state_low, limits.state_high - X.max(axis=0)))


def _planned_states(command: Command, ticks: Ticks) -> np.ndarray:
    """Return [Q; v] of a sample's plan at the ticks after the first (M, 2n), Q in the plan's chart."""
    X = command.plan.states_at(ticks.time[1:])
    _, v = command.plan.chart.from_chart(X)
    return np.hstack([X[:, : v.shape[1]], v])


def interpolate_state(times: np.ndarray, X: np.ndarray, time: float) -> np.ndarray:
    """Interpolate a motion at a time [s], which may also be soon after its last state.

    Between two states the acceleration is taken for constant, and after the last it stays what it was.

    Args:
        times: Times of the states (M,) [s].
        X: The states [Q; Qdot] (M, 2n).
        time: The time [s].

    Returns:
        The state then (2n,).
    """
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    n = X.shape[1] // 2
    since = time - times[k]
    acceleration = (X[k + 1, n:] - X[k, n:]) / (times[k + 1] - times[k])
    Qdot = X[k, n:] + since * acceleration
    return np.concatenate([X[k, :n] + since / 2 * (X[k, n:] + Qdot), Qdot])


class Counterfactuals:
    """Solves windows over other stages than the applied one: what would the control be without a stage, or by it alone?

    Their plans are measured and never applied. Each solve starts from the last plan of its own stages.
    """

    def __init__(self, controller: Controller) -> None:
        """Use the solver and the builder of windows of a controller, without changing what it remembers."""
        self.problem = controller.problem
        self.onset = controller.problem.spec.onset
        self._solver = controller.law.solver
        self._builder = controller.law.builder
        self._plans_and_solutions: dict[tuple[int, int], tuple[Plan, Solution]] = {}
        self._started: set[int] = set()

    def forget_plans(self) -> None:
        """Forget plans and early starts: the sequence has returned to an earlier stage, and stages start anew."""
        self._plans_and_solutions.clear()
        self._started.clear()

    def presence(self, command: Command) -> dict[int, float]:
        """Measure how much each stage that waits in the window already acts on the control.

        A window is solved that ends with the stage before the waiting one, and its mean control over the sample is
        compared with the applied one. With `onset: control` the presence is the norm of the difference [m/s^2,
        rad/s^2]; with `onset: closeness` it is how near that brings the control to the stage's own optimum [1], see
        `closeness`. Only the coordinates that the skill names for it count. A stage is measured until its presence
        reaches the largest threshold of the task: from then on it has started.

        Args:
            command: What the controller decided at the sample.

        Returns:
            The presence by index of the stages that are measured; empty if none waits, or if the robot brakes without a
            plan.
        """
        sequence = command.sequence
        presence = {}
        if sequence.count == 1 or "braking" in command.events:
            return {}
        sample_span = command.edges[[0, -1]]  # from the first tick to the end of the last [s]
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self._started:
                continue
            sequence_without = sequence.up_to(stage - 1)
            plan_without, _ = self._solved_or_shifted_plan(sequence_without, command)
            onset_rows = list(command.stages[stage].onset_rows)
            applied_control = command.plan.mean_control(sample_span)[0, onset_rows]
            control_without = plan_without.mean_control(sample_span)[0, onset_rows]
            if self.onset.kind == "control":
                presence[stage] = float(np.linalg.norm(applied_control - control_without))
            else:
                sequence_alone = MovingSequence.of(stage, command.acts_at)
                plan_alone, is_solved = self._solved_or_shifted_plan(sequence_alone, command)
                if not is_solved:
                    continue
                control_alone = plan_alone.mean_control(sample_span)[0, onset_rows]
                presence[stage] = closeness(applied_control, control_without, control_alone)
            if presence[stage] >= max(self.onset.epsilon, *self.onset.series):
                self._started.add(stage)
        return presence

    def shares(self, command: Command) -> dict[int, float]:
        """Compute the share that each stage has in the applied control, for the log and for Fig. 1 of the paper.

        Every stage in the window is solved for alone. Under HTMPC, which solves for one stage after the other (its
        levels), every stage with a level is. The shares are the weights of the convex combination of these controls, at
        the first tick, that is nearest to the applied control.

        Args:
            command: What the controller decided at the sample.

        Returns:
            The shares by stage index, nonnegative with sum 1. Empty where all of the controls are the same, where a
            stage has no solution alone, or where the robot brakes without a plan.
        """
        first = command.sequence.first
        count = max(command.sequence.count, len(command.levels))
        if "braking" in command.events:
            return {}
        if count == 1:
            return {first: 1.0}
        controls = []
        first_tick = command.edges[:2]  # its beginning and end [s]
        for stage in range(first, first + count):
            sequence_alone = MovingSequence.of(stage, command.acts_at)
            if stage == first:
                sequence_alone = command.sequence.up_to(stage)  # keeps how far the current stage has come
            plan, is_solved = self._solved_or_shifted_plan(sequence_alone, command)
            if not is_solved:
                return {}
            controls.append(plan.mean_control(first_tick)[0])
        controls_alone = np.array(controls)  # (stages, n)
        if np.ptp(controls_alone, axis=0).max() < DISTINCT:
            return {}
        weights = nearest_combination(controls_alone, command.plan.mean_control(first_tick)[0])
        return dict(enumerate(map(float, weights), start=first))

    def _solved_or_shifted_plan(self, sequence: MovingSequence, command: Command) -> tuple[Plan, bool]:
        """Solve a window over other stages than the applied one, to see what the control would be with these.

        The solve starts warm from the last plan and solution of the same stages. If they were solved for at this sample
        already, that plan is returned. If the solve fails, the plan of an earlier sample is returned, shifted to now.

        Args:
            sequence: The stages of the window, with their switch times.
            command: The command of the sample, whose state, horizon and mesh are used.

        Returns:
            The plan, and whether it is a solution of this sample's window (otherwise it is a shifted plan).
        """
        key = (sequence.first, sequence.last)
        last_plan, last_solution = self._plans_and_solutions.get(key, (None, None))
        if last_plan is not None and last_solution is not None and last_plan.start >= command.acts_at:
            return last_plan, last_solution.outcome.usable  # of this sample
        prediction = command.prediction
        applied_window = command.solution.window
        if last_plan is not None:
            plan_in_chart = last_plan.in_chart(applied_window.chart)
            prediction = shift(plan_in_chart, command.acts_at, applied_window.horizon, applied_window.x0)
        window = self._builder.build(
            sequence, command.stages, prediction, last_solution or command.solution, applied_window.applied
        )
        guess = sequence.guess(prediction)
        solution = self._solver.solve(_with_nodes_of(applied_window, window), guess, last_solution)
        is_solved = solution.outcome.usable
        plan = solution.plan if is_solved else prediction
        self._plans_and_solutions[key] = plan, solution
        return plan, is_solved


def _with_nodes_of(applied: Window, window: Window) -> Window:
    """Return a window with the nodes of the applied one in all stages that end in both.

    What a stage adds to a control is to be seen, not what a finer mesh does.
    """
    applied_nodes = {stage.index: N for stage, N in zip(applied.stages[:-1], applied.nodes, strict=False)}
    stages_that_end = zip(window.stages[:-1], window.nodes, strict=False)
    nodes = (applied_nodes.get(stage.index, N) for stage, N in stages_that_end)
    return replace(window, nodes=(*nodes, window.nodes[-1]))


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


def nearest_combination(controls: np.ndarray, applied: np.ndarray) -> np.ndarray:
    """Compute weights (S,) that combine S controls (S, n) to the one nearest to the applied control (n,).

    The weights are nonnegative and sum up to 1.

    With differences D = (controls - applied)', nonnegative w that minimize |D w|^2 + (sum w - 1)^2 are a multiple of
    the weights: for w = s c with sum c = 1 the minimum over s is d^2 / (1 + d^2), d = |D c|, which rises with d. So
    nonnegative least squares solves it.
    """
    differences = (controls - applied).T
    scale = max(float(np.linalg.norm(differences, axis=0).max()), DISTINCT)
    weights, _ = nnls(np.vstack([differences / scale, np.ones(len(controls))]), np.r_[np.zeros(len(applied)), 1.0])
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
        self._started_early_at = np.full((stages, len(self.thresholds)), np.nan)
        self._entered_again_at = np.full(stages, np.nan)

    def update(self, sample: Sample) -> bool:
        """Take in a sample: when stages ended, and when they first acted on the control.

        A stage acts from the first sample on at which its presence (how much it changes the control while it still
        waits) reaches a threshold. If the sequence returns to an earlier stage, because grippers missed the object, the
        times of that stage and of all after it are forgotten.

        Args:
            sample: The sample that follows the one before.

        Returns:
            Whether any of the times has changed, so that the log has to be written anew.
        """
        command = sample.command
        self.end(command.switches)
        changed = bool(command.switches)
        if "returned" in command.events:
            stages_that_come_again = slice(command.sequence.first, None)
            self.switch_time[stages_that_come_again] = np.nan
            self._started_early_at[stages_that_come_again] = np.nan
            self._entered_again_at[stages_that_come_again] = np.nan
            self._entered_again_at[command.sequence.first] = command.time
            changed = True
        for stage, presence in sample.presence.items():
            newly_reached = (presence >= self.thresholds) & np.isnan(self._started_early_at[stage])
            self._started_early_at[stage, newly_reached] = sample.command.acts_at
            changed |= bool(newly_reached.any())
        return changed

    def end(self, switches: tuple[Switch, ...]) -> None:
        """Keep the switch times of stages that ended."""
        for switch in switches:
            self.switch_time[switch.stage] = switch.time

    @property
    def tables(self) -> dict[str, np.ndarray]:
        """The times as known so far, by their paths in the log."""
        end_of_stage_before = np.r_[0.0, self.switch_time[:-1]]
        regular_starts = np.where(np.isnan(self._entered_again_at), end_of_stage_before, self._entered_again_at)
        starts = np.where(np.isnan(self._started_early_at), regular_starts[:, None], self._started_early_at)
        return {
            "stages/switch_time": self.switch_time.copy(),
            "stages/actual_start": starts[:, -1],
            "stages/early": ~np.isnan(self._started_early_at[:, -1]),
            "stages/actual_start_by_epsilon": starts[:, :-1],
        }


class GraspRecord:
    """Follows the grasps of a run: when, and how near, each closed, when and why it opened, where the object was.

    Each time the grippers are to close the record begins anew, so that at the end it is that of the last try.
    """

    def __init__(self, capture: Capture) -> None:
        self._gripper_names = list(capture.law.grippers)
        self._last_try_at = np.nan
        self._not_left = {
            "object/left_at": np.array(np.nan),
            "object/left_pose": np.full_like(capture.pose_and_velocity[0], np.nan),
            "object/left_velocity": np.full_like(capture.pose_and_velocity[1], np.nan),
        }
        self.tables = self._untried

    @property
    def _untried(self) -> dict[str, np.ndarray]:
        """What the record holds before the grippers are to close."""
        count = len(self._gripper_names)
        return {
            "grasp/closed_at": np.full(count, np.nan),
            "grasp/missed_by": np.full((count, len(MISSED_BY)), np.nan),
            "grasp/opened_at": np.full(count, np.nan),
            "grasp/lost": np.full(count, -1),
            **self._not_left,
        }

    def update(self, sample: Sample) -> bool:
        """Take in a sample: when grippers closed on the object, missed it, let it go or lost it.

        A new try to close begins the record anew: in the log are the times, the errors at closing and the place where
        the object was let go, of the last try. NaN is what has not happened.

        Args:
            sample: The sample that follows the one before.

        Returns:
            Whether the record has changed, so that the log has to be written anew.
        """
        target_object = sample.ticks.target_object
        if target_object is None:
            return False
        for event in target_object.events:
            # all grippers try to close at the same time: another time is another try
            if event.what in ("closed", "missed") and event.time != self._last_try_at:
                self.tables = self._untried
                self._last_try_at = event.time
            tables = self.tables
            gripper = self._gripper_names.index(event.gripper)
            if event.what in ("closed", "missed"):
                tables["grasp/missed_by"][gripper] = event.values
            if event.what == "closed":
                tables["grasp/closed_at"][gripper] = event.time
            elif event.what != "missed":  # let go or lost
                tables["grasp/opened_at"][gripper] = event.time
                tables["grasp/lost"][gripper] = event.what == "lost"
                if np.isnan(tables["object/left_at"]):  # the first gripper to open
                    tick = int(np.argmin(np.abs(sample.ticks.time - event.time)))
                    tables["object/left_at"] = np.array(event.time)
                    tables["object/left_pose"] = target_object.pose[tick]
                    tables["object/left_velocity"] = target_object.v[tick]
        return bool(target_object.events)
