"""The model of a robot: numeric methods for Python users, CasADi functions for optimization and simulation."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.bodies import InertialParameters, place_planar
from psmpc_cli.robot.dynamics import Dynamics, derive_dynamics, function, solve_spd
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import load_robot as load_robot_spec
from psmpc_cli.specs.robot import RobotSpec

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and dynamics of one robot with generalized coordinates Q and velocities v = Qdot, both (n,).

    A planar robot has Q = [x, y, theta of the base, joint angles arm by arm] [m, rad]. Numeric methods take and return
    arrays; one model must not be called from several threads at once. Where a method takes `parameters`, they replace
    the inertial parameters of the robot's description.

    The CasADi functions take and return columns and accept SX, MX and numbers.

    Attributes:
        spec: The robot's description.
        n: Number of generalized coordinates.
        m: Number of pose coordinates xi.
        dimension: Number of position coordinates of a pose; its further rows are angles.
        parts: Rows of Q by part: `base`, then the arms in order.
        pose_rows: Rows of xi by frame: `base`, then the end-effectors of the arms.
        g: Q -> xi (m,) [m, rad]. Paper eq. (1).
        J_C: Q -> (m, n), d xi / d Q. Paper eq. (2).
        Jdot_Qdot: Q, Qdot -> Jdot_C Qdot (m,), the acceleration of xi at Qddot = 0.
        dynamics: The equations of motion.
        f_1: x, u -> xdot (2n,), x = [Q; Qdot], u = Qddot. Paper eq. (8).
        f_2: x, u -> xdot (2n,), x = [Q; Qdot], u = acceleration of xi (m,), by the damped inverse of J_C.
        outline: Q -> joint positions of all arms, shoulder to tip, arm by arm, (2, points) [m].
    """

    spec: RobotSpec
    n: int
    m: int
    dimension: int
    parts: dict[str, slice]
    pose_rows: dict[str, slice]
    g: ca.Function
    J_C: ca.Function
    Jdot_Qdot: ca.Function
    dynamics: Dynamics
    f_1: ca.Function
    f_2: ca.Function
    outline: ca.Function

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the generalized coordinates, (n,): `base.x`, ..., `arm_1.1`, ..."""
        return labels(self.spec, "joint")

    @cached_property
    def nominal(self) -> InertialParameters:
        """Inertial parameters of the robot's description, with empty grippers."""
        return InertialParameters.nominal(self.spec)

    def poses(self, Q: ArrayLike) -> Array:
        """Return the pose (x, y, angle) [m, m, rad] of the base and of each end-effector in order, (frames, 3)."""
        return self._evaluate("g", Q).reshape(len(self.pose_rows), -1)

    def mass_matrix(self, Q: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return H(Q), (n, n) [kg, kg m, kg m^2]. Paper eq. (3)."""
        return self._evaluate("H", Q, self._w(parameters))

    def bias(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return the Coriolis and centrifugal forces C(Q, v) v, (n,) [N, N m]. Below paper eq. (3)."""
        return self.inverse_dynamics(Q, v, 0.0, parameters)

    def inverse_dynamics(
        self, Q: ArrayLike, v: ArrayLike, vdot: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Return the generalized force F = H vdot + C v, (n,) [N, N m], of accelerations vdot (n,). Paper eq. (3)."""
        return self._evaluate("inverse", Q, v, vdot, self._w(parameters)).ravel()

    def forward_dynamics(
        self, Q: ArrayLike, v: ArrayLike, F: ArrayLike, parameters: InertialParameters | None = None
    ) -> Array:
        """Return the accelerations H^-1 (F - C v), (n,) [m/s^2, rad/s^2], under a generalized force F (n,)."""
        return self._evaluate("forward", Q, v, F, self._w(parameters)).ravel()

    def momentum(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> Array:
        """Return linear momentum (x, y) [N s] and angular momentum about the inertial origin [N m s], (3,)."""
        return self._evaluate("momentum", Q, v, self._w(parameters)).ravel()

    def kinetic_energy(self, Q: ArrayLike, v: ArrayLike, parameters: InertialParameters | None = None) -> float:
        """Return the kinetic energy [J]."""
        return float(self._evaluate("kinetic_energy", Q, v, self._w(parameters)).item())

    def _evaluate(self, name: str, *arguments: ArrayLike) -> Array:
        """Return the result of a CasADi function, its columns as rows."""
        return self._numeric[name](*arguments)[0]

    def _w(self, parameters: InertialParameters | None) -> Array:
        return self._nominal_vector if parameters is None else parameters.vector

    @cached_property
    def _nominal_vector(self) -> Array:
        return self.nominal.vector

    @cached_property
    def _numeric(self) -> dict[str, ArrayFunction]:
        """The CasADi functions on arrays, by name."""
        motion = self.dynamics
        functions = (self.g, motion.H, motion.inverse, motion.forward, motion.momentum, motion.kinetic_energy)
        return {each.name(): ArrayFunction(each) for each in functions}


def load_robot(reference: str | Path) -> RobotModel:
    """Load the model of a robot.

    Args:
        reference: Path of a robot file, or the name of a built-in robot.

    Raises:
        SpecError: The file does not describe a robot; the message has all its errors with their positions.
    """
    return build_model(load_robot_spec(reference))


def build_model(spec: RobotSpec, damping: float = 1e-2) -> RobotModel:
    """Build the model of a planar robot.

    Args:
        spec: The robot.
        damping: Of the inverse of J_C in f_2. Along a singular value sigma of J_C it reduces the commanded
            xi-acceleration by damping^2 / (sigma^2 + damping^2); one unit of xi-acceleration never gives more than
            1 / (2 damping) of Qddot.
    """
    n = sum(spec.parts.values())
    Q, Qdot, Qddot = (ca.SX.sym(name, n) for name in ("Q", "Qdot", "Qddot"))
    placed = place_planar(spec, Q)
    frames = {name: frame.pose() for name, frame in placed.frames.items()}
    xi, x = ca.vertcat(*frames.values()), ca.vertcat(Q, Qdot)
    u_xi = ca.SX.sym("u", xi.numel())
    points = (frame.position for arm in placed.points.values() for frame in arm)
    J_C = ca.jacobian(xi, Q)
    Jdot_Qdot = ca.jtimes(J_C @ Qdot, Q, Qdot)
    damped = _damped_acceleration(J_C, Jdot_Qdot, u_xi, damping)
    return RobotModel(
        spec=spec,
        n=n,
        m=xi.numel(),
        dimension=placed.frames["base"].position.numel(),
        parts=_rows(spec.parts),
        pose_rows=_rows({name: pose.numel() for name, pose in frames.items()}),
        g=function("g", {"Q": Q}, {"xi": xi}),
        J_C=function("J_C", {"Q": Q}, {"J_C": ca.densify(J_C)}),
        Jdot_Qdot=function("Jdot_Qdot", {"Q": Q, "Qdot": Qdot}, {"Jdot_Qdot": ca.densify(Jdot_Qdot)}),
        dynamics=derive_dynamics(placed, Q, InertialParameters.nominal(spec).vector.size),
        f_1=function("f_1", {"x": x, "u": Qddot}, {"xdot": ca.vertcat(Qdot, Qddot)}),
        f_2=function("f_2", {"x": x, "u": u_xi}, {"xdot": ca.vertcat(Qdot, damped)}),
        outline=function("outline", {"Q": Q}, {"points": ca.horzcat(*points)}),
    )


def arm_points(model: RobotModel, Q: ArrayLike) -> dict[str, Array]:
    """Compute the joint positions of each arm, from shoulder to tip, at Q (n,) [m, rad].

    Returns:
        By arm name, (links + 1, 2) [m] in the inertial frame.
    """
    points, first, arms = model.outline(np.asarray(Q, dtype=float)).full().T, 0, {}
    for name, arm in model.spec.arms.items():
        arms[name] = points[first : first + len(arm.links) + 1]
        first += len(arm.links) + 1
    return arms


@dataclass(frozen=True)
class AngleRows:
    """Rows of Q and of xi that are angles of the base or of an end-effector, whose equivalents differ by 2 pi."""

    Q: tuple[int, ...]
    xi: tuple[int, ...]


def angle_rows(model: RobotModel) -> AngleRows:
    """Return the rows of the unwrapped angles; joint angles are not among them, as their limits tell turns apart."""
    xi = (row for rows in model.pose_rows.values() for row in range(rows.start + model.dimension, rows.stop))
    return AngleRows(tuple(range(model.dimension, model.parts["base"].stop)), tuple(xi))


def nearest_equivalent(angle: ArrayLike, target: ArrayLike) -> Array:
    """Return the angle equivalent to `target` [rad] that is nearest to `angle` [rad]; both of the same shape."""
    target = np.asarray(target, dtype=float)
    return np.asarray(target + 2 * np.pi * np.round((np.asarray(angle, dtype=float) - target) / (2 * np.pi)))


def _damped_acceleration(J_C: ca.SX, Jdot_Qdot: ca.SX, u: ca.SX, damping: float) -> ca.SX:
    """Return Qddot (n,) that accelerates the poses with u (m,), by the damped inverse of J_C (m, n).

    Solves (J_C' J_C + damping^2 I) Qddot = J_C' (u - Jdot_C Qdot), which is defined at singular J_C too.
    """
    normal = J_C.T @ J_C + damping**2 * ca.SX.eye(J_C.shape[1])
    return solve_spd(normal, J_C.T @ (u - Jdot_Qdot))


def _rows(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return consecutive slices of the given sizes."""
    rows, first = {}, 0
    for name, size in sizes.items():
        rows[name] = slice(first, first + size)
        first += size
    return rows
