import numpy as np
import pytest

from psmpc_cli.robot.inertial import Inertials, body_names, described, weigh
from psmpc_cli.robot.model import RobotModel

LINK = {"base": 0, "arm_1.3": 3, "arm_2.3": 6}


@pytest.fixture
def x() -> np.ndarray:
    random = np.random.default_rng(3)
    return np.r_[0.3, -0.2, 0.5, 0.4 * random.standard_normal(6), 0.1 * random.standard_normal(9)]


def kept(model: RobotModel, x: np.ndarray, weighed: Inertials) -> np.ndarray:
    """Momentum and energy (4,)."""
    return np.concatenate([np.asarray(part).ravel() for part in weigh(model.spec).kept(x, weighed.vector)])


def test_as_described_it_is_the_robot_model(model: RobotModel, x: np.ndarray) -> None:
    n, u, robot, w = model.n, np.linspace(-1, 1, 9), weigh(model.spec), described(model.spec).vector
    Q, Qdot = x[:n], x[n:]
    pairs = (
        (robot.inverse_dynamics(Q, Qdot, u, w), model.inverse_dynamics(Q, Qdot, u)),
        (robot.forward_dynamics(Q, Qdot, u, w), model.forward_dynamics(Q, Qdot, u)),
        (robot.H(Q, w), model.H(Q)),
        (robot.kept(x, w)[0], model.momentum(Q, Qdot)),
        (robot.kept(x, w)[1], model.kinetic_energy(Q, Qdot)),
    )
    for one, other in pairs:
        np.testing.assert_allclose(np.asarray(one), np.asarray(other), rtol=1e-14, atol=1e-14)


def test_bodies_are_named_from_the_base_outward(model: RobotModel) -> None:
    names = body_names(model.spec)
    assert len(names) == model.bodies
    assert {name: names.index(name) for name in LINK} == LINK


def test_what_a_gripper_holds_adds_a_point_mass_and_a_spin_at_its_frame(model: RobotModel, x: np.ndarray) -> None:
    """Momentum and energy are those of the robot and of a body that moves with the gripper."""
    n, free = model.n, described(model.spec)
    mass, inertia = np.array([2.0, 0.0]), np.array([0.3, 0.0])
    rows = model.poses["arm_1"]
    place, velocity = np.asarray(model.g(x[:n])).ravel()[rows], (np.asarray(model.J_C(x[:n])) @ x[n:])[rows]
    p = 2.0 * velocity[:2]
    spin = 0.3 * velocity[2] + place[0] * p[1] - place[1] * p[0]
    energy = (2.0 * velocity[:2] @ velocity[:2] + 0.3 * velocity[2] ** 2) / 2
    gained = kept(model, x, free.holding(mass, inertia)) - kept(model, x, free)
    np.testing.assert_allclose(gained, [*p, spin, energy], atol=1e-12)


def test_an_offset_along_the_link_is_another_place_of_its_centre(model: RobotModel, x: np.ndarray) -> None:
    """A link whose centre of mass is where another description has it, is that other robot."""
    d, arm = 0.03, model.spec.arms["arm_1"]
    first = arm.links[0].model_copy(update={"a": arm.links[0].a + d, "b": arm.links[0].b - d})
    moved = arm.model_copy(update={"links": (first, *arm.links[1:])})
    spec = model.spec.model_copy(update={"arms": {**model.spec.arms, "arm_1": moved}})
    free = described(model.spec)
    offset = np.zeros((7, 2))
    offset[1, 0] = d
    shifted = Inertials(free.mass, free.inertia, offset, free.held_mass, free.held_inertia)
    other = weigh(spec).kept(x, described(spec).vector)
    np.testing.assert_allclose(
        kept(model, x, shifted), np.concatenate([np.asarray(part).ravel() for part in other]), atol=1e-13
    )
