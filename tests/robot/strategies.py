"""Random robots, numbers for their coordinates, and derivatives by finite differences."""

import math
from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import (
    Arm,
    Base,
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

Array = NDArray[np.float64]
State = tuple[RobotModel, Array, Array, Array]

laws = settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
)
"""Models are built as robots are drawn, which is slow and not to be shrunk."""

angles = st.floats(-math.pi, math.pi)


@st.composite
def arms(draw: st.DrawFn, fewest: int = 1, most: int = 5) -> Arm:
    mount = Mount(position=(draw(st.floats(-1, 1)), draw(st.floats(-1, 1))), angle=draw(angles))
    link = st.builds(
        Link, mass=st.floats(0.5, 20), inertia=st.floats(0.02, 2), a=st.floats(0.05, 0.5), b=st.floats(0.05, 0.5)
    )
    links = draw(st.lists(link, min_size=fewest, max_size=most))
    return Arm(mount=mount, links=tuple(links), tool=Tool(angle=math.radians(draw(st.integers(-180, 180)))))


@st.composite
def robots(draw: st.DrawFn, fewest: int = 1, most: int = 5) -> PlanarRobot:
    """One to three arms of `fewest` to `most` links."""
    base = Base(mass=draw(st.floats(5, 100)), inertia=draw(st.floats(0.5, 10)))
    drawn = draw(st.lists(arms(fewest, most), min_size=1, max_size=3))
    named = {f"arm_{i}": arm for i, arm in enumerate(drawn, start=1)}
    return PlanarRobot(name="drawn", base=base, arms=named, armature=draw(armatures(named)))


@st.composite
def armatures(draw: st.DrawFn, arms: Mapping[str, Arm | SpatialArm]) -> dict[str, tuple[float, ...]]:
    """Rotor inertias of some of the arms."""
    rotor = st.floats(0, 2)
    return {
        name: tuple(draw(rotor) for _ in range(len(arm.links))) for name, arm in arms.items() if draw(st.booleans())
    }


def vectors(size: float) -> st.SearchStrategy[tuple[float, float, float]]:
    """Three numbers up to a size, to four digits: MuJoCo takes frames that are turned by less than 1e-6 as parallel."""
    return st.tuples(*[st.floats(-size, size).map(lambda number: round(number, 4))] * 3)


inertias = st.builds(
    lambda radii, turn: inertia_of(np.array(radii), np.array(turn)),
    st.tuples(*[st.floats(0.1, 0.5)] * 3),
    vectors(3.0),
)
"""Moments of a box turned at random."""


def inertia_of(sides: Array, turn: Array) -> tuple[float, ...]:
    """xx, yy, zz, xy, xz, yz of a box of 10 kg with these sides [m], turned by a rotation vector."""
    moments = (
        10
        / 12
        * np.array([sides[1] ** 2 + sides[2] ** 2, sides[0] ** 2 + sides[2] ** 2, sides[0] ** 2 + sides[1] ** 2])
    )
    R = Rotation.from_rotvec(turn).as_matrix()
    full = R @ np.diag(moments) @ R.T
    return tuple(float(full[i]) for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def unit(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    """A unit vector."""
    x, y, z = np.array(direction) / np.linalg.norm(direction) if np.linalg.norm(direction) > 1e-3 else (0.0, 0.0, 1.0)
    return float(x), float(y), float(z)


spatial_links = st.builds(
    SpatialLink,
    joint=st.builds(
        SpatialJoint,
        kind=st.sampled_from(("revolute", "prismatic")),
        axis=vectors(1.0).map(unit),
        position=vectors(0.5),
        rpy=vectors(3.0),
    ),
    mass=st.floats(0.5, 20),
    centre_of_mass=vectors(0.3),
    inertia=inertias,
)


@st.composite
def spatial_robots(draw: st.DrawFn) -> SpatialRobot:
    """None to three arms of one to three joints, each on the base or on a link of an arm before it."""
    base = SpatialBase(mass=draw(st.floats(5, 100)), inertia=draw(inertias), centre_of_mass=draw(vectors(0.2)))
    arms: dict[str, SpatialArm] = {}
    carriers = ["base"]
    for i in range(draw(st.integers(0, 3))):
        links = draw(st.lists(spatial_links, min_size=1, max_size=3))
        tool = SpatialTool(position=draw(vectors(0.3)), rpy=draw(vectors(3.0)))
        arms[f"arm_{i}"] = SpatialArm(mount=draw(st.sampled_from(carriers)), links=tuple(links), tool=tool)
        carriers += [f"arm_{i}.{number}" for number in range(1, len(links) + 1)]
    return SpatialRobot(name="drawn", base=base, arms=arms, armature=draw(armatures(arms)))


@st.composite
def moving_spatial_robots(draw: st.DrawFn) -> State:
    """A robot, Q (nq,), v and a third column (n,)."""
    model = RobotModel(draw(spatial_robots()))
    numbers = st.lists(st.floats(-3, 3), min_size=model.nq, max_size=model.nq).map(np.array)
    Q, v, third = draw(numbers), draw(numbers)[1:], draw(numbers)[1:]
    length = np.linalg.norm(Q[3:7])
    Q[3:7] = Q[3:7] / length if length > 0.1 else (1, 0, 0, 0)
    return model, Q, v, third


@st.composite
def moving_robots(draw: st.DrawFn, fewest: int = 1, most: int = 5) -> State:
    """A robot, Q, Qdot, and a third column (n,) to be used as Qddot, u or F."""
    model = RobotModel(draw(robots(fewest, most)))
    column = st.lists(st.floats(-3, 3), min_size=model.n, max_size=model.n).map(np.array)
    return model, draw(column), draw(column), draw(column)


def flat(value: ca.DM) -> Array:
    """A CasADi column as an array."""
    return np.asarray(value.full()).ravel()


def jacobian_by_differences(function: Callable[[Array], Array], x: Array) -> Array:
    """Jacobian (m, n) of `function` (n,) -> (m,) at x by central differences of fourth order."""
    step = 1e-3
    columns = []
    for unit in np.eye(x.size):
        near, far = ((function(x + k * step * unit) - function(x - k * step * unit)) / (2 * k * step) for k in (1, 2))
        columns.append((4 * near - far) / 3)
    return np.column_stack(columns)


def assert_close_to_differences(actual: Array, differences: Array) -> None:
    """Equal up to what differences of fourth order can tell, relative to the largest entry."""
    np.testing.assert_allclose(actual, differences, rtol=0, atol=1e-8 * (1 + np.abs(differences).max()))
