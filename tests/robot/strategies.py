"""Random robots, numbers for their coordinates, and derivatives by finite differences."""

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.robot import Arm, Base, Link, Mount, RobotSpec, Tool

Array = NDArray[np.float64]
State = tuple[RobotModel, Array, Array, Array]

laws = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""Models are built as robots are drawn, which is not a matter of drawing too much."""

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
def robots(draw: st.DrawFn, fewest: int = 1, most: int = 5) -> RobotSpec:
    """One to three arms of `fewest` to `most` links."""
    base = Base(mass=draw(st.floats(5, 100)), inertia=draw(st.floats(0.5, 10)))
    drawn = draw(st.lists(arms(fewest, most), min_size=1, max_size=3))
    return RobotSpec(name="drawn", base=base, arms={f"arm_{i}": arm for i, arm in enumerate(drawn, start=1)})


@st.composite
def moving_robots(draw: st.DrawFn, fewest: int = 1, most: int = 5) -> State:
    """A robot, Q, Qdot, and a third column (n,) to be used as Qddot, u or F."""
    model = build_model(draw(robots(fewest, most)))
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
