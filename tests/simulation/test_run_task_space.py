"""Stages whose control is the acceleration of poses, in closed loop: `input: task`."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from psmpc_cli.control.interface import Command, State
from psmpc_cli.errors import SpecError
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.ocp.feasibility.checks import load_task
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.report.texts import measure_rows, warnings_of
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.simulation.run import build_experiment, simulate

BENT = {"base": [0, 0, 0], "arm_1": [0.5, 0.6, 0.4], "arm_2": [-0.5, -0.6, -0.4]}
WEIGHTS = {"base": [100, 100, 100], "arms": [100, 100, 100], "control": 0.1}
OUTSTRETCHED = {"base": [0, 0, 0], "arm_1": [0.5, 0, 0.4], "arm_2": [-0.5, -0.6, -0.4]}


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("planar_dual_arm")


def coordinates(posture: Mapping[str, Any]) -> np.ndarray:
    return np.concatenate(list(posture.values()))


def reaching(robot: RobotModel, start: Mapping[str, Any] = BENT, end: float = 0.04, **keys: Any) -> dict[str, Any]:
    """A reach with a few cm and degrees to go."""
    poses = robot.poses(coordinates(start) + end)
    return {
        "robot": "planar_dual_arm",
        "initial": dict(start),
        "controller": {"horizon": 1.0, "nodes": 2},
        "solver": "ipopt",
        "skills": {"reach": {"space": "task", "input": "task", "weights": WEIGHTS}},
        "stages": [
            {
                "name": "reach",
                "skill": "reach",
                "priority": 1,
                "target": dict(zip(("base", "arm_1", "arm_2"), poses.tolist(), strict=True)),
                "ends_when": {"coordinates": ["base", "arms"], "tolerance": 5e-3},
            }
        ],
        "time_limit": 3.0,
        "log": {"ticks": True},
        **keys,
    }


@pytest.fixture(scope="module")
def run(robot: RobotModel) -> Run:
    return simulate(load_task(reaching(robot)))


def test_a_reach_by_accelerations_of_poses_ends_at_its_target(run: Run) -> None:
    assert run.summary().succeeded
    assert run.summary().failed_solves == 0


def test_the_condition_number_is_logged_at_every_sample_and_summarized(run: Run, robot: RobotModel) -> None:
    expected = [np.linalg.cond(robot.J_C(Q).full()) for Q in run["state/Q"]]
    np.testing.assert_allclose(run["pose/condition"], expected, rtol=1e-9)
    largest = run.summary().largest_condition
    assert largest is not None
    assert largest.value == pytest.approx(max(expected))
    assert any(label == "largest condition number of J_C" for label, _ in measure_rows(run.summary()))
    assert not any("singular" in warning for warning in warnings_of(run.summary()))


def test_tasks_in_joint_space_alone_have_no_condition_number(robot: RobotModel) -> None:
    task = reaching(robot)
    task["skills"]["reach"]["input"] = "joint"
    run = simulate(load_task(task, {"time_limit": 0.2}))
    assert "pose/condition" not in run
    assert run.summary().largest_condition is None


def test_the_force_of_a_command_is_that_of_the_law_in_task_space(robot: RobotModel) -> None:
    """And that of the law in joint space leads to the same motion: the rates of twists are those of the plan."""
    experiment = build_experiment(load_task(reaching(robot, initial_velocity={"base": [0.05, 0, 0.05]})))
    x = experiment.initial_state
    command: Command = experiment.controller.step(0.0, State.of(x))
    rates = command.twist_rates
    assert rates is not None
    Q, v = np.split(x, 2)
    np.testing.assert_allclose(command.force(0.0, State(Q, v)), robot.task_space_force(Q, v, rates[0]), rtol=1e-12)
    np.testing.assert_allclose(
        robot.twists(*np.split(command.plan.states_at(command.edges[-1:])[0], 2)),
        robot.twists(Q, v) + command.tick * rates.sum(axis=0),
        rtol=0,
        atol=1e-12,
    )
    joint = replace(command, twist_rates=None)
    bound = np.abs(joint.force(0.0, State(Q, v))).max()
    np.testing.assert_allclose(
        command.force(0.0, State(Q, v)), joint.force(0.0, State(Q, v)), rtol=0, atol=1e-3 * bound
    )
    plant = experiment.plant
    one = plant.advance(0.0, x, Setpoints(command.u, closed=command.closed, twist_rates=rates))
    other = plant.advance(0.0, x, Setpoints(command.u, closed=command.closed))
    moved = np.abs(other.states[-1] - x).max()
    assert moved > 1e-3
    np.testing.assert_allclose(
        one.states, other.states, rtol=0, atol=0.01 * moved
    )  # each law is exact where a tick begins


def test_rates_of_twists_reach_a_disturbed_plant_as_late_as_accelerations(robot: RobotModel) -> None:
    keys = {"uncertainty": {"friction": {"viscous": 0.1}, "delay": "0.1 s"}, "time_limit": 0.3}
    samples: list[Sample] = []
    simulate(load_task(reaching(robot, **keys)), watch=samples.append)
    assert not samples[0].ticks.F.any()  # at rest, and nothing has reached the plant yet
    for before, now in pairwise(samples):
        Q, v = np.split(now.ticks.states[0], 2)
        rates = before.command.twist_rates
        assert rates is not None
        np.testing.assert_allclose(now.ticks.F[0], robot.task_space_force(Q, v, rates[0]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("start", "end", "where"),
    [(OUTSTRETCHED, 0.04, "initial"), (BENT, -coordinates({**BENT, "base": [0, 0, 0]}) + 1e-9, "stages[0].target")],
    ids=["begins", "ends"],
)
def test_a_stage_that_begins_or_ends_with_an_outstretched_arm_is_rejected(
    robot: RobotModel, start: Mapping[str, Any], end: Any, where: str
) -> None:
    with pytest.raises(SpecError, match=r"condition number of J_C of .*, in which \"reach\" .* bent") as caught:
        load_task(reaching(robot, start, end))
    assert where in str(caught.value)


def test_near_a_singular_posture_the_law_in_joint_space_acts_and_that_is_said(
    robot: RobotModel, caplog: pytest.LogCaptureFixture
) -> None:
    nearly = {**BENT, "arm_1": [0.5, 1e-3, 0.4]}
    few = {"kind": "ipopt", "max_iterations": 3}
    task = load_task(reaching(robot, nearly, time_limit=0.1, solver=few), feasibility=False)
    with caplog.at_level(logging.WARNING):
        run = simulate(task)
    assert run["pose/condition"][0] > 1e3
    assert run["events/near_singular"][0] == 1
    assert "condition number above 1000" in caplog.text
    assert np.isfinite(run["state/Q"]).all()
    assert any("too near a singular posture" in warning for warning in warnings_of(run.summary()))


ONE_ARM = """\
name: one_arm
base: {mass: 30, inertia: 1.35}
arms:
  arm:
    mount: {position: [0.3, 0]}
    links:
      - {mass: 4.2, inertia: 0.35, a: 0.25, b: 0.25}
      - {mass: 4.2, inertia: 0.35, a: 0.25, b: 0.25}
"""


@pytest.mark.slow
def test_a_redundant_arm_reaches_and_comes_to_rest_in_its_null_space(tmp_path: Path) -> None:
    path = tmp_path / "one_arm.yaml"
    path.write_text(ONE_ARM + 2 * ONE_ARM.splitlines(keepends=True)[-1])
    skill = {"space": "task", "input": "task", "weights": {"base": [100, 100, 100], "arm": [100, 100, 100]}}
    skill["weights"]["control"] = 0.1
    target = {"base": [0.05, 0, 0], "arm": [0.9, 1.3, 2.1]}
    ends = {"coordinates": ["base", "arm"], "tolerance": 5e-3}
    task = {
        "robot": str(path),
        "initial": {"base": [0, 0, 0], "arm": [0.5, 0.6, 0.4, 0.5]},
        "controller": {"horizon": 1.0, "nodes": 2},
        "solver": "ipopt",
        "skills": {"reach": skill},
        "stages": [{"name": "reach", "skill": "reach", "target": target, "ends_when": ends}],
        "time_limit": 3.0,
    }
    run = simulate(load_task(task))
    assert run.summary().succeeded
    model = run.problem.model
    null = np.array([np.linalg.svd(model.J_C(Q).full())[2][-1] for Q in run["state/Q"]])
    in_null_space = np.abs(np.einsum("kn,kn->k", null, run["state/Qdot"]))
    assert in_null_space[-1] < 0.2 * in_null_space.max()  # undamped it would go on


def test_arms_with_too_few_joints_for_their_poses_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "one_arm.yaml"
    path.write_text(ONE_ARM)
    skill = {"space": "task", "input": "task", "weights": {"base": [1, 1, 1], "arm": [1, 1, 1]}}
    stage = {"name": "reach", "skill": "reach", "target": {"base": [0, 0, 0], "arm": [1.1, 0.3, 0.5]}}
    initial = {"base": [0, 0, 0], "arm": [0.5, 0.5]}
    task = {"robot": str(path), "initial": initial, "skills": {"reach": skill}, "stages": [stage], "solver": "ipopt"}
    with pytest.raises(
        SpecError, match=r"skills.reach.input: found 2 joints in arm.* needs 3 joints or more in every arm"
    ):
        load_task(task)


SPATIAL_ARM = """\
name: spatial_arm
space: spatial
base: {mass: 60, inertia: [5, 6, 7]}
arms:
  arm:
    tool: {position: [0.15, 0, 0]}
    links:
""" + "".join(
    f"      - {{joint: {{axis: {axis}, position: [0.2, 0, 0]}}, mass: 3, centre_of_mass: [0.1, 0, 0],"
    " inertia: [0.02, 0.03, 0.03]}\n"
    for axis in ([0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0])
)
BENT_ARM = [0.3, 0.5, -0.9, 0.4, 0.8, 0.2]


def reaching_in_space(folder: Path, arm: list[float], step: float = 0.03, **keys: Any) -> dict[str, Any]:
    """A reach of a spatial robot by the rates of twists, with a few cm and degrees to go."""
    path = folder / "spatial_arm.yaml"
    path.write_text(SPATIAL_ARM)
    robot = load_robot(path)
    start = np.r_[robot.neutral[:7], arm]
    poses = robot.poses(np.array(robot.space.integrate(start, np.full(robot.n, step))))
    target = {
        frame: {"position": pose[:3].tolist(), "attitude": {"quaternion": pose[3:].tolist()}}
        for frame, pose in zip(("base", "arm"), poses, strict=True)
    }
    ends = {"coordinates": ["base", "arm"], "tolerance": 5e-3}
    weights = {"base": [100] * 6, "arm": [100] * 6, "control": {"base": [0.1] * 6, "arm": [0.1] * 6}}
    return {
        "robot": str(path),
        "initial": {"base": {"position": [0, 0, 0]}, "arm": arm},
        "controller": {"horizon": 1.0, "nodes": 4},
        "solver": "ipopt",
        "skills": {"reach": {"space": "task", "input": "task", "weights": weights}},
        "stages": [{"name": "reach", "skill": "reach", "target": target, "ends_when": ends}],
        "plant": "ideal",
        "time_limit": 3.0,
        **keys,
    }


@pytest.fixture(scope="module")
def run_in_space(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, list[Sample]]:
    samples: list[Sample] = []
    task = load_task(reaching_in_space(tmp_path_factory.mktemp("robot"), BENT_ARM))
    return simulate(task, watch=samples.append), samples


@pytest.mark.slow
def test_a_spatial_robot_reaches_by_the_rates_of_twists(run_in_space: tuple[Run, list[Sample]]) -> None:
    run, samples = run_in_space
    assert run.summary().succeeded
    assert run.summary().failed_solves == 0
    model = run.problem.model
    expected = [np.linalg.cond(model.J_C(Q).full()) for Q in run["state/Q"]]
    np.testing.assert_allclose(run["pose/condition"], expected, rtol=1e-9)
    assert all(sample.command.twist_rates is not None for sample in samples)


@pytest.mark.slow
def test_the_states_of_a_spatial_window_are_those_of_its_dynamics(run_in_space: tuple[Run, list[Sample]]) -> None:
    """From node to node by another integrator, on the coordinates themselves, under the rates of twists between them.

    Runge-Kutta steps of 0.25 s are off by less than a thousandth of what they lead through.
    """
    run, samples = run_in_space
    model = run.problem.model
    space = model.space
    for plan in [sample.command.plan for sample in samples][:3]:
        Q, v = plan.chart.from_chart(plan.X)
        rates = np.diff(model.twists(Q, v), axis=0) / np.diff(plan.times)[:, None]
        assert np.abs(rates).max() > 0.05
        for k, a in enumerate(rates):

            def flow(_: float, state: np.ndarray, a: np.ndarray = a) -> np.ndarray:
                coordinates, velocity = state[: model.nq], state[model.nq :]
                J = model.J_C(coordinates).full()
                drift = np.asarray(model.Jdot_v(coordinates, velocity)).ravel()
                return np.concatenate([space.rate(coordinates, velocity), np.linalg.solve(J, a - drift)])

            start, end = plan.times[k : k + 2]
            found = solve_ivp(flow, (start, end), np.r_[Q[k], v[k]], rtol=1e-10, atol=1e-12).y[:, -1]
            off = np.r_[space.difference(found[: model.nq], Q[k + 1]), found[model.nq :] - v[k + 1]]
            moved = np.r_[space.difference(Q[k], Q[k + 1]), v[k + 1] - v[k]]
            assert np.abs(off).max() < 1e-3 * np.abs(moved).max()


@pytest.mark.slow
def test_near_a_singular_posture_in_space_the_law_in_joint_space_acts_and_that_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    nearly = [0.3, 0.5, -0.9, 0.4, 1e-3, 0.2]
    keys = {"time_limit": 0.1, "solver": {"kind": "ipopt", "max_iterations": 3}}
    task = load_task(
        reaching_in_space(tmp_path, nearly, **keys) | {"controller": {"horizon": 1.0, "nodes": 2}}, feasibility=False
    )
    with caplog.at_level(logging.WARNING):
        run = simulate(task)
    assert run["pose/condition"][0] > 1e3
    assert run["events/near_singular"][0] == 1
    assert "condition number above 1000" in caplog.text
    assert np.isfinite(run["state/Q"]).all()


def test_an_outstretched_spatial_arm_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"condition number of J_C of .*, in which \"reach\" begins.* bent"):
        load_task(reaching_in_space(tmp_path, [0.3, 0.5, 0.0, 0.4, 0.0, 0.2]))


@pytest.mark.parametrize(
    ("task", "skill", "found"),
    [("servicing", "reach", "7 joints in left"), ("fly_and_point", "look", "3 joints in arm")],
    ids=["redundant", "too few"],
)
def test_windows_take_spatial_robots_whose_arms_have_six_joints(task: str, skill: str, found: str) -> None:
    with pytest.raises(SpecError, match=rf"skills.{skill}.input: found {found}.* needs 6 joints in every arm"):
        load_task(task, {f"skills.{skill}.input": "task", "solver": "ipopt"})
