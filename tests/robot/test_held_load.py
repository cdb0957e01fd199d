"""The force of a robot that knows its load, against the equations of the closed chain, derivatives by differences."""

import numpy as np
import pytest

from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.motion import over_ticks
from psmpc_cli.specs.load import load_robot, load_task

MASS, INERTIA = 7.0, 0.4
STEP = 1e-4


@pytest.mark.parametrize("arms", [("arm_1",), ("arm_1", "arm_2")])
def test_the_force_moves_the_object_by_the_nearest_acceleration_that_all_grippers_share(arms: tuple[str, ...]) -> None:
    """F = H u' + c + sum S_i' f_i: the f_i add up to what the object needs, shared as the stiffnesses are."""
    model = RobotModel(load_robot("planar_dual_arm"))
    capture = load_task("transport_grasp").spec.body
    rng = np.random.default_rng(5)
    Q, v, u = rng.normal(scale=0.5, size=(3, model.n))
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    center = model.space.composed(poses["arm_1"], [0.3, 0.2, 0.4])
    at = {arm: tuple(model.space.relative(poses[arm], center).tolist()) for arm in arms}
    grasp = capture.grasp.model_copy(update={"at": at})
    grasps = np.array([[*at[arm], *stiffness] for arm, stiffness in zip(arms, ([1e4, 1e3], [2e4, 5e3]), strict=False)])

    def centers(Q: np.ndarray) -> np.ndarray:
        """Where each gripper has the object, (A, 3)."""
        poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
        insides = [model.space.relative(np.zeros(3), at[arm]) for arm in arms]
        return np.array([model.space.composed(poses[arm], inside) for arm, inside in zip(arms, insides, strict=True)])

    def maps(Q: np.ndarray) -> np.ndarray:
        """S_i, (A, 3, n)."""
        steps = STEP * np.eye(model.n)
        return np.stack([(centers(Q + step) - centers(Q - step)) / (2 * STEP) for step in steps], axis=-1)

    S = maps(Q)
    s = (maps(Q + STEP * v) - maps(Q - STEP * v)) / (2 * STEP) @ v
    G = (S[1:] - S[0]).reshape(-1, model.n)
    nearest = u - np.linalg.pinv(G) @ (G @ u + (s[1:] - s[0]).ravel())
    accelerations = S @ nearest + s
    np.testing.assert_allclose(accelerations, accelerations[:1].repeat(len(arms), axis=0), atol=1e-6)
    needed = np.array([MASS, MASS, INERTIA]) * accelerations[0]
    bushings = []
    for arm, (*_, k, kappa) in zip(arms, grasps, strict=True):
        x, y = poses[arm][:2] - center[:2]
        bushings.append(np.array([[k, 0, -k * y], [0, k, k * x], [-k * y, k * x, kappa + k * (x**2 + y**2)]]))
    shared = np.linalg.solve(np.sum(bushings, axis=0), needed)
    of_load = sum(S_i.T @ C @ shared for S_i, C in zip(S, bushings, strict=True))
    body = FreeBody(MASS, [INERTIA])
    found = HeldLoad(model, body, grasp).force(Q, v, u, model.nominal, grasps, body.vector)
    expected = model.inverse_dynamics(Q, v, nearest) + of_load
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    assert np.abs(of_load).max() > 0.1


@pytest.mark.parametrize("robot", ["planar_dual_arm", "dual_arm_servicer"])
def test_what_a_robot_follows_keeps_the_relative_pose_of_closed_grippers(robot: str) -> None:
    model = RobotModel(load_robot(robot))
    space = model.space
    rng = np.random.default_rng(2)
    grippers = list(model.spec.arms)[:2]
    Q = np.array(space.integrate(model.neutral, rng.normal(scale=0.5, size=model.n)))
    u = np.repeat(rng.normal(scale=0.3, size=(1, model.n)), 10, axis=0)
    closed = np.ones(len(u), bool)

    def relative(Q: np.ndarray) -> np.ndarray:
        poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
        return np.array(space.relative(poses[grippers[1]], poses[grippers[0]]))

    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    at = {gripper: tuple(space.relative(poses[gripper], poses[grippers[0]]).tolist()) for gripper in grippers}
    capture = load_task("transport_grasp").spec.body
    moments = [INERTIA] * space.n_principal
    load = HeldLoad(model, FreeBody(MASS, moments), capture.grasp.model_copy(update={"at": at}))

    def drift(u: np.ndarray) -> float:
        path, _ = over_ticks(space, Q, np.zeros(model.n), u, 0.01)
        return float(np.abs(space.pose_error(relative(path[-1]), relative(Q))).max())

    assert drift(u) > 1e-3
    assert drift(load.attainable_accelerations(Q, np.zeros(model.n), u, closed, 0.01)) < 1e-5
    np.testing.assert_array_equal(load.attainable_accelerations(Q, np.zeros(model.n), u, ~closed, 0.01), u)
