"""What is known of a load, stage by stage."""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.loads import Load, known_load
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task


def test_a_known_payload_is_part_of_the_last_links() -> None:
    payload = {"mass": 5, "inertia": 0.7, "known": True}
    task = load_task("transport", {"uncertainty.payload": payload})
    model = RobotModel(task.robot)
    held = task.spec.held_stages.start
    load = known_load(task.spec, model, held)
    assert load.mass == (2.5, 2.5)
    assert load.held is None
    assert known_load(task.spec, model, held - 1) == Load((0.0, 0.0), (0.0, 0.0))
    Q = model.space.path(model.neutral, 0.3 * np.ones((1, model.n)))[-1]
    v, u = 0.1 * np.ones((2, model.n))
    F = ca.DM(load.kind.force(model, ca.SX(Q), ca.SX(v), ca.SX(u), ca.SX(load.numbers)))
    np.testing.assert_allclose(
        np.asarray(F).ravel(), model.inverse_dynamics(Q, v, u, load.parameters(model)), rtol=1e-12
    )
    h = load.momentum(model)(np.r_[Q, v], [])
    np.testing.assert_allclose(np.asarray(h).ravel(), model.momentum(Q, v, load.parameters(model)), rtol=1e-12)


def test_what_is_not_known_counts_as_nothing() -> None:
    payload = {"mass": 5, "inertia": 0.7}
    task = load_task("transport", {"uncertainty.payload": payload})
    model = RobotModel(task.robot)
    assert known_load(task.spec, model, task.spec.held_stages.start) == Load((0.0, 0.0), (0.0, 0.0))
    grasped = load_task("transport_grasp", {"object.grasp.known": False})
    assert known_load(grasped.spec, model, grasped.spec.held_stages.start).held is None
