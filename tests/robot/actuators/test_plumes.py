"""Which plumes reach a body, against points drawn in the cones."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.robot.actuators.plumes import Plumes
from psmpc_cli.robot.kinematics import SpatialFrame
from psmpc_cli.robot.rotations import exp
from psmpc_cli.specs.geometry import Shape
from psmpc_cli.specs.robots.actuators import PlanarThruster, SpatialThruster

Array = np.ndarray
ORIGIN = SpatialFrame([np.zeros(1)] * 3, [np.ones(1), *[np.zeros(1)] * 3])


def at(position: Array, turn: Array) -> SpatialFrame:
    """A frame at one place, as the plumes take it."""
    return SpatialFrame([np.array([x]) for x in position], [np.array([x]) for x in exp(turn.tolist())])


def drawn_in_plume(rng: np.random.Generator, angle: float, length: float, count: int) -> Array:
    """Points (count, 3) in a plume along +x from the origin, some of them on its edge and on its end."""
    off = angle * np.sqrt(rng.uniform(size=count)) * 1.0
    off[: count // 3] = angle
    far = length * rng.uniform(size=count) ** (1 / 3)
    far[count // 4 : count // 2] = length
    about = rng.uniform(0, 2 * np.pi, count)
    return far[:, None] * np.column_stack([np.cos(off), np.sin(off) * np.cos(about), np.sin(off) * np.sin(about)])


def spatial(angle: float, length: float) -> Plumes:
    """The plume of a thruster at the origin that leaves along +x."""
    plume = {"angle": angle, "length": length}
    return Plumes.of([SpatialThruster(position=(0, 0, 0), direction=(-2, 0, 0), force=1, plume=plume)])


@given(seed=st.integers(0, 10**6))
@settings(max_examples=40)
def test_a_plume_reaches_a_capsule_that_some_of_its_points_are_in(seed: int) -> None:
    """The nearest of 40,000 points is some 2 cm off, so a radius within 5 cm of the distance is not judged."""
    rng = np.random.default_rng(seed)
    angle = float(rng.uniform(0.1, 1.4))
    points = drawn_in_plume(rng, angle, 1.0, 40_000)
    position, turn, length = rng.uniform(-1.5, 1.5, 3), rng.normal(size=3), float(rng.choice([0.0, 0.8]))
    frame = at(position, turn)
    along = np.array([1 - 2 * (turned := np.ravel(frame.quaternion))[2] ** 2 - 2 * turned[3] ** 2, 0.0, 0.0])
    along[1] = 2 * (turned[1] * turned[2] + turned[0] * turned[3])
    along[2] = 2 * (turned[1] * turned[3] - turned[0] * turned[2])
    share = np.clip((points - position) @ along, -length / 2, length / 2)
    distance = float(np.linalg.norm(points - position - share[:, None] * along, axis=1).min())
    plume = spatial(angle, 1.0)
    assert plume.reach(ORIGIN, Shape("capsule", (distance + 1e-5, length)), frame).item()
    if distance > 0.06:
        assert not plume.reach(ORIGIN, Shape("capsule", (distance - 0.05, length)), frame).item()


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10)
def test_a_plume_reaches_into_a_half_space_that_some_of_its_points_are_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = float(rng.uniform(0.1, 1.4))
    points = drawn_in_plume(rng, angle, 1.0, 40_000)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    depth = min(float((points @ normal).min()), 0.0)
    plume, wall = spatial(angle, 1.0), Shape("half_space", tuple(normal.tolist()))
    assert plume.reach(ORIGIN, wall, at((depth + 1e-6) * normal, np.zeros(3))).item()
    assert not plume.reach(ORIGIN, wall, at((depth - 0.02) * normal, np.zeros(3))).item()


def test_a_plume_is_on_the_base_and_against_the_force() -> None:
    """In the plane, the base at several places at once; a thruster that has none reaches nothing."""
    plume = {"angle": 0.3, "length": 1.0}
    plumes = Plumes.of(
        [
            PlanarThruster(position=(0.2, 0), direction=(-1, 0), force=1, plume=plume),
            PlanarThruster(position=(-0.2, 0), direction=(1, 0), force=1, plume=plume),
            PlanarThruster(position=(0.2, 0), direction=(-1, 0), force=1),
        ]
    )
    x = np.array([0.0, 0.6, 0.71, 0.0, 0.0])
    angle = np.array([0.0, 0.0, 0.0, np.pi, np.pi / 2])
    base = SpatialFrame([x, 0 * x, 0 * x], [np.cos(angle / 2), 0 * x, 0 * x, np.sin(angle / 2)])
    ball = SpatialFrame([0 * x + 2.0, 0 * x, 0 * x], [0 * x + 1, 0 * x, 0 * x, 0 * x])
    reached = plumes.reach(base, Shape("capsule", (0.1, 0.0)), ball)
    # the ball begins at 1.9 m: the plume ends at 1.2, 1.8 and 1.91 m; turned round, that of the other thruster does
    assert reached.tolist() == [[False] * 3, [False] * 3, [True, False, False], [False] * 3, [False] * 3]
    near = SpatialFrame([0 * x + 1.25, 0 * x, 0 * x], ball.quaternion)
    assert plumes.reach(base, Shape("capsule", (0.1, 0.0)), near)[3].tolist() == [False, True, False]
