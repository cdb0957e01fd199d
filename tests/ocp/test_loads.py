"""What is known of a load, stage by stage."""

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.ocp.loads import EMPTY_HANDS, Load, LoadKind, OwnMotion, known_load
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task, load_task


def test_a_known_payload_is_part_of_the_last_links() -> None:
    payload = {"mass": 5, "inertia": 0.7, "known": True}
    task = load_task("transport", {"uncertainty.payload": payload})
    model = RobotModel(task.robot)
    held = task.spec.held_stages.start
    load = known_load(task.spec, model, held)
    assert load.mass == (2.5, 2.5)
    assert load.held is EMPTY_HANDS
    assert known_load(task.spec, model, held - 1) == Load((0.0, 0.0), (0.0, 0.0))
    Q = model.space.path(model.neutral, 0.3 * np.ones((1, model.n)))[-1]
    v, u = 0.1 * np.ones((2, model.n))
    F = ca.DM(load.kind.force(model, ca.SX(Q), ca.SX(v), ca.SX(u), ca.SX(load.numbers)))
    np.testing.assert_allclose(
        np.asarray(F).ravel(), model.inverse_dynamics(Q, v, u, load.parameters(model)), rtol=1e-12
    )
    h = load.kind.momentum(model)(np.r_[Q, v], [], load.numbers)
    np.testing.assert_allclose(np.asarray(h).ravel(), model.momentum(Q, v, load.parameters(model)), rtol=1e-12)


def test_what_is_not_known_counts_as_nothing() -> None:
    payload = {"mass": 5, "inertia": 0.7}
    task = load_task("transport", {"uncertainty.payload": payload})
    model = RobotModel(task.robot)
    assert known_load(task.spec, model, task.spec.held_stages.start) == Load((0.0, 0.0), (0.0, 0.0))
    grasped = load_task("transport_grasp", {"object.grasp.known": False})
    assert known_load(grasped.spec, model, grasped.spec.held_stages.start).held is EMPTY_HANDS


def grasps_of(task: Task, arms: int) -> LoadKind:
    """The load of a task held by so many of its arms."""
    return LoadKind(carries=arms == 0, grippers=task.spec.body.grippers[:arms])


def numbers_of(task: Task, kind: LoadKind) -> np.ndarray:
    """Numbers of such a load."""
    model = RobotModel(task.robot)
    held = known_load(task.spec, model, task.spec.held_stages.start).held
    if kind.carries:
        return np.linspace(1, 4, kind.count(model))
    return np.array([held.mass, *held.inertia, *np.ravel(held.grasps[: len(kind.grippers)])])


def own_force_functions(model: RobotModel, kind: LoadKind) -> tuple[ca.Function, ca.Function]:
    """Q, Qdot, u, anchor, numbers -> own derivatives of the force by [Q; Qdot; u], and CasADi's of its expression."""
    Q, Qdot, u = (ca.SX.sym(name, model.n) for name in ("Q", "Qdot", "u"))
    anchor = ca.SX.sym("anchor", model.space.n_anchor)
    numbers = ca.SX.sym("numbers", kind.count(model))
    arguments = [Q, Qdot, u, anchor, numbers]
    motion = OwnMotion.in_chart(model, Q, Qdot, u, anchor)
    by = ca.vertcat(Q, Qdot, u)
    own = ca.Function("own", arguments, [kind.own_force_jacobian(model, motion, numbers, by)])
    return own, ca.Function("ad", arguments, [ca.jacobian(kind.own_force(model, motion, numbers), by)])


@pytest.mark.parametrize("arms", [0, 1, 2])
@pytest.mark.parametrize("name", ["transport_grasp", "servicing"])
@pytest.mark.parametrize(
    ("bent", "tolerance"),
    [
        (0.5, 1e-12),
        (3e-4, 1e-9),  # of straight arms the closed chain's system has condition numbers up to 1e9, see REGULARIZATION
    ],
)
def test_derivatives_of_forces_are_those_of_their_expression(
    name: str, arms: int, bent: float, tolerance: float
) -> None:
    """Also in grasps that strain the object, and with all arms nearly straight."""
    task = load_task(name, {"object.grasp.known": True})
    model = RobotModel(task.robot)
    kind = grasps_of(task, arms)
    own, ad = own_force_functions(model, kind)
    rng = np.random.default_rng(3)
    for _ in range(5):
        Q, Qdot, u = rng.normal(scale=0.3, size=(3, model.n))
        Q[model.space.joint_rates] = bent * rng.normal(size=model.space.joints)
        arguments = Q, Qdot, u, model.neutral[model.space.attitude], numbers_of(task, kind)
        found, expected = (np.asarray(function(*arguments)) for function in (own, ad))
        np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


def test_a_load_in_two_hands_costs_less_than_three_times_the_free_robot() -> None:
    """Operations of the derivatives, of 20 degrees of freedom: less than half of those that CasADi derives."""
    task = load_task("servicing")
    model = RobotModel(task.robot)
    (free, _), (held, ad) = (own_force_functions(model, grasps_of(task, arms)) for arms in (0, 2))
    assert held.n_instructions() < 3 * free.n_instructions()
    assert held.n_instructions() < 0.5 * ad.n_instructions()


def test_a_payload_that_is_found_out_begins_with_the_prior_in_plan_and_law() -> None:
    payload = {"mass": 5, "inertia": 0.7, "known": "estimated", "share": {"arm_1": 0.25, "arm_2": 0.75}}
    prior = {"mass": 8, "inertia": 1}
    task = load_task("transport", {"uncertainty.payload": payload, "controller.load_prior": prior})
    model = RobotModel(task.robot)
    held = task.spec.held_stages.start
    load = known_load(task.spec, model, held)
    assert load.is_estimated
    np.testing.assert_allclose(load.numbers, [2, 6, 0.25, 0.75])
    np.testing.assert_allclose(load.numbers_with(np.array([4.0, 2.0])), [1, 3, 0.5, 1.5])
    assert not known_load(task.spec, model, held - 1).is_estimated
