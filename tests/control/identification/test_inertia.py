"""Masses and inertias of the robot and of what it holds, found out from its motion."""

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.control.identification.delay import Acting
from psmpc_cli.control.identification.inertia import InertiaEstimate, InertiaEstimator, MeasuredMotion
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task

T = 0.1
LIGHT_LOG = {"log": {"plans": False, "shares": False}}
IMPRECISE = {
    "controller.nodes": 12,
    "controller.masses": "estimated",
    "uncertainty": {"mass": 0.1, "inertia": 0.1, "payload": {"mass": 5, "inertia": 0.67}},
    **LIGHT_LOG,
}
TASKS = {
    "free": ("transport", {}),
    "floating": ("float_and_reach", {}),
    "fixed": ("float_and_reach", {"mobility": "fixed"}),
    "space": ("servicing", {}),
}


def model_of(task: str, changes: dict[str, str] | None = None) -> RobotModel:
    return build_problem(load_task(task, changes or {})).model


def off(model: RobotModel, factor: float = 1.0) -> InertialParameters:
    """Return parameters that are off by up to 10 %, of masses and inertias of bodies."""
    random = np.random.default_rng(3)
    nominal = model.nominal
    bodies = len(nominal.mass)
    by = 1 + factor * random.uniform(-0.1, 0.1, (2, bodies))
    return InertialParameters(
        nominal.mass * by[0], nominal.inertia * by[1][:, None], nominal.offset, nominal.held_mass, nominal.held_inertia
    )


def moved(
    model: RobotModel,
    true: InertialParameters,
    estimator: InertiaEstimator,
    estimate: InertiaEstimate,
    samples: int,
    noise: float = 0.0,
) -> InertiaEstimate:
    """Return the estimate after samples of random motions under the described law."""
    random = np.random.default_rng(samples)
    law = LowLevelLaw(model)
    for k in range(samples):
        step = random.uniform(-0.5, 0.5, model.n) * model.actuated()
        Q = np.array(model.space.integrate(model.neutral, step))
        v = random.uniform(-0.1, 0.1, model.n) * model.actuated()
        u = random.uniform(-0.2, 0.2, model.n)
        vdot = model.forward_dynamics(Q, v, law.force(Q, v, u), true)
        vdot = vdot + np.sqrt(2) * noise / T * random.standard_normal(model.n)
        motion = MeasuredMotion(10 + k * T, 10 + (k + 1) * T, Q, v, vdot)
        estimate = estimator.after_measurement(estimate, motion, [Acting(0.5, u, None), Acting(0.5, u, law)])
    return estimate


@pytest.mark.parametrize(("task", "changes"), TASKS.values(), ids=TASKS)
def test_accelerations_are_those_of_the_true_robot_once_it_has_moved(task: str, changes: dict[str, str]) -> None:
    """Not every mass is found, since some act together, but what a force leads to is."""
    model = model_of(task, changes)
    true = off(model)
    estimator = InertiaEstimator(model, np.zeros(model.n))
    found = estimator.parameters(moved(model, true, estimator, estimator.first, 60), is_loaded=False)
    F = LowLevelLaw(model).force(model.neutral, np.zeros(model.n), np.full(model.n, 0.2))
    wanted, described, estimated = (
        model.forward_dynamics(model.neutral, np.zeros(model.n), F, each) for each in (true, model.nominal, found)
    )
    assert np.abs(estimated - wanted).max() < 0.1 * np.abs(described - wanted).max()


def test_a_load_in_the_hands_is_found_out_and_forgotten_with_the_hands_empty() -> None:
    model = model_of("transport")
    true = off(model)
    estimator = InertiaEstimator(model, np.zeros(model.n))
    empty = moved(model, true, estimator, estimator.first, 20)
    held = estimator.holding(empty, is_loaded=True, time=0.0)
    loaded = moved(model, true.holding(np.array([2.5, 2.5]), np.array([0.3, 0.3])), estimator, held, 20)
    found = estimator.parameters(loaded, is_loaded=True)
    np.testing.assert_allclose(found.held_mass, 2.5, rtol=0.02)
    np.testing.assert_allclose(found.held_inertia, 0.3, rtol=0.02)
    assert not estimator.parameters(loaded, is_loaded=False).held_mass.any()
    released = estimator.holding(loaded, is_loaded=False, time=5.0)
    assert not estimator.parameters(released, is_loaded=True).held_mass.any()
    np.testing.assert_array_equal(released.mass_factor, loaded.mass_factor)


def test_noise_does_not_bias_the_estimate() -> None:
    """Deviations are those that the estimate says it has: 4 sigma of each factor."""
    model = model_of("transport")
    true = off(model)
    noise = 5e-3
    estimator = InertiaEstimator(model, np.full(model.n, noise))
    found = moved(model, true, estimator, estimator.first, 300, noise)
    mass = true.mass / model.nominal.mass
    inertia = (true.inertia / model.nominal.inertia)[:, 0]
    assert (np.abs(found.mass_factor - mass) < 4 * found.mass_deviation).all()
    assert (np.abs(found.inertia_factor - inertia) < 4 * found.inertia_deviation).all()
    assert found.mass_deviation.max() < 0.05


def test_what_is_not_measured_or_has_not_settled_or_acted_at_an_unknown_time_is_left_out() -> None:
    model = model_of("transport")
    estimator = InertiaEstimator(model, np.zeros(model.n))
    v = np.zeros(model.n)
    acting = [Acting(1.0, np.ones(model.n), None)]
    unknown = MeasuredMotion(1.0, 1.1, model.neutral, v, np.full(model.n, np.nan))
    known = MeasuredMotion(1.0, 1.1, model.neutral, v, np.ones(model.n))
    closing = estimator.holding(estimator.first, is_loaded=True, time=0.9)
    for left in (
        estimator.after_measurement(closing, known, acting).shares,
        estimator.after_measurement(estimator.first, unknown, acting).shares,
        estimator.after_measurement(estimator.first, known, acting, np.full(model.n, np.inf)).shares,
    ):
        assert not left.any()


@pytest.mark.slow
def test_a_run_with_wrong_masses_and_an_unknown_payload_ends_as_if_they_were_known() -> None:
    wanted = psmpc.simulate(load_task("transport", {"controller.nodes": 12, **LIGHT_LOG}))
    run = psmpc.simulate(load_task("transport", {**IMPRECISE, "seed": 4}))
    assert run.summary().succeeded
    assert abs(run.summary().duration - wanted.summary().duration) < 0.5
    error = run["masses/mass_factor"][-1] - run["uncertainty/mass_factor"]
    assert np.abs(error).max() < 0.01
    assert not run["masses/held_mass"][run.time < 10].any()
    np.testing.assert_allclose(run["masses/held_mass"].max(axis=0), 2.5, rtol=0.1)
