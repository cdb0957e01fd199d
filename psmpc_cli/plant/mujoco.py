"""MuJoCo, rigid-body dynamics of other authors, under the computed-torque law (7)."""

import logging

import mujoco
import numpy as np

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.plant.base import ForceLimits, JointFriction, Plant, TickedPlant
from psmpc_cli.plant.grasp import CapturePlant, GraspLaw, PlantSetup
from psmpc_cli.plant.thrusters import ThrusterFiring
from psmpc_cli.plant.wheels import WheelDrive
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.kinematics import runge_kutta
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import OBJECT, mujoco_spec, set_wheel_inertias, wheel_names

logger = logging.getLogger(__name__)


class MujocoPlant(TickedPlant):
    """Steps MuJoCo's model of the robot with its Runge-Kutta integrator, `substeps` steps a tick.

    The robot model serves the low-level law alone, which is part of the controller. MuJoCo returns nothing but Q and
    v, so momentum and energy of the robot model at its states, less impulse and work, show whether the two agree.
    With friction it is a disturbed plant; friction is then added to the forces before each step of the integrator,
    because MuJoCo's own friction is not a smooth function of the rate.
    """

    def __init__(
        self,
        model: RobotModel,
        tick: float,
        substeps: int = 1,
        friction: JointFriction | None = None,
        force_limits: ForceLimits | None = None,
        target_object: FreeBody | None = None,
        firing: ThrusterFiring | None = None,
        drive: WheelDrive | None = None,
    ) -> None:
        """Set up MuJoCo's model of the robot, and find where the robot's coordinates are among those of MuJoCo.

        Args:
            model: The robot.
            tick: Length of a tick of the low-level law [s].
            substeps: Integration steps of MuJoCo in a tick.
            friction: Friction of joints; None without any.
            force_limits: Limits at which the force of the law is cut; None without any.
            target_object: A free body beside the robot, in the same model; None without any.
            firing: Thrusters that give the force on the base; None where the plant applies the law's force itself.
            drive: Drive of the reaction wheels; None without any.
        """
        super().__init__(LowLevelLaw(model), tick, force_limits, firing, drive)
        self.substeps = substeps
        self.friction = friction or JointFriction.none(model.n)
        self._target_object = target_object
        mujoco.set_mju_user_warning(logger.warning)  # by default MuJoCo writes a file in the current directory
        self._parameters_in_engine = np.zeros(0)  # none yet, so the next line builds the engine
        self.set_inertial_parameters(model.nominal)
        names = [body.name for body in model.spec.bodies]
        space = model.space
        moves = model.spec.moved_by.moves
        joints = [self.engine.joint(name).id for name in names[1:]]  # MuJoCo has them in another order, by depth
        # Indices into MuJoCo's qpos and qvel, in the order of Q and v. The base comes first; a base that does not move
        # has no coordinates in MuJoCo.
        self.q = np.r_[: space.n_pose * moves, self.engine.jnt_qposadr[joints]]
        self.v = np.r_[: space.n_twist * moves, self.engine.jnt_dofadr[joints]]
        wheels = [self.engine.joint(name).id for name in wheel_names(model.spec)]
        self.wheel_q = self.engine.jnt_qposadr[wheels]
        self.wheel_v = self.engine.jnt_dofadr[wheels]
        self._base = self.engine.body("base").id
        # the rows of Q and of v that MuJoCo integrates
        self._moving_coordinates = slice(0 if moves else space.n_pose, None)
        self.moving_rates = slice(0 if moves else space.n_twist, None)

    def set_inertial_parameters(self, robot: InertialParameters) -> None:
        """Build MuJoCo's model for inertial parameters of the robot and what it holds, if they are new."""
        if np.array_equal(robot.vector, self._parameters_in_engine):
            return
        self._parameters_in_engine = robot.vector
        spec = mujoco_spec(self.model.spec, self._target_object, robot)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.timestep = self.tick / self.substeps
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged state must be visible
        self.engine = spec.compile()
        set_wheel_inertias(self.engine, self.model.spec)
        self.data = mujoco.MjData(self.engine)

    def step(self, state: np.ndarray, F: np.ndarray, robot: InertialParameters) -> tuple[np.ndarray, np.ndarray]:
        """Advance the engine by a tick; the impulse is left 0, see `impulse_and_work`."""
        self.set_inertial_parameters(robot)
        after, work = self._step_engine(state, F)
        return after, np.append(np.zeros(self.model.space.n_twist), work)

    def impulse_and_work(self, sum_of_ticks: np.ndarray, states: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return work, and the impulse along the states; NaN of a mount, since MuJoCo does not return its force."""
        if not self.model.spec.moved_by.moves:
            return np.append(np.full(self.model.space.n_twist, np.nan), sum_of_ticks[-1])
        return np.append(_external_impulse(self.model.space, states, F, self.tick), sum_of_ticks[-1])

    def replay(self, state: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Simulate given forces (M, n), held a tick each, from a state on; no law reads the states (M + 1, nq + n)."""
        states = np.vstack([state, np.empty((len(F), len(state)))])
        for k, force in enumerate(F):
            states[k + 1], _ = self._step_engine(states[k], force)
        return states

    def _step_engine(self, state: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, float]:
        """Advance the robot by one tick under a held force, and compute the work of all forces.

        The work is force times displacement. For a force that is held over a step this is exact, whatever the path.

        Args:
            state: State [Q; v] where the tick begins (nq + n,).
            F: Generalized force (n,) [N, N m], with what motors of wheels give to the base.

        Returns:
            The state after the tick (nq + n,), and the work [J].
        """
        nq = self.model.nq
        space = self.model.space
        data = self.data
        friction = self.friction
        work = 0.0
        coordinates = self._moving_coordinates
        rates = self.moving_rates
        Q = state[:nq].copy()
        v = state[nq:].copy()
        drive = self.drive
        if drive is not None:
            # the motors' torques act on the wheels' joints, so MuJoCo gives the base the opposite itself
            F = drive.without_motors(F)
            self.set_wheel_momenta(drive, drive.momentum, v)
            data.qpos[self.wheel_q] = 0.0
            data.qfrc_applied[self.wheel_v] = drive.torque
        for _ in range(self.substeps):
            Q_before = Q.copy()
            v_before = v.copy()
            acting = friction.net_force(F, v)  # held over the step, unlike in plant rk4
            self.set_state(Q, v)
            data.qfrc_applied[self.v] = acting[rates]
            mujoco.mj_step(self.engine, data)
            Q[coordinates] = data.qpos[self.q]
            v[rates] = data.qvel[self.v]
            displacement = np.array(space.difference(Q_before, Q))
            # the displacement of an attitude is not the integral of its angular velocity: the difference is taken off
            displacement = displacement - space.magnus_correction(v_before[None], v[None], self.engine.opt.timestep)[0]
            work += float(acting @ displacement)
        if drive is not None:
            work += float(drive.torque @ data.qpos[self.wheel_q])  # wheels began at angle 0
        return np.concatenate([Q, v]), work

    def set_state(self, Q: np.ndarray, v: np.ndarray) -> None:
        """Set the engine's robot to coordinates Q (nq,) and velocities v (n,); a fixed base is put where Q has it."""
        space = self.model.space
        if not self.model.spec.moved_by.moves:
            self.engine.body_pos[self._base], self.engine.body_quat[self._base] = space.to_3d(Q[space.base_coordinates])
        self.data.qpos[self.q] = Q[self._moving_coordinates]
        self.data.qvel[self.v] = v[self.moving_rates]

    def set_wheel_momenta(self, drive: WheelDrive, h: np.ndarray, v: np.ndarray) -> None:
        """Set the speeds of the engine's wheels so that they store momenta h (W,) on a robot of velocity v (n,)."""
        self.data.qvel[self.wheel_v] = drive.wheels.spins(h, v)


def _external_impulse(space: ConfigurationSpace, states: np.ndarray, F: np.ndarray, tick: float) -> np.ndarray:
    """Return the integral of the external wrench along the states of a sample.

    MuJoCo does not return it. Over each tick it is taken by the trapezoidal rule with its end correction, h/2 (w_0 +
    w_1) - h^2/12 (w'_1 - w'_0), which has an error of the order of h^5.

    Args:
        space: Coordinates of the robot.
        states: States [Q; v] at the ticks and at the end (M + 1, nq + n).
        F: External generalized forces, each held over a tick (M, n) [N, N m].
        tick: Length h of a tick [s].

    Returns:
        Impulse, and angular impulse about the inertial origin (n_twist,) [N s, N m s].
    """
    Q = states[:, : space.nq]
    v = states[:, space.nq :]
    # where each tick begins, and where it ends; functions of the space take components along the first axis
    wrench = [np.array(space.external_wrench(Q_at.T, F.T)) for Q_at in (Q[:-1], Q[1:])]
    rate = [
        np.array(space.external_wrench_rate(Q_at.T, v_at.T, F.T)) for Q_at, v_at in ((Q[:-1], v[:-1]), (Q[1:], v[1:]))
    ]
    trapezoidal = (tick / 2 * (wrench[0] + wrench[1])).sum(axis=1)
    return np.asarray(trapezoidal - (tick**2 / 12 * (rate[1] - rate[0])).sum(axis=1))


class MujocoStep:
    """MuJoCo's model of robot and object, integrated by classical Runge-Kutta steps with the bushings in every stage.

    MuJoCo gives the poses and velocities of the grippers and the accelerations of both; the bushings are forces on its
    bodies.
    """

    def __init__(
        self,
        law: GraspLaw,
        body: FreeBody,
        tick: float,
        substeps: int,
        friction: JointFriction | None,
        drive: WheelDrive | None = None,
    ) -> None:
        """Set up one tick of robot and object together: MuJoCo gives their accelerations, Runge-Kutta steps integrate.

        Args:
            law: The bushings between grippers and object: springs and dampers of the grasps.
            body: The true object.
            tick: Length of a tick [s].
            substeps: Steps of the integrator in a tick.
            friction: Friction of joints; None without any.
            drive: Drive of the reaction wheels; None without any.
        """
        self._law = law
        self._model = law.model
        self._tick = tick
        self._substeps = substeps
        self._drive = drive
        self._robot = MujocoPlant(law.model, tick, substeps, friction, target_object=body, drive=drive)
        self._bushing = ArrayFunction(law.bushing)
        engine = self._robot.engine
        self._gripper_sites = [engine.site(gripper).id for gripper in law.grippers]
        self._object_id = engine.body(OBJECT).id
        object_joint = engine.body_jntadr[self._object_id]
        self._object_q = slice(engine.jnt_qposadr[object_joint], engine.jnt_qposadr[object_joint] + law.object_sizes[0])
        self._object_v = slice(engine.jnt_dofadr[object_joint], engine.jnt_dofadr[object_joint] + law.object_sizes[1])

    def __call__(
        self,
        state: np.ndarray,
        target_object: np.ndarray,
        F: np.ndarray,
        parameters: np.ndarray,
        robot: InertialParameters,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Advance robot and object by one tick under a held force on the robot.

        Args:
            state: State [Q; v] of the robot (nq + n,).
            target_object: Pose and velocity of the object.
            F: Generalized force on the robot (n,), with what motors of wheels give to the base.
            parameters: Parameters of the bushings between grippers and object (A, n_parameters); those of an open
                gripper have stiffnesses and dampings of 0.
            robot: True inertial parameters of the robot.

        Returns:
            State of the robot and state of the object after the tick; and, over the tick, the impulse of the external
            wrench and the work of all forces, as in `Ticks.impulse_and_work` (n_twist + 1,).
        """
        self._robot.set_inertial_parameters(robot)
        step_length = self._tick / self._substeps
        robot_size = len(state)
        attitudes = self._model.space.attitudes_at(0, robot_size)
        object_size = len(target_object)
        wheel_momenta = np.zeros(0)
        if self._drive is not None:
            F = self._drive.without_motors(F)  # MuJoCo gives the base the motors' torques, as they act on its wheels
            wheel_momenta = self._drive.momentum
        impulse_and_work = np.zeros(self._model.space.n_twist + 1)
        y = np.concatenate([state, target_object, impulse_and_work, wheel_momenta])
        for _ in range(self._substeps):
            y = runge_kutta(lambda y: self._rate(y, F, parameters), y, step_length)
            for quaternion in attitudes:  # a step leaves their norms only about 1
                y[quaternion] /= np.linalg.norm(y[quaternion])
        return (
            y[:robot_size],
            y[robot_size : robot_size + object_size],
            y[robot_size + object_size : robot_size + object_size + len(impulse_and_work)],
        )

    def _rate(self, integrated: np.ndarray, F: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Compute the rate of the integrated state, with accelerations by MuJoCo's forward dynamics.

        Args:
            integrated: y = [Q; v; pose of the object; its velocity; impulse; work; momenta of wheels].
            F: External generalized force on the robot, without the motors of wheels (n,) [N, N m].
            parameters: Parameters of the bushings, the springs and dampers between grippers and object
                (A, n_parameters).

        Returns:
            dy/dt, in the same order.
        """
        model = self._model
        engine = self._robot.engine
        data = self._robot.data
        law = self._law
        ends = np.cumsum([model.nq, model.n, *law.object_sizes, model.space.n_twist + 1])
        Q, v, object_pose, object_velocity, _, wheel_momenta = np.split(integrated, ends)
        self._robot.set_state(Q, v)
        torque = np.zeros(0)
        power_of_wheels = 0.0
        if self._drive is not None:
            torque = self._drive.torque
            self._robot.set_wheel_momenta(self._drive, wheel_momenta, v)
            power_of_wheels = float(torque @ data.qvel[self._robot.wheel_v])
        data.qpos[self._object_q] = object_pose
        data.qvel[self._object_v] = object_velocity
        mujoco.mj_fwdPosition(engine, data)
        mujoco.mj_fwdVelocity(engine, data)
        acting = self._robot.friction.net_force(F, v)
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[self._robot.v] = acting[self._robot.moving_rates]
        data.qfrc_applied[self._robot.wheel_v] = torque
        is_closed = [bushing[-4] > 0 for bushing in parameters]  # its stiffness, which is 0 of an open gripper
        power_of_bushings = sum(
            self._apply_bushing(site, bushing)
            for site, bushing, closed in zip(self._gripper_sites, parameters, is_closed, strict=True)
            if closed
        )
        mujoco.mj_fwdActuation(engine, data)
        mujoco.mj_fwdAcceleration(engine, data)
        # qacc_smooth is without constraints, of which there are none: no contacts, no limits of joints
        vdot = np.zeros(model.n)
        vdot[self._robot.moving_rates] = data.qacc_smooth[self._robot.v]
        velocity_rate = data.qacc_smooth[self._object_v]
        Qdot = model.space.rate(Q, v)
        pose_rate = law.body.space.rate(object_pose, object_velocity)
        external = model.space.external_wrench(Q, F)
        if not model.spec.moved_by.moves:
            external = [np.nan] * model.space.n_twist  # MuJoCo does not return the force of a mount
        return np.array(
            [
                *Qdot,
                *vdot,
                *pose_rate,
                *velocity_rate,
                *external,
                acting @ v + power_of_bushings + power_of_wheels,
                *torque,
            ]
        )

    def _apply_bushing(self, site: int, parameters: np.ndarray) -> float:
        """Add the wrench of the bushing between a gripper and the object to the forces on MuJoCo's bodies.

        A bushing is a spring and damper between the pose of the gripper and the pose, fixed to the object, at which it
        closed. Its wrench acts on the gripper and, with the opposite sign, on the object, both at the gripper's point.

        Args:
            site: Number of the gripper's site in MuJoCo's model.
            parameters: Parameters of its bushing (n_parameters,).

        Returns:
            The power of both wrenches [W], negative where the damper takes energy.
        """
        engine = self._robot.engine
        data = self._robot.data
        gripper_point = data.site_xpos[site]
        velocity = np.zeros(6)
        quaternion = np.zeros(4)
        # fills in velocity: angular before linear, along the axes of the world
        mujoco.mj_objectVelocity(engine, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, flg_local=0)
        mujoco.mju_mat2Quat(quaternion, data.site_xmat[site])
        space = self._law.body.space
        rate = np.array(space.twist(velocity[3:], velocity[:3]))
        pose = space.from_3d(gripper_point, quaternion)
        wrench_on_gripper, _, power = self._bushing(
            pose, rate, data.qpos[self._object_q], data.qvel[self._object_v], parameters
        )
        force, moment = (np.array(components, dtype=float) for components in space.twist_to_3d(wrench_on_gripper[0]))
        for body, sign in ((engine.site_bodyid[site], 1.0), (self._object_id, -1.0)):
            mujoco.mj_applyFT(engine, data, sign * force, sign * moment, gripper_point, body, data.qfrc_applied)
        return float(power[0, 0])


def build(setup: PlantSetup) -> Plant:
    """Build the plant on MuJoCo, of robot and object together where there is something to capture.

    Args:
        setup: What every kind of plant is built from.
    """
    capture = setup.capture
    if capture is None:
        return MujocoPlant(
            setup.model,
            setup.tick,
            setup.substeps,
            setup.friction,
            setup.force_limits,
            firing=setup.firing,
            drive=setup.drive,
        )
    step = MujocoStep(capture.law, capture.body, setup.tick, setup.substeps, setup.friction, setup.drive)
    return CapturePlant(capture, step, setup.force_limits, setup.firing, setup.drive)
