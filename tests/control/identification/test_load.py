"""The load in the grippers, found out from the momentum of robot and load."""

from typing import Any

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.control.identification.load import (
    LoadEstimator,
    RobotAlone,
    RobotAndObject,
    RobotAndPayload,
    _as_rigid_body,
    _without_knowledge_of,
)
from psmpc_cli.ocp.loads import LoadPrior
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.specs.load import load_task

BESIDE = {
    "base": [-1.5, 1.5, "20 deg"],
    "arm_1": ["45 deg", "30 deg", "60 deg"],
    "arm_2": ["-45 deg", "-30 deg", "-60 deg"],
}
"""Beside an object that drifts towards the robot."""
DRIFTING: dict[str, Any] = {
    "controller.nodes": 12,
    "initial": BESIDE,
    "log": {"plans": False, "shares": False},
}
ESTIMATED: dict[str, Any] = {**DRIFTING, "object.grasp.known": "estimated", "uncertainty.object.mass": 0.85}
IMPRECISE: dict[str, Any] = {
    "uncertainty.mass": 0.1,
    "uncertainty.inertia": 0.1,
    "uncertainty.noise": dict.fromkeys(("position", "angle", "velocity", "angular_velocity"), 1e-3),
}


@pytest.fixture(scope="module")
def found() -> psmpc.Run:
    return psmpc.simulate(
        load_task("catch_drifting", {**ESTIMATED, "controller.load_prior": {"mass": 10, "inertia": 2}})
    )


@pytest.mark.slow
def test_a_run_finds_out_its_load_and_delivers_it(found: psmpc.Run) -> None:
    closed = float(found["grasp/closed_at"].max())
    true = float(found["object/mass"])
    assert abs(true - 10) > 5
    mass = found["load/mass"]
    assert (mass[found.time < closed] == 10).all()
    late = found.time > closed + 1
    np.testing.assert_allclose(mass[late], true, rtol=0.02)
    assert (np.abs(mass[late] - true) < 4 * found["load/mass_deviation"][late]).all()
    np.testing.assert_allclose(found["load/inertia"][-1], found["object/inertia"], rtol=0.2)
    assert found.summary().succeeded
    assert not found["events/load_dropped"].any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_the_robots_own_masses_are_found_out_before_the_load(seed: int) -> None:
    """With bodies that are 10 % off, the load of some 4 to 25 kg is known to 1 kg after a second."""
    run = psmpc.simulate(load_task("catch_drifting", {**ESTIMATED, **IMPRECISE, "seed": seed}))
    late = run.time > float(run["grasp/closed_at"].max()) + 1.5
    error = np.abs(run["load/mass"][late] - float(run["object/mass"]))
    assert error.max() < 1.0
    assert (error < 4 * run["load/mass_deviation"][late]).all()
    assert run.summary().succeeded


@pytest.mark.slow
def test_a_load_in_space_is_found_out() -> None:
    changes = {
        "object.grasp.known": "estimated",
        "uncertainty.object.mass": 0.7,
        "controller.nodes": 12,
        "limits.base.force": None,
        "initial.base": {
            "position": [1.34, -0.36, 0.46],
            "attitude": {"quaternion": [0.9440, 0.1899, 0.0496, 0.2651]},
        },
        "log": DRIFTING["log"],
        "time_limit": 6,
    }
    run = psmpc.simulate(load_task("catch_tumbling", changes))
    assert run["load/mass"][-1] == pytest.approx(float(run["object/mass"]), rel=0.03)
    assert run["load/mass"][0] != pytest.approx(float(run["object/mass"]), rel=0.1)


@pytest.mark.slow
def test_a_payload_is_found_out_and_the_mission_ends_as_with_a_known_one() -> None:
    weighed = {"mass": 5, "inertia": 0.67}
    settings = {"controller.nodes": 25, "log": DRIFTING["log"]}
    known = psmpc.simulate(load_task("transport", {**settings, "uncertainty.payload": {**weighed, "known": True}}))
    unknown = psmpc.simulate(load_task("transport", {**settings, "uncertainty.payload": weighed}))
    payload = {**weighed, "known": "estimated"}
    prior = {"mass": 10, "inertia": 2}
    changes = {**settings, "uncertainty.payload": payload, "controller.load_prior": prior}
    found = psmpc.simulate(load_task("transport", changes))
    held = np.flatnonzero(found["payload/held"])
    assert (found["load/mass"][: held[0]] == 10).all()
    settled = held[found.time[held] > found.time[held[0]] + 1.5]
    error = np.abs(found["load/mass"][settled] - 5)
    assert error.max() < 0.15
    assert (error < 4 * found["load/mass_deviation"][settled]).all()
    assert found.summary().load == (found["load/mass"][held[-1]], found["load/mass_deviation"][held[-1]])
    assert abs(found.summary().duration - known.summary().duration) <= 0.1 + 1e-9
    assert unknown.summary().duration > known.summary().duration + 2


def test_the_momentum_of_a_payload_is_linear_in_its_mass_and_inertia() -> None:
    model = build_problem(load_task("transport")).model
    random = np.random.default_rng(0)
    Q, v = random.normal(size=(2, model.n))
    shares = np.array([0.3, 0.7])
    by_numbers = RobotAndPayload(0.0, Q, v, shares).load_momentum(model)
    holding = model.nominal.holding(5 * shares, 0.67 * shares)
    carried = model.momentum(Q, v, holding) - model.momentum(Q, v)
    np.testing.assert_allclose(by_numbers @ [5, 0.67], carried, rtol=0, atol=1e-12)


def test_what_does_not_explain_the_motion_is_given_up_for_the_prior() -> None:
    """Robot and load that change their velocity although nobody pushes them."""
    problem = build_problem(load_task("catch_drifting", {"object.grasp.known": "estimated"}))
    model = problem.model
    prior = np.array([10.0, 1.0])
    estimator = LoadEstimator(model, LoadPrior(prior, 0.5 * prior), np.full(model.n, 1e-3))
    estimate = estimator.first
    random = np.random.default_rng(0)
    u = np.zeros((100, model.n))
    before = None
    dropped = []
    for k in range(20):
        v = random.uniform(-0.5, 0.5, model.n)
        now = RobotAndObject(0.1 * k, model.neutral, v, (np.array([1.0, 0.0, 0.0]), v[:3]))
        if before is not None:
            estimate = estimator.after_measurement(estimate, before, now, u, problem.law)
        dropped.append(estimate.dropped)
        before = now
    assert any(dropped)
    first = estimator.first
    assert (first.numbers == prior).all() and (first.deviation == prior / 2).all()


def test_a_sample_that_is_not_measured_begins_a_new_block() -> None:
    problem = build_problem(load_task("catch_drifting", {"object.grasp.known": "estimated"}))
    model = problem.model
    estimator = LoadEstimator(model, LoadPrior(np.ones(2), np.ones(2)), np.zeros(model.n))
    rest = [RobotAlone(0.1 * k, model.neutral, np.zeros(model.n)) for k in range(3)]
    unknown = RobotAlone(0.2, model.neutral, np.full(model.n, np.nan))
    u = np.zeros((100, model.n))
    estimate = estimator.after_measurement(estimator.first, rest[0], rest[1], u, problem.law)
    assert estimate.begun == 0.1
    assert estimator.after_measurement(estimate, rest[1], unknown, u, problem.law).begun == np.inf


def test_unknowns_that_are_forgotten_leave_what_was_known_of_the_others() -> None:
    random = np.random.default_rng(1)
    root = random.standard_normal((5, 5))
    information = root @ root.T
    right = random.standard_normal(5)
    marginal, left = _without_knowledge_of(information, right, slice(3, 5))
    np.testing.assert_allclose(np.linalg.inv(marginal[:3, :3]), np.linalg.inv(information)[:3, :3])
    solution = np.linalg.solve(information, right)
    np.testing.assert_allclose(np.linalg.solve(marginal[:3, :3], left[:3]), solution[:3])
    assert not marginal[3:].any() and not left[3:].any()


@pytest.mark.parametrize(
    ("numbers", "body"),
    [
        ([-1, 2], [0.1, 2]),
        ([1, 1, 2, 5], [1, 1, 2, 3]),
        ([1, 1, 2, 2.5], [1, 1, 2, 2.5]),
        ([1, -1, 2, 2], [1, 0.1, 2, 2]),
    ],
)
def test_estimates_are_bodies_that_can_exist(numbers: list[float], body: list[float]) -> None:
    np.testing.assert_allclose(_as_rigid_body(np.array(numbers, float), np.full(len(numbers), 0.1)), body)
