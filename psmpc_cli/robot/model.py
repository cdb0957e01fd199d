"""The model of a robot: numeric methods for Python users, CasADi functions for optimization and simulation."""

import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.robot import motion
from psmpc_cli.robot.configuration import configuration_space, pose_frames
from psmpc_cli.robot.dynamics import (
    Dynamics,
    InertialParameters,
    TaskSpaceDynamics,
    derive_dynamics,
    derive_task_space_dynamics,
    function,
    law_with_base_force,
    law_with_driven_coordinates,
    stored_in,
)
from psmpc_cli.robot.kinematics import Frame, SpatialFrame, place
from psmpc_cli.robot.rotations import add, cross, rotate, scaled
from psmpc_cli.robot.shape import RobotShape
from psmpc_cli.specs.arguments import rejected, require
from psmpc_cli.specs.load import load_robot as load_robot_spec
from psmpc_cli.specs.parts import CoordinateUnits, MobilityTraits
from psmpc_cli.specs.robots.robot import RobotSpec, labels, units

Array = NDArray[np.float64]

T = TypeVar("T")

KEPT_ROBOTS = 4
"""Robots of which a thread keeps what is derived from their descriptions: of a robot in space that takes seconds."""

_of_thread = threading.local()  # functions must not be called from several threads at once


class RobotModel:
    """Kinematics and dynamics of one robot with coordinates Q (nq,) and velocities v (n,).

    A planar robot has Q = [x, y, theta of the base, joint coordinates arm by arm] [m, rad] and v = Qdot. A spatial one
    has Q = [position of the base's frame (3), its unit quaternion w, x, y, z (4), joint coordinates] and v = [linear
    velocity in the inertial frame (3), angular velocity in the body's frame (3), joint rates], so nq = n + 1. Numeric
    methods take and return arrays; one model must not be called from several threads at once. Where a method takes
    `parameters`, they replace the inertial parameters of the robot's description.

    The CasADi functions take and return columns and accept SX, MX and numbers.

    Attributes:
        spec: The robot's description.
        n: Number of velocity coordinates.
        nq: Number of coordinates Q.
        m: Number of pose coordinates xi.
        n_twists: Number of rows of J_C: those of the velocities of base and end-effectors.
        space: Its configuration space: sizes, and what depends on plane or space.
        dimension: Number of position coordinates of a pose; its further rows are its angle, or its unit quaternion.
        parts: Rows of v by part: `base`, then the arms in order.
        pose_rows: Rows of xi by frame: `base`, then the end-effectors of the arms.
        g: Q -> xi (m,) [m, rad]. Paper eq. (1).
        body_poses: Q -> poses of all bodies in the order of `spec.bodies` (coordinates of a pose, bodies), as in xi.
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Derive the kinematics of a robot; equations of motion and what takes longer are derived on first use.

        Args:
            spec: Its description, as a robot file has it.
        """
        self._cache: dict[Hashable, Any] = {}
        self._derived = _derived_from(spec)
        self.spec = spec
        self.space = configuration_space(spec)
        self.dimension = self.space.dimension
        self.n = self.space.n
        self.nq = self.space.nq
        Q = ca.SX.sym("Q", self.nq)
        bodies, xi = self._frames_and_poses(self.space.base_frame(Q), Q[self.space.joint_coordinates])
        body_poses = ca.horzcat(*(frame.pose for frame in bodies))
        self.m = xi.numel()
        self.parts = _consecutive_slices(spec.parts)
        self.pose_rows = _consecutive_slices(dict.fromkeys(("base", *spec.tools), self.space.n_pose))
        self.n_twists = self.space.n_twist * len(self.pose_rows)
        self.g = function("g", {"Q": Q}, {"xi": xi})
        self.body_poses = function("body_poses", {"Q": Q}, {"poses": body_poses})

    def __repr__(self) -> str:
        size = f"{len(self.spec.bodies)} bodies, {self.n} degrees of freedom"
        return f"<RobotModel {self.spec.name}: in {'the plane' if self.dimension == 2 else 'space'}, {size}>"

    def cached(self, key: Hashable, build: Callable[[], T]) -> T:
        """Return what is built for this robot under a key; the same object for every call while it lives."""
        if key not in self._cache:
            self._cache[key] = build()
        built: T = self._cache[key]
        return built

    def derived(self, key: Hashable, build: Callable[[], T]) -> T:
        """Return what is built from the description alone; models of equal ones share it within a thread."""
        if key not in self._derived:
            self._derived[key] = build()
        built: T = self._derived[key]
        return built

    def _frames_and_poses(self, base: Frame, joints: ca.SX) -> tuple[list[Frame], ca.SX]:
        """Return the frames of the bodies, and the poses xi (m,), with the base at a frame and joints (joints,)."""
        bodies, tools = place(self.spec, base, joints)
        return bodies, ca.vertcat(bodies[0].pose, *(frame.pose for frame in tools.values()))

    def charted_frames(self, Q: ca.SX, anchor: ca.SX) -> tuple[list[Frame], dict[str, Frame]]:
        """Return the frames of the bodies, and those of the end-effectors by arm, at coordinates in a chart (n,)."""
        return place(self.spec, self.space.charted_frame(Q, anchor), Q[self.space.joint_rates])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the generalized coordinates, (n,): `base.x`, ..., `arm_1.1`, ..."""
        return labels(self.spec, "joint")

    @cached_property
    def units(self) -> tuple[CoordinateUnits, ...]:
        """Units of the generalized coordinates and of what belongs to them, (n,)."""
        return units(self.spec)

    @property
    def dynamics(self) -> Dynamics:
        """The equations of motion, derived when they are first used: poses and what a task asks need none."""
        return self.derived(derive_dynamics, partial(derive_dynamics, self.spec))

    def driven(self, moved_by: MobilityTraits | None = None) -> tuple[float, ...]:
        """Return 1 for each velocity coordinate of the base on which something acts, 0 for the others, (n_twist,).

        Args:
            moved_by: What moves the base; by default what the robot's description says.
        """
        moved_by = moved_by or self.spec.moved_by
        linear = float(moved_by.is_pushed)
        angular = float(moved_by.is_turned)
        return (linear,) * self.dimension + (angular,) * (self.space.n_twist - self.dimension)

    def actuated(self, moved_by: MobilityTraits | None = None) -> np.ndarray:
        """Return which velocity coordinates have a force of their own, (n,): all but those of `driven` that are 0."""
        return np.array([*self.driven(moved_by), *np.ones(self.space.joints)], bool)

    @property
    def mounted(self) -> "RobotModel":
        """The same robot with a fixed base."""
        return self.cached("mounted", lambda: RobotModel(self.spec.model_copy(update={"mobility": "fixed"})))

    def law(self, driven: tuple[float, ...] | None = None) -> ca.Function:
        """Return Q, v, u, w -> F (n,) [N, N m], the computed torque. Paper eq. (7).

        Args:
            driven: On which coordinates of the base something acts, see `driven`; by default as the robot's description
                says. The others get no force, and their rows of u have no effect.
        """
        driven = driven or self.driven()
        return self.derived(("law", driven), partial(self._law, driven))

    def _law(self, driven: tuple[float, ...]) -> ca.Function:
        if not all(driven):
            return law_with_driven_coordinates(self.spec, self.law((1.0,) * len(driven)), ca.DM(driven))
        Q, v, u, w = self.dynamics.inverse.sx_in()
        return function("law", {"Q": Q, "v": v, "u": u, "w": w}, {"F": self.dynamics.inverse(Q, v, u, w)})

    @property
    def pushed_law(self) -> ca.Function:
        """Q, v, u, w, force that acts on the base (n_twist,) -> F (n,); see `law_with_base_force`."""
        every = (1.0,) * self.space.n_twist
        return self.derived(("pushed law",), lambda: law_with_base_force(self.spec, self.law(every)))

    def law_jacobian(self, driven: tuple[float, ...] | None = None) -> ca.Function:
        """Return joints, v, u, w -> the derivatives of `law` by [joints; v; u] (n, joints + 2n), base at neutral.

        Those by what wheels store follow, of a robot that has any.

        Force, velocity and acceleration along the base's own axes depend on neither its position nor its attitude:
        these derivatives are those of all poses, without the operations that turn vectors into the inertial frame.
        """
        driven = driven or self.driven()
        return self.derived(("law_jacobian", driven), partial(self._law_jacobian, driven))

    def _law_jacobian(self, driven: tuple[float, ...]) -> ca.Function:
        joints = ca.SX.sym("joints", self.space.joints)
        v = ca.SX.sym("v", self.n)
        u = ca.SX.sym("u", self.n)
        w = ca.SX.sym("w", self.nominal.vector.size)
        F = self.law(driven)(self.space.at_neutral_base(joints), v, u, w)
        F_by = ca.jacobian(F, ca.vertcat(joints, v, u))
        if self.spec.wheels:
            F_by = ca.horzcat(F_by, ca.jacobian(F, w)[:, stored_in(self.spec, w)])
        return ca.Function("law_jacobian", [joints, v, u, w], [F_by])

    @cached_property
    def charted(self) -> ca.Function:
        """Coordinates in a chart (n,), its anchor -> xi (m,)."""
        Q = ca.SX.sym("Q", self.n)
        anchor = ca.SX.sym("anchor", self.space.n_anchor)
        _, xi = self._frames_and_poses(self.space.charted_frame(Q, anchor), Q[self.space.joint_rates])
        return function("charted", {"Q": Q, "anchor": anchor}, {"xi": xi})

    @cached_property
    def J_C(self) -> ca.Function:
        """Q -> (rows, n), velocities of the frames by v. Paper eq. (2).

        Rows of a planar robot are those of xi; a spatial one has for each frame the velocity of its origin and its
        angular velocity, both in the inertial frame (6 frames, n).
        """
        Q = ca.SX.sym("Q", self.nq)
        if self.dimension == 2:
            return function("J_C", {"Q": Q}, {"J_C": ca.densify(ca.jacobian(self.g(Q), Q))})
        bodies, tools = place(self.spec, self.space.base_frame(Q), Q[self.space.joint_coordinates])
        rows = [_frame_jacobian(self.spec, bodies, 0, bodies[0])]
        for name, tool in self.spec.tools.items():
            rows.append(_frame_jacobian(self.spec, bodies, tool.body, tools[name]))
        return function("J_C", {"Q": Q}, {"J_C": ca.densify(ca.vertcat(*rows))})

    @cached_property
    def Jdot_v(self) -> ca.Function:
        """Q, v -> Jdot_C v (rows of J_C,), the rates of the frames' velocities at vdot = 0."""
        Q = ca.SX.sym("Q", self.nq)
        v = ca.SX.sym("v", self.n)
        Qdot = ca.vertcat(*self.space.rate(ca.vertsplit(Q), ca.vertsplit(v)))
        rate = ca.jtimes(self.J_C(Q) @ v, Q, Qdot)
        return function("Jdot_v", {"Q": Q, "v": v}, {"Jdot_v": ca.densify(rate)})

    @property
    def task_space(self) -> TaskSpaceDynamics:
        """The equations of motion of the velocities of base and end-effectors. Paper eqs. (5) and (6)."""
        return self.derived(
            derive_task_space_dynamics, lambda: derive_task_space_dynamics(self.dynamics, self.J_C, self.Jdot_v)
        )

    def n_inputs(self, kind: str) -> int:
        """Return the number of inputs of the field `f_1` (`joint`) or `f_2` (`task`)."""
        return self.n if kind == "joint" else self.n_twists

    def field(self, kind: str) -> ca.Function:
        """Return the field `f_1` (`joint`) or `f_2` (`task`) by which a state changes."""
        return self.f_1 if kind == "joint" else self.f_2

    @cached_property
    def f_1(self) -> ca.Function:
        """x, u, anchor -> xdot (2n,), x = [Q; Qdot] in the chart about an anchor, u = Qddot. Paper eq. (8)."""
        x = ca.SX.sym("x", 2 * self.n)
        u = ca.SX.sym("u", self.n)
        anchor = ca.SX.sym("anchor", self.space.n_anchor)
        return function("f_1", {"x": x, "u": u, "anchor": anchor}, {"xdot": motion.rate(x, u)})

    @cached_property
    def f_2(self) -> ca.Function:
        """x, u, anchor -> xdot (2n,): how the state changes under inputs in task space. Below paper eq. (8).

        u are the rates of the velocities J_C v of base and end-effectors (n_twists,), in the plane the accelerations of
        their poses xi. x = [Q; Qdot] is the state in a chart, whose attitudes are rotation vectors about the anchor.
        The paper's state is [xi; xidot], a double integrator under u. Here x are other coordinates of the same state:
        in them limits of joints are boxes, and stages with inputs in joint space have the same ones.
        """
        x = ca.SX.sym("x", 2 * self.n)
        u = ca.SX.sym("u", self.n_twists)
        anchor = ca.SX.sym("anchor", self.space.n_anchor)
        Q = x[: self.n]
        Qdot = x[self.n :]
        coordinates = self.space.charted_coordinates(Q, anchor)
        v = self.space.charted_velocity(Q, Qdot)
        vdot = self.task_space.acceleration(coordinates, v, u, self.nominal.vector)
        acceleration = self.space.acceleration_in_chart(Q, Qdot, vdot)
        return function("f_2", {"x": x, "u": u, "anchor": anchor}, {"xdot": ca.vertcat(Qdot, acceleration)})

    def task_space_condition(self, Q: ArrayLike) -> Array:
        """Return the condition number of J_C in SI units, () at coordinates (nq,), or (K,) at (K, nq).

        It is infinite where J_C has lost rank: there the law in task space has no finite force.
        """
        columns = self._evaluate("J_C", Q)
        singular = np.linalg.svd(columns.reshape(*np.shape(Q)[:-1], self.n, -1), compute_uv=False)
        with np.errstate(divide="ignore"):
            return np.asarray(np.divide(singular[..., 0], singular[..., -1]))

    @property
    def neutral(self) -> Array:
        """Coordinates 0 (nq,), in space with the attitude of the inertial frame."""
        return self.space.neutral

    @cached_property
    def shape(self) -> RobotShape:
        """What the robot looks like, for drawings."""
        return RobotShape(self.spec)

    @cached_property
    def nominal(self) -> InertialParameters:
        """Inertial parameters of the robot's description, with empty grippers."""
        return InertialParameters.nominal(self.spec)

    def poses(self, Q: ArrayLike) -> Array:
        """Return the poses of the base and of each end-effector in order.

        (x, y, angle) [m, m, rad], (frames, 3); of a spatial robot (x, y, z, w, x, y, z) [m], (frames, 7).
        At coordinates (nq,), or at each of (K, nq).
        """
        return self._evaluate("g", Q).reshape(*np.shape(Q)[:-1], len(self.pose_rows), -1)

    def body_frames(self, Q: ArrayLike) -> Array:
        """Return the frames of all bodies at coordinates (..., nq), in the order of `spec.bodies`, (..., bodies, 4, 4).

        Positions are in metres; a planar robot is in the plane z = 0.

        Raises:
            InputError: Q is of another size.
        """
        if (shape_of(Q) or ())[-1:] != (self.nq,):
            raise rejected("Q", Q, f"numbers (..., {self.nq})")
        Q = np.asarray(Q, dtype=float)
        poses = self.body_poses(Q.reshape(-1, self.nq).T).full().T
        return pose_frames(poses).reshape(*Q.shape[:-1], len(self.spec.bodies), 4, 4)

    def centre_of_mass(self, Q: ArrayLike) -> Array:
        """Compute the common centre of mass (2,) or (3,) [m] at Q (nq,)."""
        centres = np.array([[*body.centre, 1.0] for body in self.spec.bodies])
        masses = np.array([body.mass for body in self.spec.bodies])
        placed = np.einsum("bij,bj->bi", self.body_frames(Q), centres)
        return np.asarray(masses @ placed[:, : self.spec.dimension] / masses.sum())

    def mass_matrix(self, Q: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return H(Q), (n, n) [kg, kg m, kg m^2]. Paper eq. (3)."""
        return self._evaluate("H", Q, self._parameter_vector(parameters)).reshape(self.n, self.n)

    def inertia_about_centre(self, Q: ArrayLike) -> Array:
        """Return the inertia of the whole robot about its centre of mass, its joints held, (1, 1) or (3, 3) [kg m^2].

        It is along the base's axes, and without what turns with wheels about their own.
        """
        H = self.mass_matrix(Q)
        linear = slice(self.dimension)
        angular = self.space.rotation
        coupling = H[angular, linear]
        return np.asarray(H[angular, angular] - coupling @ np.linalg.solve(H[linear, linear], coupling.T))

    def bias(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return the Coriolis and centrifugal forces C(Q, v) v, (n,) [N, N m]. Below paper eq. (3)."""
        return self.inverse_dynamics(Q, v, 0.0, parameters)

    def inverse_dynamics(
        self, Q: ArrayLike, v: ArrayLike, vdot: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Return the generalized force F = H vdot + C v, (n,) [N, N m], of accelerations vdot (n,). Paper eq. (3)."""
        return self._evaluate("inverse", Q, v, vdot, self._parameter_vector(parameters))

    def computed_torque(
        self,
        Q: ArrayLike,
        v: ArrayLike,
        u: ArrayLike,
        parameters: InertialParameters | None = None,
        driven: tuple[float, ...] | None = None,
        base_force: ArrayLike | None = None,
    ) -> Array:
        """Return the generalized force, (n,) [N, N m], that gives actuated coordinates accelerations u (n,). Eq. (7).

        If thrusters move the base, it is that of inverse dynamics. Without them the base gets no force, and its rows of
        u have no effect: it reacts to the motion of the joints, or stands still if it is fixed.

        Args:
            Q: Position of the robot (nq,), or (K, nq).
            v: Velocity (n,).
            u: Accelerations (n,).
            parameters: Inertial parameters of the robot; by default its own.
            driven: 1 for each coordinate of the base on which something acts, else 0, see `RobotModel.driven`; by
                default as its description says.
            base_force: Force that acts on the base, whatever is commanded, its moment in space about the base's axes
                (n_twist,) [N, N m]; see `law_with_base_force` for what is then returned. By default that of the law.
        """
        if base_force is not None:
            return self._evaluate("pushed_law", Q, v, u, self._parameter_vector(parameters), base_force)
        return self._evaluate(driven or self.driven(), Q, v, u, self._parameter_vector(parameters))

    def task_space_force(
        self, Q: ArrayLike, v: ArrayLike, a: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Compute the generalized force F = J_C' F_m of the law in task space. Paper eqs. (5) and (6).

        It makes the velocities J_C v of the base and the end-effectors change at the rates a. F_m is the force on these
        frames that eq. (6) asks for. The motion of redundant joints that moves no frame is damped, by
        `TaskSpaceDynamics`.

        Args:
            Q: Position of the robot (nq,).
            v: Velocity (n,).
            a: Wanted rates of J_C v (k,), linear and angular by frame [m/s^2, rad/s^2].
            parameters: Inertial parameters that the law assumes for the robot; by default the model's own.

        Returns:
            The force (n,) [N, N m], as if thrusters gave all of the base's.

        Raises:
            InputError: An arm has fewer joints than its pose has coordinates, so that J_C has no inverse.
        """
        return self._evaluate("task_law", Q, v, a, self._parameter_vector(parameters))

    def task_space_acceleration(
        self, Q: ArrayLike, v: ArrayLike, a: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Return the rates of v (n,) [m/s^2, rad/s^2] under `task_space_force`."""
        return self._evaluate("task_acceleration", Q, v, a, self._parameter_vector(parameters))

    def twists(self, Q: ArrayLike, v: ArrayLike) -> Array:
        """Return the velocities J_C v of base and end-effectors (k,) [m/s, rad/s]. Paper eq. (2).

        At coordinates (nq,) and velocities (n,), or at each of (K, nq) and (K, n).
        """
        return self._evaluate("twists", Q, v)

    def twist_rates(self, Q: Array, v: Array, u: Array, tick: float) -> Array:
        """Return the mean rates of J_C v over ticks [s] (M, k) while accelerations u (M, n) hold for one each.

        Under these rates the frames have at every tick the velocities to which the accelerations lead.
        """
        return np.diff(self.twists(*motion.over_ticks(self.space, Q, v, u, tick)), axis=0) / tick

    def forward_dynamics(
        self, Q: ArrayLike, v: ArrayLike, F: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Return the accelerations H^-1 (F - C v), (n,) [m/s^2, rad/s^2], under a generalized force F (n,)."""
        return self._evaluate("forward", Q, v, F, self._parameter_vector(parameters))

    def momentum(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return linear momentum [N s] and angular momentum about the inertial origin [N m s], (3,) or (6,)."""
        return self.balance(Q, v, parameters)[..., :-1]

    def kinetic_energy(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> float:
        """Return the kinetic energy [J]."""
        return float(self.balance(Q, v, parameters)[-1])

    def balance(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return momentum, then kinetic energy, (4,) or (7,): what external forces alone change, and all forces.

        At coordinates (nq,) and velocities (n,), or at each of (K, nq) and (K, n).
        """
        return self._evaluate("balance", Q, v, self._parameter_vector(parameters))

    def _evaluate(self, name: str | tuple[float, ...], *arguments: ArrayLike) -> Array:
        """Return the result of one of the model's CasADi functions at coordinates (nq,), or at each of (K, nq).

        Args:
            name: Of the function; that of a low-level law is what it drives, see `driven`.
            arguments: Its arguments in their order, Q first. Others may be a number for all of their components, one
                vector for all rows of Q, or one for each.

        Returns:
            The result (size,), or (K, size), as one vector for each row of Q.

        Raises:
            InputError: Arguments are no numbers, or of the wrong size.
        """
        rows: tuple[int, ...] = ()  # (K,), or () for a single Q
        function, sizes = self._batch_function(name)
        for (argument_name, size), argument in zip(sizes.items(), arguments, strict=True):
            shape = shape_of(argument)
            if argument_name == "Q" and shape:
                rows = shape[:-1]
            is_scalar = shape == () and argument_name != "Q"
            if len(rows) > 1 or 0 in rows or not (is_scalar or shape in ((size,), (*rows, size))):
                raise rejected(argument_name, argument, f"numbers ({size},), or ({size},) at each of K rows of Q")
        return function(*arguments, rows=max((1, *rows)))[0].reshape(*rows, -1)

    def _parameter_vector(self, parameters: InertialParameters | None) -> Array:
        if parameters is None:
            return self.nominal.vector
        require("parameters", parameters, InertialParameters, "InertialParameters")
        return parameters.vector

    def _batch_function(self, name: str | tuple[float, ...]) -> tuple[BatchFunction, dict[str, int]]:
        """Return a CasADi function on arrays, and the sizes of its arguments by name, Q first."""

        def build() -> tuple[BatchFunction, dict[str, int]]:
            function = self._array_source(name)
            return BatchFunction(function), {function.name_in(i): function.size1_in(i) for i in range(function.n_in())}

        return self.derived(("on arrays", name), build)

    def _array_source(self, name: str | tuple[float, ...]) -> ca.Function:
        """Return the CasADi function of this name, built on first use: those in task space take seconds."""
        if isinstance(name, tuple):
            return self.law(name)
        if name == "g":
            return self.g
        if name == "pushed_law":
            return self.pushed_law
        if name in ("J_C", "twists"):
            return self._of_velocity[name]
        if name in ("task_law", "task_acceleration"):
            task_space = self.task_space
            return task_space.law if name == "task_law" else task_space.acceleration
        return self._of_motion[name]

    @cached_property
    def _of_velocity(self) -> dict[str, ca.Function]:
        """The columns of J_C one below the other, and J_C v."""
        Q = ca.SX.sym("Q", self.nq)
        v = ca.SX.sym("v", self.n)
        J_C = self.J_C(Q)
        columns = function("J_C", {"Q": Q}, {"columns": ca.vec(J_C)})
        return {"J_C": columns, "twists": function("twists", {"Q": Q, "v": v}, {"twists": J_C @ v})}

    @cached_property
    def _of_motion(self) -> dict[str, ca.Function]:
        """The functions of the equations of motion that are evaluated on arrays, by name."""
        dynamics = self.dynamics
        state = dynamics.momentum.sx_in()
        kept = ca.vertcat(dynamics.momentum(*state), dynamics.kinetic_energy(*state))
        balance = ca.Function("balance", state, ca.cse([kept]), dynamics.momentum.name_in(), ["balance"])
        inertial = dynamics.H.sx_in()
        H = ca.Function("H", inertial, [ca.vec(dynamics.H(*inertial))], dynamics.H.name_in(), ["H"])
        functions = H, dynamics.inverse, dynamics.forward, balance
        return {function.name(): function for function in functions}


def _derived_from(spec: RobotSpec) -> dict[Hashable, Any]:
    """Return what was derived from a robot's description in this thread, to be added to."""
    robots: list[tuple[RobotSpec, dict[Hashable, Any]]] = _of_thread.__dict__.setdefault("robots", [])
    entry = next((robot for robot in robots if robot[0] == spec), (spec, {}))
    robots[:] = [entry, *(robot for robot in robots if robot is not entry)][:KEPT_ROBOTS]
    return entry[1]


def load_robot(reference: str | Path) -> RobotModel:
    """Load the model of a robot.

    Args:
        reference: Path of a robot file, or the name of a built-in robot.

    Raises:
        SpecError: The file does not describe a robot; the message has all its errors with their positions.
    """
    return RobotModel(load_robot_spec(reference))


def shape_of(value: ArrayLike) -> tuple[int, ...] | None:
    """Return the shape of an array of numbers, or of what could be one; None of anything else."""
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        return None
    return given.shape if given.dtype.kind in "fiu" else None


def _frame_jacobian(spec: RobotSpec, bodies: Sequence[SpatialFrame], body: int, frame: SpatialFrame) -> ca.SX:
    """Return the Jacobian of a frame in space: velocity of its origin and its angular velocity by v, (6, n).

    Both are along inertial axes. v is the velocity of the base (3,), its angular velocity in its own frame (3,), and
    the rates of all joints. The joints that move the frame are those between its body and the base.

    Args:
        spec: The robot.
        bodies: Frames of its bodies, the base first.
        body: Number of the body that carries the frame.
        frame: The frame.
    """
    J = ca.SX.zeros(6, sum(spec.parts.values()))
    base = bodies[0]
    for i in range(3):
        axis = rotate(base.quaternion, [float(i == j) for j in range(3)])
        J[i, i] = 1
        J[:, 3 + i] = ca.vertcat(*cross(axis, add(frame.position, scaled(base.position, -1))), *axis)
    while body:  # from the frame's body inward; body i hangs on joint i - 1, and 0 is the base
        joint = spec.joints[body - 1]
        axis = rotate(bodies[body].quaternion, joint.axis)
        arm = add(frame.position, scaled(bodies[body].position, -1))
        column = [*axis, 0.0, 0.0, 0.0] if joint.prismatic else [*cross(axis, arm), *axis]
        J[:, 5 + body] = ca.vertcat(*column)
        body = joint.at.body
    return J


def _consecutive_slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return consecutive slices of the given sizes."""
    rows = {}
    first = 0
    for name, size in sizes.items():
        rows[name] = slice(first, first + size)
        first += size
    return rows
