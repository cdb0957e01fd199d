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
"""What decides whether a gripper may close, each relative to its grasp; names as in `EnvelopeSpec`."""


@dataclass(frozen=True, eq=False)
class Relative:
    """Motion of a gripper relative to a pose that is fixed to the object; vectors (3,) in the inertial frame.

    Attributes:
        r, phi: Displacement from that pose [m], and rotation vector [rad].
        rdot, omega: Velocity [m/s] and angular velocity [rad/s] relative to the object, both at the gripper's point.
        lever: From the object's centre of mass to the gripper [m].
    """

    r: list[Any]
    phi: list[Any]
    rdot: list[Any]
    omega: list[Any]
    lever: list[Any]


def relative_motion(
    space: ConfigurationSpace, gripper: Any, gripper_rate: Any, object_pose: Any, object_velocity: Any, anchor: Any
) -> Relative:
    """Compute displacement and velocity of a gripper relative to a pose that is fixed to the object.

    A bushing, the spring and damper of a closed gripper, acts on them; they also decide whether a gripper may close.

    Args:
        space: Coordinates of poses, planar or spatial.
        gripper: Pose of the gripper (n_pose,).
        gripper_rate: Linear velocity of its point and angular velocity, both in the inertial frame (n_twist,).
        object_pose: Pose of the object (n_pose,).
        object_velocity: Velocity of the object: linear, and angular about its own axes (n_twist,).
        anchor: The pose in the object's frame that the gripper is compared with (n_pose,): where it is to close, or
            where it has closed.
    """
    gripper_point, gripper_attitude = space.to_3d(gripper)
    gripper_linear, gripper_angular = space.twist_to_3d(gripper_rate)
    centre, object_attitude = space.to_3d(object_pose)
    object_linear, object_angular = space.twist_to_3d(object_velocity)
    anchor_point, anchor_attitude = space.to_3d(anchor)
    # from the object's axes into the inertial frame
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
    """The bushings between a robot's grippers and an object, as CasADi functions: springs and dampers of the grasps.

    The parameters of a bushing are its anchor, the gripper's pose in the object's frame as recorded at closing, then
    stiffnesses k and kappa and dampings d and delta, all 0 of an open gripper.

    Attributes:
        grippers: Arms whose grippers take it.
        body: The object.
        n_parameters: Number of parameters of one gripper.
        object_sizes: Sizes of a pose and of a velocity.
        wrench_size: Size of a wrench, and of a velocity: 3 in the plane, 6 in space.
        bushing: Pose and velocity of a gripper (angular in the inertial frame), pose and velocity of the object,
            parameters -> wrench on the gripper at its point, wrench on the object about its centre, power [W].
        forces: Q, v, pose and velocity of the object, parameters of all grippers -> generalized force on the robot
            (n,), wrench on the object about its centre, power [W]; then for each gripper the wrench it puts on the
            object at its point (wrench_size, A), and the load on it (3, A): pull, shear and moment.
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

    def gripper_motion(self, number: int, Q: Any, v: Any) -> tuple[Any, Any, Any]:
        """Return pose, velocity (angular in the inertial frame) and Jacobian of a gripper, given by its number."""
        frame = list(self.model.pose_rows).index(self.grippers[number])
        J = self.model.J_C(Q)[self.wrench_size * frame : self.wrench_size * (frame + 1), :]
        return self.model.g(Q)[self.model.pose_rows[self.grippers[number]]], J @ v, J

    def _bushing(self) -> ca.Function:
        """Build the linear bushing between one gripper and the object: spring and damper in displacement and rotation.

        The force acts on both bodies at the gripper's point, so the pair has no resultant and momentum is conserved.

        Returns:
            Function of the gripper's pose and velocity (angular in the inertial frame), the object's pose and velocity,
            and the parameters (anchor, two stiffnesses, two dampings). Its results are the wrench on the gripper at its
            point, the wrench on the object about its centre, and the power of both wrenches [W].
        """
        argument_sizes = {
            "gripper": self.space.n_pose,
            "turn": self.space.n_twist,
            "pose": self.space.n_pose,
            "v": self.space.n_twist,
        }
        bodies = [ca.SX.sym(name, size) for name, size in argument_sizes.items()]
        parameters = ca.SX.sym("p", self.n_parameters)
        anchor = ca.vertsplit(parameters)[: self.space.n_pose]
        stiffness, angular_stiffness, damping, angular_damping = ca.vertsplit(parameters)[self.space.n_pose :]
        gripper, gripper_rate, object_pose, object_velocity = map(ca.vertsplit, bodies)
        relative = relative_motion(self.space, gripper, gripper_rate, object_pose, object_velocity, anchor)
        # on the gripper; the object bears the opposite at the same point, which has a lever about its centre
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

        A bushing is the spring and damper between a closed gripper and the object.

        Returns:
            Function of Q, v, pose and velocity of the object, and the parameters of all bushings, gripper by gripper.
            Its results are the generalized force on the robot (n,), the wrench on the object about its centre, the
            power of them [W], the wrench that each gripper puts on the object at its own point (wrench_size, A), and
            the loads of each grasp (3, A), which its strength is compared with: pull along the line from the object's
            centre to the gripper [N], shear across it [N], and moment [N m].
        """
        argument_sizes = {
            "Q": self.model.nq,
            "v": self.model.n,
            "pose": self.space.n_pose,
            "rate": self.space.n_twist,
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
            gripper_pose, gripper_rate, J = self.gripper_motion(gripper, Q, v)
            grasp = parameters[self.n_parameters * gripper : self.n_parameters * (gripper + 1)]
            on_gripper, about_centre, power_of_grasp = self.bushing(
                gripper_pose, gripper_rate, object_pose, object_velocity, grasp
            )
            generalized_force = generalized_force + J.T @ on_gripper
            wrench_about_centre = wrench_about_centre + about_centre
            power = power + power_of_grasp
            # Loads of the grasp. An outward force of the gripper on the object, along the line from its centre, pulls.
            anchor_point, _ = self.space.to_3d(ca.vertsplit(grasp)[: self.space.n_pose])
            _, attitude = self.space.to_3d(ca.vertsplit(object_pose))
            centre_to_gripper = rotate(attitude, anchor_point)
            force_on_object, moment = self.space.twist_to_3d(ca.vertsplit(-on_gripper))
            distance = ca.sqrt(dot(centre_to_gripper, centre_to_gripper))
            pull = dot(force_on_object, centre_to_gripper) / ca.fmax(distance, SMALLEST_LEVER)
            shear = ca.sqrt(ca.fmax(dot(force_on_object, force_on_object) - pull**2, 0))  # not below 0 by rounding
            wrenches_on_object.append(-on_gripper)
            loads.append(ca.vertcat(pull, shear, ca.sqrt(dot(moment, moment))))
        outputs = ca.cse(
            [generalized_force, wrench_about_centre, power, ca.horzcat(*wrenches_on_object), ca.horzcat(*loads)]
        )
        return ca.Function("forces", [*symbols, parameters], outputs)

    def distances_and_inverse_masses(
        self, gripper: int, Q: np.ndarray, v: np.ndarray, target_object: np.ndarray, anchor: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute how far a gripper is from its place on the object, and how heavy both bodies are there.

        The distances decide whether it may close, the masses set the damping of its grasp.

        Args:
            gripper: Number of the gripper.
            Q: Position of the robot (nq,).
            v: Velocity of the robot (n,).
            target_object: Pose and velocity of the object (n_pose + n_twist,).
            anchor: The gripper's place on the object: a pose in the object's frame (n_pose,).

        Returns:
            Distance [m], angle [rad], velocity [m/s] and angular velocity [rad/s] relative to the place (4,). And the
            inverses of the mass [1/kg] and of the inertia [1/(kg m^2)] that a wrench between gripper and object has to
            move, each a mean over its directions (2,).
        """
        d = self.model.dimension
        object_pose, object_velocity = np.split(target_object, [self.space.n_pose])
        gripper_pose, gripper_rate, J = (output.full() for output in self.gripper_motion(gripper, Q, v))
        relative = relative_motion(
            self.space, gripper_pose.ravel(), gripper_rate.ravel(), object_pose, object_velocity, anchor
        )
        distances = [
            np.linalg.norm(difference) for difference in (relative.r, relative.phi, relative.rdot, relative.omega)
        ]
        # acceleration of gripper relative to object by a wrench on the one and its opposite on the other
        inverse_of_robot = J @ np.linalg.solve(self.model.mass_matrix(Q), J.T)
        inverse = inverse_of_robot + self._inverse_mass_of_object(object_pose, relative.lever, relative.lever)
        return np.array(distances), np.array([inverse.diagonal()[:d].mean(), inverse.diagonal()[d:].mean()])

    def inverse_mass(self, Q: np.ndarray, pose: np.ndarray, anchors: np.ndarray) -> np.ndarray:
        """Compute the inverse of the effective mass between grippers and object, to find how fast grasps oscillate.

        It is W = J H^-1 J' + J_o M_o^-1 J_o', with the Jacobians J of the grippers and J_o of the object's points at
        them: W times the wrenches on the grippers, the opposite ones on the object, is the acceleration of the grippers
        relative to the object at rest.

        Args:
            Q: Position of the robot (nq,).
            pose: Pose of the object (n_pose,).
            anchors: Poses in the object's frame where the A grippers hold it (A, n_pose). The robot at Q need not have
                its grippers there.

        Returns:
            W (A n_twist, A n_twist), gripper by gripper, each with the components of a twist.
        """
        J = np.vstack([self.gripper_motion(i, Q, np.zeros(self.model.n))[2].full() for i in range(len(self.grippers))])
        _, attitude = self.space.to_3d(pose)
        levers = [rotate(attitude, self.space.to_3d(anchor)[0]) for anchor in anchors]
        object_part = np.block(
            [[self._inverse_mass_of_object(pose, pushed_at, moved_at) for pushed_at in levers] for moved_at in levers]
        )
        return np.asarray(J @ np.linalg.solve(self.model.mass_matrix(Q), J.T) + object_part)

    def _inverse_mass_of_object(self, pose: np.ndarray, pushed_at: Vector, moved_at: Vector) -> np.ndarray:
        """Return the acceleration of one point of the object at rest by a unit wrench on it at another point.

        Args:
            pose: Pose of the object (n_pose,).
            pushed_at: Where the wrench acts, from the object's centre of mass, in the inertial frame (3,) [m].
            moved_at: The point that accelerates, from the same centre and in the same frame (3,) [m].

        Returns:
            (n_twist, n_twist), a column for each component of the wrench.
        """
        columns = []
        space = self.space
        for force, moment in map(space.twist_to_3d, np.eye(self.wrench_size)):
            wrench = space.twist(force, add(moment, cross(pushed_at, force)))
            linear, angular = space.twist_to_3d(self.body.rates(pose, np.zeros(self.wrench_size), wrench)[1])
            angular = rotate(space.to_3d(pose)[1], angular)
            columns.append(space.twist(add(linear, cross(angular, moved_at)), angular))
        return np.array(columns, dtype=float).T


SMALLEST_LEVER = 1e-12
"""Distance from the centre of mass below which a grasp has no outward direction [m]."""


class Capture:
    """The object of a run and the state of its grasps: which are closed, where, and what load they bear.

    Attributes:
        law: The bushings between grippers and object.
        body: The true object.
        described: The object as the task describes it, which is what a low-level law may know of it.
        state: Pose and velocity of the object now (n_pose + n_twist,).
        parameters: Parameters of the bushings now, a row for each gripper (A, n_parameters).
        closed: Which grippers are closed (A,).
        load: Filtered loads on the grasps: pull, shear and moment (A, 3).
        filter_gain: Share of the difference between load and filtered load by which the latter changes in a tick.
    """

    def __init__(self, task: TaskSpec, model: RobotModel, target_object: ObjectBody) -> None:
        """Set up a free object and open grippers.

        Where the task says that the object is uncertain, its true mass and velocity differ from the description: they
        are drawn at random from the task's seed.

        Args:
            task: The task, with its seed, the uncertainty of the object and the rate of the low-level law.
            model: The robot.
            target_object: The object as the task describes it.
        """
        spec = target_object.grasp
        body = body_of(target_object)
        error = task.uncertainty.object or ObjectErrorSpec()
        # of the mass, of three linear and of three angular velocities; in the plane some of these are not used
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
        self._anchors = np.array([spec.at[gripper] for gripper in law.grippers])  # where grippers are to close
        self.parameters = np.hstack([self._anchors, np.zeros((count, 4))])  # 0: stiffnesses and dampings when open
        self.closed = np.zeros(count, bool)
        self._is_to_hold = False  # whether grippers are commanded to be closed
        self.load = np.zeros((count, len(GRASP_LOADS)))
        self._load_at_loss = np.zeros_like(self.load)  # of grasps lost at this tick, for the log
        self._events = list[GraspEvent]()
        # states, wrenches, loads, closed grippers over the ticks of the sample so far, for its log
        self._ticks_of_sample: list[tuple[np.ndarray, ...]] = []
        self._forces = ArrayFunction(law.forces)
        # A first-order filter with time constant T follows by 1 - exp(-tick / T). Grasps that cannot be lost, those
        # without a strength, have no filter.
        self.filter_gain = 1.0 if spec.strength is None else -np.expm1(-tick / spec.strength.filter)

    @property
    def pose_and_velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity of the object now."""
        return self.state[: self.law.object_sizes[0]], self.state[self.law.object_sizes[0] :]

    @property
    def header(self) -> dict[str, ArrayLike]:
        """What a log says of object and grasps before a run begins, by the path of its dataset."""
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
        """What grippers report: whether each holds the object, by arm; empty while they are commanded to be open."""
        return dict(zip(self.law.grippers, self.closed.tolist(), strict=True)) if self._is_to_hold else {}

    def measured(self, sample: int) -> np.ndarray:
        """Return the pose of the object that is measured at a sample, with the noise of the task, (3,) or (7,)."""
        noise = self._task.uncertainty.noise
        size = self.law.wrench_size
        d = self.law.model.dimension
        deviation = np.array([noise.object_position] * d + [noise.object_angle] * (size - d))
        step = stream(self._task.seed, "object noise", sample).standard_normal(size) * deviation
        pose, _ = self.pose_and_velocity
        return np.array(self.law.space.integrate(pose, step))

    def eigenvalues_when_held(self, Q: np.ndarray) -> np.ndarray:
        """Compute how fast robot and object oscillate when all grippers hold it, to check the integrator's step.

        The displacements r of the grippers relative to the object (A n_twist,) follow r'' = -W (K r + D r'), with W of
        `GraspLaw.inverse_mass` and the stiffnesses K and dampings D of the bushings, as they are set at closing.

        Args:
            Q: Position of the robot (nq,), near that at which the grippers close.

        Returns:
            Complex eigenvalues of that equation [1/s], two for each component of r.
        """
        pose, _ = self.pose_and_velocity
        d = self.law.model.dimension
        W = self.law.inverse_mass(Q, pose, self._anchors)
        # for each component of a twist, which of a pair it takes: 0 the linear stiffness or damping, 1 the angular one
        which_of_pair = np.r_[np.zeros(d, int), np.ones(self.law.wrench_size - d, int)]
        stiffness = []
        damping = []
        for gripper in range(len(self._anchors)):
            inverses_of_gripper = W.diagonal()[gripper * self.law.wrench_size : (gripper + 1) * self.law.wrench_size]
            mean_inverses = np.array([inverses_of_gripper[:d].mean(), inverses_of_gripper[d:].mean()])
            stiffness.append(np.array(self.spec.stiffness)[which_of_pair])
            damping.append(self._damping(mean_inverses)[which_of_pair])
        zeros = np.zeros_like(W)
        # of the state [r; r']; W * k scales the columns of W, as a product with the diagonal matrix of k does
        system_matrix = np.block(
            [[zeros, np.eye(len(W))], [-W * np.concatenate(stiffness), -W * np.concatenate(damping)]]
        )
        return np.linalg.eigvals(system_matrix)

    def _damping(self, inverse: np.ndarray) -> np.ndarray:
        """Return linear and angular damping of a bushing from the inverses of effective mass and inertia (2,) at it.

        They are those of the wanted damping ratio, d = 2 zeta sqrt(k m).
        """
        return np.asarray(2 * self.spec.damping_ratio * np.sqrt(self.spec.stiffness / inverse))

    def command_grippers(self, time: float, robot_state: np.ndarray, wanted: bool) -> None:
        """Close or open the grippers at the beginning of a tick, where the command changes.

        Args:
            time: When the tick begins [s].
            robot_state: State [Q; v] of the robot (nq + n,).
            wanted: Whether they are to be closed.
        """
        if wanted and not self._is_to_hold:
            self._close(time, robot_state)
        elif self._is_to_hold and not wanted:
            self._open(time, self.closed, "let go")
        self._is_to_hold = wanted

    def begin_tick(self, time: float, robot_state: np.ndarray, wanted: bool) -> np.ndarray | None:
        """Close or open the grippers at the beginning of a tick, and drop the grasps that would bear too much in it.

        Args:
            time: When the tick begins [s].
            robot_state: State [Q; v] of the robot (nq + n,).
            wanted: Whether they are to be closed.

        Returns:
            Parameters of the grasps of an object that all hands hold, see `HeldLoad.force`; None while they do not.
        """
        self.command_grippers(time, robot_state, wanted)
        times = np.array([time])
        while not self.record_until_loss(
            times, self.state[None], *(values[None] for values in self.wrenches_and_loads(robot_state))
        ):
            pass  # a grasp was lost: look whether those that are left bear the tick
        return self.parameters[:, :-2] if self.closed.all() else None  # without the dampings

    @property
    def is_known_load(self) -> bool:
        """Whether all hands hold the object, and the low-level law knows of it."""
        return bool(self.spec.known and self.closed.all())

    def record_until_loss(self, times: np.ndarray, states: np.ndarray, wrench: np.ndarray, load: np.ndarray) -> int:
        """Record what the grasps bear over K ticks, up to the first in which one bears too much and is lost.

        Args:
            times: When the ticks begin (K,) [s].
            states: Pose and velocity of the object where they begin (K, n_pose + n_twist).
            wrench: Wrenches on the object at the grippers (K, A, n_twist).
            load: Filtered loads on the grasps: pull, shear and moment (K, A, 3).

        Returns:
            The number of ticks before a loss, K if nothing is lost. The tick of a loss is not recorded: it has to be
            simulated again, without the grasp that was lost.
        """
        is_too_much = self.closed & (load > self.spec.largest_loads).any(axis=2)
        ticks_of_loss = np.flatnonzero(is_too_much.any(axis=1))
        ticks_before_loss = int(ticks_of_loss[0]) if ticks_of_loss.size else len(times)
        if ticks_before_loss:
            logged_load = load[:ticks_before_loss].copy()
            self.load = logged_load[-1].copy()
            # If a grasp was lost at the first of these ticks, the tick is simulated again without it, and the log shows
            # the load that was too much.
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

    def end_sample(self) -> ObjectTicks:
        """Return what object and grasps did over the sample that ends, and begin the record of the next one."""
        states, wrench, load, closed = (np.concatenate(column) for column in zip(*self._ticks_of_sample, strict=True))
        pose, v = np.split(np.vstack([states, self.state]), [self.law.object_sizes[0]], axis=1)
        events = tuple(self._events)
        self._ticks_of_sample = []
        self._events = []
        return ObjectTicks(pose, v, wrench, load, closed, events)

    def _close(self, time: float, robot_state: np.ndarray) -> None:
        """Close every gripper that is near enough to its place on the object, and record which close and which miss it.

        A gripper may close inside its envelope: limits of distance, angle, velocity and angular velocity relative to
        that place. A bushing, a spring and damper, then holds it in the pose relative to the object that it has.

        Args:
            time: When the tick begins [s].
            robot_state: State [Q; v] of the robot (nq + n,).
        """
        envelope = [getattr(self.spec.envelope, name) for name in MISSED_BY]
        nq = self.law.model.nq
        pose, _ = self.pose_and_velocity
        poses = dict(zip(self.law.model.pose_rows, self.law.model.poses(robot_state[:nq]), strict=True))
        for number, gripper in enumerate(self.law.grippers):
            distances, mean_inverses = self.law.distances_and_inverse_masses(
                number, robot_state[:nq], robot_state[nq:], self.state, self._anchors[number]
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
        """Open grippers, given by a mask (A,), and record why: `let go` or `lost`; their bushings no longer act."""
        for i in np.flatnonzero(which):
            self._events.append(GraspEvent(self.law.grippers[i], time, why, tuple(self.load[i].tolist())))
            self.parameters[i, -4:] = 0.0
            self.closed[i] = False
            self.load[i] = 0.0

    def wrenches_and_loads(self, robot_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute what grasps bear in a tick: their wrenches on the object (A, n_twist), and filtered loads (A, 3)."""
        if not self.closed.any():
            return np.zeros((len(self.closed), self.law.wrench_size)), self.load
        nq = self.law.model.nq
        pose, v = self.pose_and_velocity
        *_, wrench, load = self._forces(robot_state[:nq], robot_state[nq:], pose, v, self.parameters.ravel())
        return wrench, self.load + self.filter_gain * self.closed[:, None] * (load - self.load)


def build_capture(task: TaskSpec, model: RobotModel) -> Capture | None:
    """Build the object of a task with its grasps, for the plants that simulate robot and object together.

    Args:
        task: The task.
        model: The robot.

    Returns:
        Object and grasps; None if the object has no mass, since then it takes part in no dynamics.

    Raises:
        InputError: The grasps are too stiff for the integrator's step. The message says the largest step that would do.
    """
    if task.body.mass == 0.0:
        return None
    capture = Capture(task, model, task.body)
    eigenvalues = capture.eigenvalues_when_held(stack(task.initial, model.spec, "joint"))
    step = task.plant.step or 1 / task.plant.low_level_rate
    if not is_stable(eigenvalues * step * STEP_RESERVE):
        allowed_step = step
        while not is_stable(eigenvalues * allowed_step * STEP_RESERVE):
            allowed_step *= 0.98  # the largest stable step is found to 2 %
        raise InputError(
            f"object.grasp.stiffness: found a step of {step:g} s, expected at most {allowed_step:.2g} s for grasps "
            "of this stiffness and damping: take a smaller plant.step, or softer grasps"
        )
    return capture


STEP_RESERVE = 1.3
"""Factor by which a step has to be stable beyond its length: effective masses change with the posture."""


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
        return self.capture.end_sample()


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
