"""Parts of one target that are wanted in different ways."""

from typing import Any

import numpy as np
import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility.postures import arm_postures, configurations_at_stops
from psmpc_cli.ocp.feasibility.targets import _poses_at_target
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.parts import SKILL_KINDS, space_of
from psmpc_cli.specs.robots.robot import labels

MIXED = space_of("task", {"arm_1": "joint"})

TASK: dict[str, Any] = {
    "robot": "planar_dual_arm",
    "time_limit": 12,
    "controller": {"nodes": 10},
    "initial": {"base": [0, 0, 0], "arms": ["30 deg", "60 deg", "30 deg"]},
    "skills": {
        "reach": {
            "space": "task",
            "parts": {"arm_1": "joint"},
            "weights": {"base": [30, 30, 30], "arms": 30, "control": 0.1},
        }
    },
    "stages": [
        {
            "name": "reach",
            "skill": "reach",
            "target": {
                "base": [0, 0, 0],
                "arm_1": ["30 deg", "60 deg", "30 deg"],
                "arm_2": [-0.637, -0.767, "110 deg"],
            },
            "ends_when": {"coordinates": ["arm_1", "arm_2"], "tolerance": 0.01},
        }
    ],
}


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(load_task(TASK))


def test_rows_and_numbers_are_those_of_each_arm_in_its_own_space(problem: Problem) -> None:
    (stage,) = problem.stages
    assert stage.space == MIXED
    assert str(MIXED) == "task, arm_1 joint"
    assert stage.arms_at_joints == ("arm_1",)
    assert list(stage.poses_of_arms) == ["arm_2"]
    assert labels(problem.model.spec, MIXED)[3:6] == ("arm_1.1", "arm_1.2", "arm_1.3")
    assert labels(problem.model.spec, MIXED)[6:] == ("arm_2.x", "arm_2.y", "arm_2.theta")
    np.testing.assert_array_equal(stage.weights, np.full(9, 30.0))
    np.testing.assert_allclose(stage.target[3:6], np.radians([30, 60, 30]))


def test_the_error_of_each_part_is_that_of_its_own_kind(problem: Problem) -> None:
    model = problem.model
    (stage,) = problem.stages
    Q = np.linspace(-0.5, 0.6, 9)
    X = np.concatenate([Q, np.zeros(9)])[None]
    error = problem.costs.errors(stage, X)[0]
    xi = np.asarray(model.g(Q)).ravel()
    np.testing.assert_allclose(error[3:6], Q[3:6] - stage.target[3:6])
    np.testing.assert_allclose(error[6:], xi[6:] - stage.target[6:])


@pytest.mark.parametrize("space", [*SKILL_KINDS, MIXED, space_of("joint", {"arm_2": "free"})], ids=str)
def test_the_numbers_at_a_posture_lead_back_to_it(model: RobotModel, space: Any) -> None:
    Q = np.linspace(-0.4, 0.5, 9)
    posture = Posture(Q, np.asarray(model.g(Q)).ravel())
    skill = skill_in(space)
    after = skill.posture_after(model, posture, skill.numbers_at(model, posture))
    np.testing.assert_allclose(after.Q, Q)
    np.testing.assert_allclose(after.xi, posture.xi)
    assert len(skill.absent(model)) == skill.numbers(model)


def test_a_free_arm_has_no_rows(model: RobotModel) -> None:
    space = space_of("joint", {"arm_2": "free"})
    assert skill_in(space).rows(model) == 6
    aims = skill_in(space).aims(model, np.zeros(6))
    assert np.isfinite(aims[:2]).all()
    assert np.isnan(aims[2]).all()


def test_postures_are_those_of_joints_and_of_inverse_kinematics(problem: Problem) -> None:
    model = problem.model
    (stage,) = problem.stages
    stops = configurations_at_stops(problem.task, model, problem.stages)
    np.testing.assert_allclose(stops[1][3:6], np.radians([30, 60, 30]))
    np.testing.assert_allclose(model.poses(stops[1])[2], stage.poses_of_arms["arm_2"], atol=1e-6)
    assert [posture.arm for posture in arm_postures(model, problem.stages, stops)] == ["arm_1", "arm_2"]
    poses = _poses_at_target(model, stage)
    np.testing.assert_allclose(poses["arm_1"], model.poses(stops[1])[1], atol=1e-9)


def test_one_arm_reaches_while_the_other_keeps_its_joints() -> None:
    run = simulate(load_task(TASK))
    assert run.summary().succeeded
    joints = run["state/Q"][:, 3:6]
    assert np.abs(joints - np.radians([30, 60, 30])).max() < 0.05
    assert np.abs(run["state/Q"][-1, 6:] - run["state/Q"][0, 6:]).max() > 0.2


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"arm_3": "joint"}, "skills.reach.parts.arm_3: found an unknown arm"),
        ({"arm_1": "pose"}, "skills.reach.parts.arm_1: found 'pose'"),
        ({"base": "joint"}, "skills.reach.parts.base: found an unknown arm"),
    ],
)
def test_parts_that_are_none_are_named(parts: dict[str, str], message: str) -> None:
    skill = TASK["skills"]["reach"] | {"parts": parts}
    with pytest.raises(SpecError) as caught:
        load_task(TASK | {"skills": {"reach": skill}})
    assert message.partition(":")[0] in str(caught.value)


def test_targets_have_the_numbers_of_their_parts() -> None:
    target = TASK["stages"][0]["target"] | {"arm_1": [0.1, 0.2]}
    stage = TASK["stages"][0] | {"target": target}
    with pytest.raises(SpecError, match=r"target\.arm_1: found \[0.1, 0.2\], expected 3 entries"):
        load_task(TASK | {"stages": [stage]})
