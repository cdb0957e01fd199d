"""Rigid-body functions of random trees as tapes evaluate them, against CasADi's interpreter and Pinocchio.

python -m tests.robot.random_trees [TREES [FIRST]]  the largest differences over so many trees, by default 300, from a
                                                     seed on; ten minutes
"""

import math
import sys

import casadi as ca
import numpy as np
import pinocchio as pin

from psmpc_cli.native.functions import Tape, tape_library, tape_of
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import (
    Arm,
    Base,
    Body,
    Link,
    Mount,
    PlanarRobot,
    SpatialArm,
    SpatialBase,
    SpatialJoint,
    SpatialLink,
    SpatialRobot,
    SpatialTool,
    Tool,
)

from .strategies import Array, inertia_of, unit

QUANTITIES = ("H", "F", "F by Q", "F by v", "F by vdot")

STATES = 3
"""At which each tree is evaluated."""


def random_robot(rng: np.random.Generator, planar: bool, joints: int) -> PlanarRobot | SpatialRobot:
    """One to three arms with so many joints together; in space also on other arms, and with sliding joints."""
    count = int(rng.integers(1, min(joints, 3) + 1))
    cuts = np.sort(rng.choice(np.arange(1, joints), count - 1, replace=False))
    lengths = np.diff([0, *cuts, joints]).tolist()
    names = [f"arm_{i}" for i in range(count)]
    armature = {name: tuple(rng.uniform(0, 2, k)) for name, k in zip(names, lengths, strict=True) if rng.random() < 0.5}
    if planar:
        planar_arms = {name: _planar_arm(rng, k) for name, k in zip(names, lengths, strict=True)}
        base = Base(mass=rng.uniform(5, 100), inertia=rng.uniform(0.5, 10))
        return PlanarRobot(name="drawn", base=base, arms=planar_arms, armature=armature)
    arms = dict[str, SpatialArm]()
    carriers = ["base"]
    for name, k in zip(names, lengths, strict=True):
        tool = SpatialTool(position=_vector(rng, 0.3), rpy=_vector(rng, 3.0))
        links = tuple(_spatial_link(rng) for _ in range(k))
        arms[name] = SpatialArm(mount=str(rng.choice(carriers)), links=links, tool=tool)
        carriers += [f"{name}.{number}" for number in range(1, k + 1)]
    spatial_base = SpatialBase(
        mass=rng.uniform(5, 100), inertia=_moments(rng), centre_of_mass=tuple(rng.uniform(-0.2, 0.2, 3))
    )
    return SpatialRobot(name="drawn", base=spatial_base, arms=arms, armature=armature)


def _planar_arm(rng: np.random.Generator, joints: int) -> Arm:
    mount = Mount(position=tuple(rng.uniform(-1, 1, 2)), angle=rng.uniform(-math.pi, math.pi))
    links = [
        Link(
            mass=rng.uniform(0.5, 20), inertia=rng.uniform(0.02, 2), a=rng.uniform(0.05, 0.5), b=rng.uniform(0.05, 0.5)
        )
        for _ in range(joints)
    ]
    return Arm(mount=mount, links=tuple(links), tool=Tool(angle=rng.uniform(-math.pi, math.pi)))


def _spatial_link(rng: np.random.Generator) -> SpatialLink:
    joint = SpatialJoint(
        kind=str(rng.choice(["revolute", "prismatic"], p=[0.75, 0.25])),
        axis=unit(_vector(rng, 1.0)),
        position=_vector(rng, 0.5),
        rpy=_vector(rng, 3.0),
    )
    return SpatialLink(joint=joint, mass=rng.uniform(0.5, 20), centre_of_mass=_vector(rng, 0.3), inertia=_moments(rng))


def _vector(rng: np.random.Generator, size: float) -> tuple[float, float, float]:
    x, y, z = rng.uniform(-size, size, 3).tolist()
    return x, y, z


def _moments(rng: np.random.Generator) -> tuple[float, ...]:
    return inertia_of(rng.uniform(0.1, 0.5, 3), rng.uniform(-3, 3, 3))


def differences(seed: int) -> dict[str, tuple[float, float]]:
    """Return by quantity how far the tape of a random tree is from CasADi, and from Pinocchio, over the largest entry.

    Trees of even seeds are planar. They have 1 to 40 joints and up to three loads in their grippers.
    """
    rng = np.random.default_rng(seed)
    spec = random_robot(rng, planar=seed % 2 == 0, joints=int(rng.integers(1, 41)))
    model = RobotModel(spec)
    space = model.space
    held = rng.random(len(spec.arms)) < 0.5
    loads = rng.uniform(0.5, 20, (2, len(spec.arms))) * held
    parameters = model.nominal.holding(loads[0], loads[1])
    joints = rng.uniform(-3, 3, (STATES, space.joints))
    v, vdot = rng.uniform(-3, 3, (2, STATES, model.n))
    tape, oracle = _functions(model)
    found = tape([joints, v, vdot, parameters.vector], STATES)
    largest = dict.fromkeys(QUANTITIES, (0.0, 0.0))
    for k in range(STATES):
        by_casadi = [np.asarray(each) for each in oracle(joints[k], v[k], vdot[k], parameters.vector)]
        by_pinocchio = _in_pinocchio(model, parameters, joints[k], v[k], vdot[k])
        for quantity, own, *others in zip(QUANTITIES, found, by_casadi, by_pinocchio, strict=True):
            values = own[k].reshape(others[0].shape, order="F")
            errors = [float(np.abs(values - other).max() / np.abs(other).max()) for other in others]
            largest[quantity] = max(largest[quantity][0], errors[0]), max(largest[quantity][1], errors[1])
    return largest


def _functions(model: RobotModel) -> tuple[Tape, ca.Function]:
    """Return joints, v, vdot, w -> the quantities, column by column as a tape, and CasADi's own as matrices.

    The tape has the derivatives that rows of forces are made of; the other CasADi derives from the force, by the other
    mode.
    """
    space = model.space
    joints = ca.SX.sym("joints", space.joints)
    v, vdot = (ca.SX.sym(name, model.n) for name in ("v", "vdot"))
    w = ca.SX.sym("w", model.nominal.vector.size)
    arguments = [joints, v, vdot, w]
    Q = space.at_neutral_base(joints)
    F = model.dynamics.inverse(Q, v, vdot, w)
    first_columns = np.cumsum([0, space.joints, model.n, model.n]).tolist()
    by_motion = ca.horzsplit(model.law_jacobian()(*arguments), first_columns)
    own = [model.dynamics.H(Q, w), F, *by_motion]
    forward = {"helper_options": {"ad_weight": 0.0, "ad_weight_sp": 0.0}}
    jacobians = [ca.densify(ca.jacobian(F, each, forward)) for each in (joints, v, vdot)]
    tape_library().compile()
    tape = tape_of(ca.Function("own", arguments, [ca.vec(ca.densify(each)) for each in own]))
    assert tape is not None
    return tape, ca.Function("oracle", arguments, [jacobians[-1], F, *jacobians])


def _in_pinocchio(
    model: RobotModel, parameters: InertialParameters, joints: Array, v: Array, vdot: Array
) -> tuple[Array, ...]:
    """Return the quantities by Pinocchio's analytical derivatives.

    Its base has velocity and acceleration in the base's frame: with the frame at neutral, twist v and a - omega x v.
    """
    spec = model.spec
    size = model.space.n_twist
    engine = pin.Model()
    engine.gravity.setZero()
    is_planar = model.dimension == 2
    base_joint = pin.JointModelPlanar() if is_planar else pin.JointModelFreeFlyer()
    numbers = {0: engine.addJoint(0, base_joint, pin.SE3.Identity(), "base")}
    order = list[int]()

    def add_carried_by(carrier: int) -> None:
        """Add joints from the base outward, each followed by all that it carries, as the engine needs them."""
        for number, joint in enumerate(spec.joints, start=1):
            if joint.at.body == carrier:
                kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
                at = pin.SE3(pin.exp3(np.array(joint.at.rotation)), np.array(joint.at.position))
                numbers[number] = engine.addJoint(numbers[carrier], kind(np.array(joint.axis)), at, f"joint {number}")
                order.append(number - 1)
                add_carried_by(number)

    add_carried_by(0)
    for number, body in enumerate(spec.bodies):
        engine.appendBodyToJoint(numbers[number], _inertia(body), pin.SE3.Identity())
    for arm, tool in enumerate(spec.tools.values()):
        about = parameters.held_inertia[arm] * np.eye(3)
        load = pin.Inertia(parameters.held_mass[arm], np.array(tool.position), about)
        engine.appendBodyToJoint(numbers[tool.body], load, pin.SE3.Identity())
    engine.armature = np.r_[np.zeros(size), [spec.joints[number].armature for number in order]]
    permuted = np.r_[np.arange(size), size + np.array(order)]
    q = np.r_[[0, 0, 1, 0] if is_planar else [0, 0, 0, 0, 0, 0, 1], joints[order]]
    by_v = np.zeros((model.n, model.n))  # of the engine's accelerations
    if is_planar:
        by_v[0, 1], by_v[0, 2], by_v[1, 0], by_v[1, 2] = v[2], v[1], -v[2], -v[0]
        shift = np.array([v[2] * v[1], -v[2] * v[0], 0])
    else:
        by_v[:3, :3], by_v[:3, 3:6] = -pin.skew(v[3:6]), pin.skew(v[:3])
        shift = np.r_[-np.cross(v[3:6], v[:3]), 0, 0, 0]
    changes = vdot.copy()
    changes[:size] += shift
    data = engine.createData()
    F_q, F_v, F_a = pin.computeRNEADerivatives(engine, data, q, v[permuted], changes[permuted])
    F = pin.rnea(engine, data, q, v[permuted], changes[permuted])
    back = np.argsort(permuted)
    F_q, F_v, F_a = (np.asarray(each)[np.ix_(back, back)] for each in (F_q, F_v, F_a))
    return F_a, F[back][:, None], F_q[:, size:], F_v + F_a @ by_v, F_a


def _inertia(body: Body) -> pin.Inertia:
    xx, yy, zz, xy, xz, yz = body.inertia
    return pin.Inertia(body.mass, np.array(body.centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def main(trees: str = "300", first: str = "0") -> None:
    """Print the largest differences over random trees."""
    largest = {quantity: np.zeros(2) for quantity in QUANTITIES}
    for seed in range(int(first), int(first) + int(trees)):
        for quantity, found in differences(seed).items():
            largest[quantity] = np.maximum(largest[quantity], found)
    for quantity, (casadi, pinocchio) in largest.items():
        sys.stdout.write(f"{quantity}: {casadi:.1e} from CasADi, {pinocchio:.1e} from Pinocchio\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
