"""The object as a body, and the grasps that hold it: linear bushings between grippers and object. docs/grasp_model.md.

In the coordinates relative to the pose recorded at closing, displacement r and rotation vector phi, a closed gripper
bears the force -k r - d rdot and the moment -kappa phi - delta omega, the object the opposite at the same point, the
gripper's. Both velocities of rdot are taken at that point, so the pair has no resultant: momentum of robot and object
is kept. Stiffnesses are the same in every direction, and so are the dampings.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.errors import InputError
from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.plant.base import ForceLimits, GraspEvent, JointFriction, ObjectTicks, TickedPlant
from psmpc_cli.plant.thrusters import ThrusterFiring
from psmpc_cli.plant.uncertainty import stream
from psmpc_cli.plant.wheels import WheelDrive
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.free_body import FreeBody, body_of, velocity_of
from psmpc_cli.robot.low_level import low_level_law
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, cross, dot, log, product, rotate, scaled, shorter
from psmpc_cli.specs.object import GRASP_LOADS, ObjectBody
from psmpc_cli.specs.parts import ERROR_AXES, TARGET_AXES
from psmpc_cli.specs.robots.robot import stack
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.specs.uncertainty import ObjectErrorSpec

Vector = Sequence[Any]

MISSED_BY = ("position", "angle", "velocity", "angular_velocity")
"""What a gripper has to be near in, to close; names as in `EnvelopeSpec`."""


@dataclass(frozen=True, eq=False)
class Relative:
    """Gripper and object relative to a pose of the gripper in the object's frame, in the inertial frame (3,) each.

    Attributes:
        r, phi: Displacement [m], and rotation vector [rad], which is along the axis in either frame.
        rdot, omega: Their rates, both bodies' velocities taken at the gripper's point [m/s, rad/s].
        lever: From the object's centre of mass to the gripper [m].
    """

    r: list[Any]
    phi: list[Any]
    rdot: list[Any]
    omega: list[Any]
    lever: list[Any]


def compared(
    space: ConfigurationSpace, gripper: Any, gripper_rate: Any, object_pose: Any, object_velocity: Any, anchor: Any
) -> Relative:
    """Compute displacement and velocity of a gripper relative to a pose fixed to the object, which a bushing acts on.

    Args:
        space: Coordinates of poses, planar or spatial.
        gripper: Pose of the gripper.
        gripper_rate: Linear velocity of its point and angular velocity, both in the inertial frame.
        object_pose: Pose of the object.
        object_velocity: Velocity of the object: linear, and angular about its own axes.
        anchor: The pose in the object's frame that the gripper is compared with, that at which it closed.
    """
    gripper_point, gripper_attitude = space.to_3d(gripper)
    gripper_linear, gripper_angular = space.twist_to_3d(gripper_rate)
    centre, object_attitude = space.to_3d(object_pose)
    object_linear, object_angular = space.twist_to_3d(object_velocity)
    anchor_point, anchor_attitude = space.to_3d(anchor)
    # in the inertial frame; the velocity of the object is taken at the gripper's point
    object_angular = rotate(object_attitude, object_angular)
    lever = add(gripper_point, scaled(centre, -1))
    wanted_attitude = product(object_attitude, anchor_attitude)
    rotation_between = product(conjugate(wanted_attitude), gripper_attitude)
    return Relative(
        r=add(lever, scaled(rotate(object_attitude, anchor_point), -1)),
        phi=rotate(wanted_attitude, log(shorter(rotation_between))),
        rdot=add(gripper_linear, scaled(add(object_linear, cross(object_angular, lever)), -1)),
        omega=add(gripper_angular, scaled(object_angular, -1)),
        lever=lever,
    )


class GraspLaw:
    """The bushings of one robot's grippers on one object, as CasADi functions.

    The parameters of a gripper are its anchor, the pose recorded at closing, then k, kappa, d and delta, all 0 of an
    open one.

    Attributes:
        grippers: Arms whose grippers take it.
        body: The object.
        n_parameters: Number of parameters of one gripper.
        object_sizes: Sizes of a pose and of a velocity.
        wrench_size: Size of a wrench, and of a velocity: 3 in the plane, 6 in space.
        bushing: Pose and velocity of a gripper (angular in the inertial frame), pose and velocity of the object,
            parameters -> wrench on the gripper at its point, wrench on the object about its centre, power [W].
        forces: Q, v, pose and velocity of the object, parameters of all grippers -> generalized force on the robot
            (n,), wrench on the object about its centre, power; then for each gripper the wrench it puts on the object
            at its point, and the load on it (3, A): pull, shear and moment.
    """

    def __init__(self, model: RobotModel, body: FreeBody, grippers: Sequence[str]) -> None:
        self.model = model
        self.body = body
        self.grippers = tuple(grippers)
        self.space = body.space
        self.wrench_size = self.space.n_twist
        self.object_sizes = (self.space.n_pose, self.space.n_twist)
        self.n_parameters = self.object_sizes[0] + 4
        self.bushing = self._bushing()
        self.forces = self._forces()

    def gripper(self, number: int, Q: Any, v: Any) -> tuple[Any, Any, Any]:
        """Return pose, velocity (angular in the inertial frame) and Jacobian of a gripper."""
        frame = list(self.model.pose_rows).index(self.grippers[number])
        J = self.model.J_C(Q)[self.wrench_size * frame : self.wrench_size * (frame + 1), :]
        return self.model.g(Q)[self.model.pose_rows[self.grippers[number]]], J @ v, J

    def _bushing(self) -> ca.Function:
        """Build the linear bushing between one gripper and the object: spring and damper in displacement and rotation.

        The force acts on both bodies at the gripper's point, so the pair has no resultant and momentum is conserved.

        Returns:
            Pose and velocity of the gripper, pose and velocity of the object, parameters -> wrench on the gripper at
            its point, wrench on the object about its centre, power [W].
        """
        argument_sizes = {
            "gripper": self.object_sizes[0],
            "turn": self.wrench_size,
            "pose": self.object_sizes[0],
            "v": self.wrench_size,
        }
        bodies = [ca.SX.sym(name, size) for name, size in argument_sizes.items()]
        parameters = ca.SX.sym("p", self.n_parameters)
        anchor = ca.vertsplit(parameters)[: self.object_sizes[0]]
        stiffness, angular_stiffness, damping, angular_damping = ca.vertsplit(parameters)[self.object_sizes[0] :]
        gripper, gripper_rate, object_pose, object_velocity = map(ca.vertsplit, bodies)
        relative = compared(self.space, gripper, gripper_rate, object_pose, object_velocity, anchor)
        force = add(scaled(relative.r, -stiffness), scaled(relative.rdot, -damping))
        moment = add(scaled(relative.phi, -angular_stiffness), scaled(relative.omega, -angular_damping))
        moment_on_object = add(scaled(moment, -1), cross(relative.lever, scaled(force, -1)))
        power = dot(force, relative.rdot) + dot(moment, relative.omega)
        wrenches = self.space.twist(force, moment), self.space.twist(scaled(force, -1), moment_on_object)
        return ca.Function(
            "bushing", [*bodies, parameters], ca.cse([*(ca.vertcat(*wrench) for wrench in wrenches), ca.SX(power)])
        )

    def _forces(self) -> ca.Function:
        """Sum up what the bushings of all A grasps do to robot and object, as one CasADi function.

        Returns:
            Q, v, pose and velocity of the object, parameters of all bushings -> generalized force on the robot (n,),
            wrench on the object about its centre, power taken from both [W], the wrench that each gripper puts on the
            object (wrench_size, A), and the loads of each grasp (3, A), which its strength is compared with: pull along
            the line from the object's centre to the gripper, shear across it, and moment.
        """
        argument_sizes = {
            "Q": self.model.nq,
            "v": self.model.n,
            "pose": self.object_sizes[0],
            "rate": self.object_sizes[1],
        }
        symbols = [ca.SX.sym(name, size) for name, size in argument_sizes.items()]
        Q, v, object_pose, object_velocity = symbols
        parameters = ca.SX.sym("p", self.n_parameters * len(self.grippers))
        generalized_force = ca.SX.zeros(self.model.n)
        wrench_about_centre = ca.SX.zeros(self.wrench_size)
        power = ca.SX(0)
        wrenches_on_object = []
        loads = []
        for gripper in range(len(self.grippers)):
            gripper_pose, gripper_rate, J = self.gripper(gripper, Q, v)
            grasp = parameters[self.n_parameters * gripper : self.n_parameters * (gripper + 1)]
            on_gripper, about_centre, power_of_grasp = self.bushing(
                gripper_pose, gripper_rate, object_pose, object_velocity, grasp
            )
            generalized_force = generalized_force + J.T @ on_gripper
            wrench_about_centre = wrench_about_centre + about_centre
            power = power + power_of_grasp
            # loads of the grasp, as the object bears them: along the line from its centre, across it, and about it
            anchor_point, _ = self.space.to_3d(ca.vertsplit(grasp)[: self.object_sizes[0]])
            _, attitude = self.space.to_3d(ca.vertsplit(object_pose))
            centre_to_gripper = rotate(attitude, anchor_point)
            force_on_object, moment = self.space.twist_to_3d(ca.vertsplit(-on_gripper))
            distance = ca.sqrt(dot(centre_to_gripper, centre_to_gripper))
            pull = dot(force_on_object, centre_to_gripper) / ca.fmax(distance, TINY)
            shear = ca.sqrt(ca.fmax(dot(force_on_object, force_on_object) - pull**2, 0))
            wrenches_on_object.append(-on_gripper)
            loads.append(ca.vertcat(pull, shear, ca.sqrt(dot(moment, moment))))
        outputs = ca.cse(
            [generalized_force, wrench_about_centre, power, ca.horzcat(*wrenches_on_object), ca.horzcat(*loads)]
        )
        return ca.Function("forces", [*symbols, parameters], outputs)

    def approach(
        self, gripper: int, Q: np.ndarray, v: np.ndarray, target_object: np.ndarray, anchor: np.ndarray
    ) -> np.ndarray:
        """Compute how far a gripper is from its place on the object, and how heavy both bodies are there.

        The former decides whether it may close, the latter sets the damping of its grasp.

        Args:
            gripper: Number of the gripper.
            Q: Position of the robot (nq,).
            v: Its velocity (n,).
            target_object: Pose and velocity of the object.
            anchor: The place: a pose of the gripper in the object's frame.

        Returns:
            Distance [m], angle [rad], velocity [m/s], angular velocity [rad/s]; then, means over the directions, the
            inverses of the effective mass and of the effective inertia of both bodies at the gripper (6,).
        """
        d = self.model.dimension
        object_pose, object_velocity = np.split(target_object, [self.object_sizes[0]])
        gripper_pose, gripper_rate, J = (output.full() for output in self.gripper(gripper, Q, v))
        relative = compared(
            self.space, gripper_pose.ravel(), gripper_rate.ravel(), object_pose, object_velocity, anchor
        )
        distances = (
            np.linalg.norm(difference) for difference in (relative.r, relative.phi, relative.rdot, relative.omega)
        )
        inverse_of_robot = J @ np.linalg.solve(self.model.mass_matrix(Q), J.T)
        inverse = inverse_of_robot + self._inverse_mass(object_pose, relative.lever, relative.lever)
        return np.array([*distances, inverse.diagonal()[:d].mean(), inverse.diagonal()[d:].mean()])

    def inverse_mass(self, Q: np.ndarray, pose: np.ndarray, anchors: np.ndarray) -> np.ndarray:
        """Compute the accelerations of all grippers relative to the object by the wrenches between them, at rest.

        W = J H^-1 J' + J_o M_o^-1 J_o': a wrench on each gripper and the opposite on the object. Its eigenvalues with
        the stiffness of the grasps give their frequencies.

        Args:
            Q: Position of the robot (nq,).
            pose: Pose of the object.
            anchors: Poses of the A grippers in the object's frame (A, 3) or (A, 7); they may not be there yet.

        Returns:
            W (A n_twist, A n_twist).
        """
        J = np.vstack([self.gripper(i, Q, np.zeros(self.model.n))[2].full() for i in range(len(self.grippers))])
        _, attitude = self.space.to_3d(pose)
        levers = [rotate(attitude, self.space.to_3d(anchor)[0]) for anchor in anchors]
        object_part = np.block(
            [[self._inverse_mass(pose, pushed_at, moved_at) for pushed_at in levers] for moved_at in levers]
        )
        return np.asarray(J @ np.linalg.solve(self.model.mass_matrix(Q), J.T) + object_part)

    def _inverse_mass(self, pose: np.ndarray, there: Vector, here: Vector) -> np.ndarray:
        """Return the acceleration of the object's point at the lever `here` by a wrench on it at the lever `there`."""
        columns = []
        space = self.space
        for force, moment in map(space.twist_to_3d, np.eye(self.wrench_size)):
            wrench = space.twist(force, add(moment, cross(there, force)))
            linear, angular = space.twist_to_3d(self.body.rates(pose, np.zeros(self.wrench_size), wrench)[1])
            angular = rotate(space.to_3d(pose)[1], angular)
            columns.append(space.twist(add(linear, cross(angular, here)), angular))
        return np.array(columns, dtype=float).T


TINY = 1e-12
"""Distance from the centre of mass below which a grasp has no outward direction [m]."""


class Capture:
    """The object of a run and the state of its grasps: which are closed, where, and what load they bear.

    Attributes:
        law: The bushings.
        body: The true object.
        described: The object as the task describes it, which is what a low-level law may know of it.
        state: Pose and velocity of the object.
        parameters: Of the bushings now, gripper by gripper.
        closed: Which of them are closed (A,).
        load: Filtered loads on them, pull, shear and moment (A, 3).
        filter: Share of the difference to the load by which the filtered one follows it at a tick.
    """

    def __init__(self, task: TaskSpec, model: RobotModel, target_object: ObjectBody) -> None:
        """Set up a free object, which may differ from its description, and open grippers.

        Mass and velocity differ from the description by draws of the task's seed.

        Args:
            task: The task, with its seed and the uncertainty of the object.
            model: The robot.
            target_object: The object as the task describes it.
        """
        spec = target_object.grasp
        body = body_of(target_object)
        error = task.uncertainty.object or ObjectErrorSpec()
        draws = stream(task.seed, "object").uniform(-1, 1, 7)
        mass_factor = 1 + error.mass * draws[0]
        v = velocity_of(target_object)
        v[: model.dimension] += error.linear * draws[1 : 1 + model.dimension]
        v[model.dimension :] += error.angular * draws[4 : 4 + len(v) - model.dimension]
        self.described = body
        self.body = FreeBody(mass_factor * body.mass, [mass_factor * moment for moment in body.inertia])
        law = GraspLaw(model, self.body, list(spec.at))
        self._task = task
        tick = 1 / task.plant.low_level_rate
        self.law = law
        self.spec = spec
        self.state = np.array([*target_object.pose, *v])
        self.tick = tick
        count = len(law.grippers)
        self._anchors = np.array([spec.at[gripper] for gripper in law.grippers])
        self.parameters = np.hstack([self._anchors, np.zeros((count, 4))])
        self.closed = np.zeros(count, bool)
        self._is_to_hold = False  # whether grippers are commanded to be closed
        self.load = np.zeros((count, len(GRASP_LOADS)))
        self._load_at_loss = np.zeros_like(self.load)
        self._events = list[GraspEvent]()
        # states, wrenches, loads, closed grippers over the ticks of the sample so far, for its log
        self._ticks_of_sample: list[tuple[np.ndarray, ...]] = []
        self._forces = ArrayFunction(law.forces)
        # of a first-order filter with that time constant, over one tick; without a strength loads are not filtered
        self.filter = 1.0 if spec.strength is None else -np.expm1(-tick / spec.strength.filter)

    @property
    def pose_and_velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity of the object now."""
        return self.state[: self.law.object_sizes[0]], self.state[self.law.object_sizes[0] :]

    @property
    def header(self) -> dict[str, ArrayLike]:
        """What a log says of the object before a run begins, by path."""
        d = self.law.model.dimension
        grippers = self.law.grippers
        return {
            "object_coordinate": TARGET_AXES[d],
            "object_axis": ERROR_AXES[d],
            "gripper": grippers,
            "grasp_axis": tuple(f"{gripper}.{axis}" for gripper in grippers for axis in ERROR_AXES[d]),
            "grasp/measure": MISSED_BY,
            "object/mass": self.body.mass,
            "object/inertia": self.body.inertia,
            "object/moment": ("xx", "yy", "zz")[-self.law.space.n_principal :],
        }

    @property
    def momentum_and_energy(self) -> np.ndarray:
        """Momentum about the inertial origin [N s, N m s] and kinetic energy [J] of the object, (4,) or (7,)."""
        pose, v = self.pose_and_velocity
        return np.array([*self.body.momentum(pose, v), self.body.kinetic_energy(v)])

    @property
    def holding(self) -> dict[str, bool]:
        """What grippers report, by arm: whether each holds the object; nothing while they are open."""
        return dict(zip(self.law.grippers, self.closed.tolist(), strict=True)) if self._is_to_hold else {}

    def measured(self, sample: int) -> np.ndarray:
        """Return the pose that is measured at a sample, (3,) or (7,)."""
        noise = self._task.uncertainty.noise
        size = self.law.wrench_size
        d = self.law.model.dimension
        deviation = np.array([noise.object_position] * d + [noise.object_angle] * (size - d))
        step = stream(self._task.seed, "object noise", sample).standard_normal(size) * deviation
        pose, _ = self.pose_and_velocity
        return np.array(self.law.space.integrate(pose, step))

    def eigenvalues_when_held(self, Q: np.ndarray) -> np.ndarray:
        """Compute the eigenvalues [1/s] of robot and object held by all grippers, to choose a step of the integrator.

        With displacements r of the grippers, r'' = -W (K r + D r'): W as in `GraspLaw.inverse_mass`, K and D the
        stiffnesses and dampings of the bushings, as they are set at closing.

        Args:
            Q: Position of the robot (nq,), near that at which the grippers close.
        """
        pose, _ = self.pose_and_velocity
        d = self.law.model.dimension
        W = self.law.inverse_mass(Q, pose, self._anchors)
        is_angular = np.r_[np.zeros(d, int), np.ones(self.law.wrench_size - d, int)]
        stiffness = []
        damping = []
        for gripper in range(len(self._anchors)):
            inverses_of_gripper = W.diagonal()[gripper * self.law.wrench_size : (gripper + 1) * self.law.wrench_size]
            mean_inverses = np.array([inverses_of_gripper[:d].mean(), inverses_of_gripper[d:].mean()])
            stiffness.append(np.array(self.spec.stiffness)[is_angular])
            damping.append(self._damping(mean_inverses)[is_angular])
        zeros = np.zeros_like(W)
        system_matrix = np.block(
            [[zeros, np.eye(len(W))], [-W * np.concatenate(stiffness), -W * np.concatenate(damping)]]
        )
        return np.linalg.eigvals(system_matrix)

    def _damping(self, inverse: np.ndarray) -> np.ndarray:
        """Return both dampings of a bushing from the inverses of effective mass and inertia (2,) at it."""
        return np.asarray(2 * self.spec.damping_ratio * np.sqrt(self.spec.stiffness / inverse))

    def want(self, time: float, robot_state: np.ndarray, wanted: bool) -> None:
        """Close or open the grippers at the beginning of a tick.

        Args:
            time: Of the tick [s].
            robot_state: State [Q; v] of the robot.
            wanted: Whether they are to be closed.
        """
        if wanted and not self._is_to_hold:
            self._close(time, robot_state)
        elif self._is_to_hold and not wanted:
            self._open(time, self.closed, "let go")
        self._is_to_hold = wanted

    def begin_tick(self, time: float, robot_state: np.ndarray, wanted: bool) -> np.ndarray | None:
        """Close, open and lose grasps at the beginning of a tick.

        Returns:
            The grasps of an object that all hands hold, see `HeldLoad.force`; None while they do not.
        """
        self.want(time, robot_state, wanted)
        times = np.array([time])
        while not self.record(times, self.state[None], *(values[None] for values in self.borne(robot_state))):
            pass  # what is left of the grasps bears the tick
        return self.parameters[:, :-2] if self.closed.all() else None

    @property
    def is_known_load(self) -> bool:
        """Whether all hands hold the object, and the low-level law knows of it."""
        return bool(self.spec.known and self.closed.all())

    def record(self, times: np.ndarray, states: np.ndarray, wrench: np.ndarray, load: np.ndarray) -> int:
        """Record what the grasps bear over K ticks, up to the first in which one bears too much and is lost.

        Args:
            times: Beginnings of the ticks (K,) [s].
            states: Pose and velocity of the object at them (K, size).
            wrench: Wrenches on the object at the grippers (K, A, 3) or (K, A, 6).
            load: Filtered loads on the grasps (K, A, 3).

        Returns:
            The number of ticks before a loss. The tick of a loss has to be simulated again, without what was lost.
        """
        is_too_much = self.closed & (load > self.spec.largest_loads).any(axis=2)
        ticks_of_loss = np.flatnonzero(is_too_much.any(axis=1))
        ticks_before_loss = int(ticks_of_loss[0]) if ticks_of_loss.size else len(times)
        if ticks_before_loss:
            logged_load = load[:ticks_before_loss].copy()
            self.load = logged_load[-1].copy()
            # a tick in which a grasp was lost is simulated again without it; its log shows the load that was too much
            logged_load[0] += self._load_at_loss
            self._load_at_loss[:] = 0.0
            self._ticks_of_sample.append(
                (
                    states[:ticks_before_loss],
                    wrench[:ticks_before_loss],
                    logged_load,
                    np.tile(self.closed, (ticks_before_loss, 1)),
                )
            )
        if ticks_of_loss.size:
            lost_grippers = is_too_much[ticks_before_loss]
            self.load[lost_grippers] = load[ticks_before_loss, lost_grippers]
            self._load_at_loss[lost_grippers] = self.load[lost_grippers]
            self._open(float(times[ticks_before_loss]), lost_grippers, "lost")
        return ticks_before_loss

    def ticks(self) -> ObjectTicks:
        """Return what happened in the sample, and begin the next one."""
        states, wrench, load, closed = (np.concatenate(column) for column in zip(*self._ticks_of_sample, strict=True))
        pose, v = np.split(np.vstack([states, self.state]), [self.law.object_sizes[0]], axis=1)
        events = tuple(self._events)
        self._ticks_of_sample = []
        self._events = []
        return ObjectTicks(pose, v, wrench, load, closed, events)

    def _close(self, time: float, robot_state: np.ndarray) -> None:
        """Close every gripper that is near enough to its place on the object, and record which do and which miss it.

        A gripper that closes holds the pose relative to the object that it then has, by a bushing.

        Args:
            time: Time of the tick [s].
            robot_state: State [Q; v] of the robot (nq + n,).
        """
        envelope = [getattr(self.spec.envelope, name) for name in MISSED_BY]
        nq = self.law.model.nq
        pose, _ = self.pose_and_velocity
        poses = dict(zip(self.law.model.pose_rows, self.law.model.poses(robot_state[:nq]), strict=True))
        for number, gripper in enumerate(self.law.grippers):
            distances, mean_inverses = np.split(
                self.law.approach(number, robot_state[:nq], robot_state[nq:], self.state, self._anchors[number]),
                [len(MISSED_BY)],
            )
            is_inside = bool((distances <= envelope).all())
            self._events.append(
                GraspEvent(gripper, time, "closed" if is_inside else "missed", tuple(distances.tolist()))
            )
            if is_inside:
                anchor = self.law.space.relative(poses[gripper], pose)
                self.parameters[number] = [*anchor, *self.spec.stiffness, *self._damping(mean_inverses)]
                self.closed[number] = True
                self.load[number] = 0.0

    def _open(self, time: float, which: np.ndarray, why: str) -> None:
        for i in np.flatnonzero(which):
            self._events.append(GraspEvent(self.law.grippers[i], time, why, tuple(self.load[i].tolist())))
            self.parameters[i, -4:] = 0.0
            self.closed[i] = False
            self.load[i] = 0.0

    def borne(self, robot_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute what grasps bear in a tick: wrenches on the object (A, 3) or (A, 6), and filtered loads (A, 3)."""
        if not self.closed.any():
            return np.zeros((len(self.closed), self.law.wrench_size)), self.load
        nq = self.law.model.nq
        pose, v = self.pose_and_velocity
        *_, wrench, load = self._forces(robot_state[:nq], robot_state[nq:], pose, v, self.parameters.ravel())
        return wrench, self.load + self.filter * self.closed[:, None] * (load - self.load)


def build_capture(task: TaskSpec, model: RobotModel) -> Capture | None:
    """Build the object of a task with its grasps; None if it has no mass, since then it takes part in no dynamics.

    Args:
        task: The task.
        model: The robot.

    Raises:
        InputError: The grasps are too stiff for the integrator's step, with the largest step that would do.
    """
    if task.body.mass == 0.0:
        return None
    capture = Capture(task, model, task.body)
    eigenvalues = capture.eigenvalues_when_held(stack(task.initial, model.spec, "joint"))
    step = task.plant.step or 1 / task.plant.low_level_rate
    if not is_stable(eigenvalues * step * RESERVE):
        allowed_step = step
        while not is_stable(eigenvalues * allowed_step * RESERVE):
            allowed_step *= 0.98  # until one is stable, to 2 %
        raise InputError(
            f"object.grasp.stiffness: found a step of {step:g} s, expected at most {allowed_step:.2g} s for grasps "
            "of this stiffness and damping: take a smaller plant.step, or softer grasps"
        )
    return capture


RESERVE = 1.3
"""By how much the step may be too short: effective masses change with the posture, and the grippers close elsewhere."""


def is_stable(z: np.ndarray) -> bool:
    """Tell whether steps of the classical Runge-Kutta method, |R(z)| <= 1 with z = step times rate, let no rate grow.

    R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24. Hairer and Wanner (1996), section IV.2.
    """
    growth = np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))
    return bool((growth <= 1 + 1e-9).all())


Step = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray, InertialParameters], tuple[np.ndarray, np.ndarray, np.ndarray]
]
"""Physics of a robot and an object over a tick: what the plants of an object with a mass differ in.

From states of robot and object, the held external force (n,), the parameters of the bushings gripper by gripper, and
the robot's inertial parameters: both states a tick later, then impulse and work over the tick, as in `Ticks`.
"""


class CapturePlant(TickedPlant):
    """A robot, an object, and the grasps between them, tick by tick.

    Attributes:
        capture: The object and its grasps.
    """

    def __init__(
        self,
        capture: Capture,
        step: Step,
        force_limits: ForceLimits | None,
        firing: ThrusterFiring | None = None,
        drive: WheelDrive | None = None,
    ) -> None:
        law = low_level_law(capture.law.model, capture.described, capture.spec)
        super().__init__(law, capture.tick, force_limits, firing, drive)
        self.capture = capture
        self._step = step

    def begin_tick(self, time: float, state: np.ndarray, closed: bool) -> np.ndarray | None:
        """Close, open and lose grasps, and return those of an object that all hands hold."""
        return self.capture.begin_tick(time, state, closed)

    def step(self, state: np.ndarray, F: np.ndarray, robot: InertialParameters) -> tuple[np.ndarray, np.ndarray]:
        """Advance robot and object by a tick."""
        capture = self.capture
        after, capture.state, impulse_and_work = self._step(state, capture.state, F, capture.parameters, robot)
        return after, impulse_and_work

    def end_sample(self) -> ObjectTicks:
        """Return what the object and its grasps did over the sample."""
        return self.capture.ticks()


@dataclass(frozen=True, eq=False)
class PlantSetup:
    """What a plant is built from.

    Attributes:
        model: The robot as its controller knows it.
        tick: Length of a tick of the low-level loop [s].
        substeps: Steps of the integrator in a tick.
        native: Whether to run as compiled C, where the plant can.
        friction: Friction of a disturbed plant; None for an undisturbed one.
        capture: An object with a mass and its grasps; None without.
        force_limits: At which the force of the low-level law is cut; None where nothing limits it.
        firing: How thrusters fire that give the force on the base; None where its force is the law's. They need limits.
        drive: How reaction wheels are driven; None of a robot without any.
    """

    model: RobotModel
    tick: float
    substeps: int
    native: bool
    friction: JointFriction | None
    capture: Capture | None
    force_limits: ForceLimits | None
    firing: ThrusterFiring | None = None
    drive: WheelDrive | None = None
