"""A robot as CasADi functions: everything a controller, a plant or a figure asks about it."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from psmpc_cli.errors import InputError
from psmpc_cli.robot.bodies import Placement, place_planar
from psmpc_cli.robot.dynamics import derive
from psmpc_cli.robot.task_space import damped_acceleration, task_dynamics
from psmpc_cli.specs.robot import RobotSpec

Array = NDArray[np.float64]

LARGEST_CONDITION = 1e8
"""Condition number of J_C from which on it counts as singular: half of double precision is lost in H_x."""


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and dynamics of one robot. Functions take and give columns and accept SX, MX and numbers.

    Attributes:
        spec: What it was built from.
        n: Number of generalized coordinates Q = [p_b; q].
        m: Number of pose coordinates xi.
        dimension: Number of position coordinates of a pose; its further rows are angles.
        bodies: Number of rigid bodies.
        parts: Rows of Q by part: base, then the arms in order.
        poses: Rows of xi by frame: base, then the arms' end-effectors.
        g: Q -> xi (m,) [m, rad]. Paper eq. (1).
        J_C: Q -> (m, n), d xi / d Q. Paper eq. (2).
        J_B: Q -> (m, base coordinates), the columns of J_C for the base. Paper eq. (2).
        J_M: Q -> (m, joints), the columns of J_C for the joints. Paper eq. (2).
        Jdot_Qdot: Q, Qdot -> Jdot_C Qdot (m,), the acceleration of xi at Qddot = 0.
        H: Q -> (n, n) [kg, kg m, kg m^2]. Paper eq. (3).
        C_Qdot: Q, Qdot -> C Qdot (n,) [N, N m]. Below paper eq. (3).
        inverse_dynamics: Q, Qdot, Qddot -> F (n,) [N, N m]. Paper eq. (3).
        low_level: Q, Qdot, u -> F (n,) [N, N m], the computed-torque law. Paper eq. (7).
        forward_dynamics: Q, Qdot, F -> Qddot (n,) [m/s^2, rad/s^2]. Paper eq. (3).
        kinetic_energy: Q, Qdot -> T, scalar [J].
        momentum: Q, Qdot -> linear (x, y) [N s] and angular about the inertial origin [N m s], (3,).
        f_1: x, u -> xdot (2n,), x = [Q; Qdot], u = Qddot. Paper eq. (8).
        f_2: x, u -> xdot (2n,), x = [Q; Qdot], u = acceleration of xi (m,), by the damped inverse of J_C.
        outline: Q -> joint positions of all arms, shoulder to tip, arm by arm, (2, points) [m].
        task_terms: H_x and C_x; empty where J_C is not square.
    """

    spec: RobotSpec
    n: int
    m: int
    dimension: int
    bodies: int
    parts: dict[str, slice]
    poses: dict[str, slice]
    g: ca.Function
    J_C: ca.Function
    J_B: ca.Function
    J_M: ca.Function
    Jdot_Qdot: ca.Function
    H: ca.Function
    C_Qdot: ca.Function
    inverse_dynamics: ca.Function
    low_level: ca.Function
    forward_dynamics: ca.Function
    kinetic_energy: ca.Function
    momentum: ca.Function
    f_1: ca.Function
    f_2: ca.Function
    outline: ca.Function
    task_terms: Mapping[str, ca.Function]

    def check_square(self) -> None:
        """Make sure that J_C is square, as eq. (6) needs it.

        Raises:
            InputError: It is not.
        """
        if self.m != self.n:
            base = self.parts["base"].stop
            others = [f"{name} has {len(arm.links)}" for name, arm in self.spec.arms.items() if len(arm.links) != base]
            raise InputError(
                f"J_C of robot '{self.spec.name}' is {self.m} x {self.n}, but H_x and C_x need it square: "
                f"expected {base} joints an arm; {', '.join(others)}"
            )

    def _task_term(self, name: str) -> ca.Function:
        """H_x or C_x; raises InputError if J_C is not square."""
        self.check_square()
        return self.task_terms[name]

    H_x = property(lambda self: self._task_term("H_x"), doc="Q -> (m, m), task-space inertia. Paper eqs. (5), (6).")
    C_x = property(lambda self: self._task_term("C_x"), doc="Q, Qdot -> (m,), task-space C Qdot. Paper eqs. (5), (6).")


def build_model(spec: RobotSpec, damping: float = 1e-2) -> RobotModel:
    """Build the functions of a planar robot.

    Args:
        spec: The robot.
        damping: Of the inverse of J_C in f_2. Along a singular value sigma of J_C it takes damping^2 / (sigma^2 +
            damping^2) off the xi-acceleration asked for, and a unit of that never makes more than 1 / (2 damping) of
            Qddot.
    """
    n = sum(spec.parts.values())
    Q, Qdot, Qddot, F = (ca.SX.sym(name, n) for name in ("Q", "Qdot", "Qddot", "F"))
    placed = place_planar(spec, Q)
    parts = _rows(spec.parts)
    frames = {name: frame.pose() for name, frame in placed.frames.items()}
    xi = ca.vertcat(*frames.values())
    u_xi, base = ca.SX.sym("u", xi.numel()), parts["base"].stop
    J_C = ca.jacobian(xi, Q)
    Jdot_Qdot = ca.jtimes(J_C @ Qdot, Q, Qdot)
    motion = derive(placed.bodies, Q, Qdot, Qddot, F)
    task = task_dynamics(motion.H, motion.C_Qdot, J_C, Jdot_Qdot) if xi.numel() == n else ()
    x = ca.vertcat(Q, Qdot)
    return RobotModel(
        spec=spec,
        n=n,
        m=xi.numel(),
        dimension=placed.frames["base"].position.numel(),
        bodies=len(placed.bodies),
        parts=parts,
        poses=_rows({name: pose.numel() for name, pose in frames.items()}),
        g=_function("g", {"Q": Q}, {"xi": xi}),
        J_C=_function("J_C", {"Q": Q}, {"J_C": ca.densify(J_C)}),
        J_B=_function("J_B", {"Q": Q}, {"J_B": ca.densify(J_C[:, :base])}),
        J_M=_function("J_M", {"Q": Q}, {"J_M": ca.densify(J_C[:, base:])}),
        Jdot_Qdot=_function("Jdot_Qdot", {"Q": Q, "Qdot": Qdot}, {"Jdot_Qdot": ca.densify(Jdot_Qdot)}),
        H=_function("H", {"Q": Q}, {"H": motion.H}),
        C_Qdot=_function("C_Qdot", {"Q": Q, "Qdot": Qdot}, {"C_Qdot": ca.densify(motion.C_Qdot)}),
        inverse_dynamics=_function("inverse_dynamics", {"Q": Q, "Qdot": Qdot, "Qddot": Qddot}, {"F": motion.inverse}),
        low_level=_function("low_level", {"Q": Q, "Qdot": Qdot, "u": Qddot}, {"F": motion.inverse}),
        forward_dynamics=_function("forward_dynamics", {"Q": Q, "Qdot": Qdot, "F": F}, {"Qddot": motion.forward}),
        kinetic_energy=_function("kinetic_energy", {"Q": Q, "Qdot": Qdot}, {"T": motion.kinetic_energy}),
        momentum=_function("momentum", {"Q": Q, "Qdot": Qdot}, {"p": motion.momentum}),
        f_1=_function("f_1", {"x": x, "u": Qddot}, {"xdot": ca.vertcat(Qdot, Qddot)}),
        f_2=_function(
            "f_2",
            {"x": x, "u": u_xi},
            {"xdot": ca.vertcat(Qdot, damped_acceleration(J_C, Jdot_Qdot, u_xi, damping))},
        ),
        outline=_function("outline", {"Q": Q}, {"points": _points(placed)}),
        task_terms=_task_terms(Q, Qdot, task),
    )


def arm_points(model: RobotModel, Q: ArrayLike) -> dict[str, Array]:
    """Each arm's polyline of joint positions, from the shoulder to the tip, at Q (n,) [m, rad].

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
    """Rows of the unwrapped angles. Joint angles are not among them: their limits tell equivalents apart."""
    xi = (row for rows in model.poses.values() for row in range(rows.start + model.dimension, rows.stop))
    return AngleRows(tuple(range(model.dimension, model.parts["base"].stop)), tuple(xi))


def nearest_equivalent(angle: ArrayLike, target: ArrayLike) -> Array:
    """Of all angles equivalent to `target` [rad], the one nearest to `angle` [rad]; both of the same shape."""
    target = np.asarray(target, dtype=float)
    return np.asarray(target + 2 * np.pi * np.round((np.asarray(angle, dtype=float) - target) / (2 * np.pi)))


def task_inertia(model: RobotModel, Q: ArrayLike) -> Array:
    """H_x at Q (n,) [m, rad], (m, m) [kg, kg m, kg m^2]. Paper eq. (6).

    Raises:
        InputError: J_C is not square, or singular at Q.
    """
    _check_invertible(model, Q)
    return np.asarray(model.H_x(np.asarray(Q, dtype=float)).full())


def task_coriolis(model: RobotModel, Q: ArrayLike, Qdot: ArrayLike) -> Array:
    """C_x at Q (n,) [m, rad] and Qdot (n,) [m/s, rad/s], (m,) [N, N m]. Paper eq. (6).

    Raises:
        InputError: J_C is not square, or singular at Q.
    """
    _check_invertible(model, Q)
    return np.asarray(model.C_x(np.asarray(Q, dtype=float), np.asarray(Qdot, dtype=float)).full()).ravel()


def _check_invertible(model: RobotModel, Q: ArrayLike) -> None:
    """Make sure that J_C has an inverse at Q (n,); InputError if not."""
    model.check_square()
    Q = np.asarray(Q, dtype=float)
    J_C = model.J_C(Q).full()
    condition = np.linalg.cond(J_C)
    if _is_singular(J_C):
        arms = [arm for arm in model.spec.arms if _is_singular(J_C[model.poses[arm], model.parts[arm]])]
        raise InputError(
            f"J_C of robot '{model.spec.name}' is singular at Q = {Q.tolist()}, because of "
            f"{', '.join(arms) or 'its scaling'}: its condition number is {condition:.2g}; "
            f"H_x and C_x need it below {LARGEST_CONDITION:.0e}"
        )


def _is_singular(J: Array) -> bool:
    """Whether J (rows, columns) has too few columns for independent rows, or is too ill-conditioned for that."""
    return J.shape[1] < J.shape[0] or not np.linalg.cond(J) < LARGEST_CONDITION


def _rows(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Consecutive slices of the given sizes."""
    rows, first = {}, 0
    for name, size in sizes.items():
        rows[name] = slice(first, first + size)
        first += size
    return rows


def _points(placed: Placement) -> ca.SX:
    """Positions of all arms' points side by side, (2, points)."""
    return ca.horzcat(*(frame.position for arm in placed.points.values() for frame in arm))


def _task_terms(Q: ca.SX, Qdot: ca.SX, terms: tuple[ca.SX, ...]) -> dict[str, ca.Function]:
    """H_x and C_x as functions; none without `terms`."""
    inputs = ({"Q": Q}, {"Q": Q, "Qdot": Qdot})
    names = ("H_x", "C_x")
    return {name: _function(name, given, {name: term}) for name, given, term in zip(names, inputs, terms, strict=False)}


def _function(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]) -> ca.Function:
    """A function with named inputs and outputs, common subexpressions computed once."""
    expressions = ca.cse(list(outputs.values()))
    return ca.Function(name, list(inputs.values()), expressions, list(inputs), list(outputs))
