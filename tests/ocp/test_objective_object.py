"""End conditions of the object that a stage holds."""

from collections.abc import Mapping

import numpy as np
import pytest

from psmpc_cli.ocp.end import ByObject
from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.stage import PlacedStage, cost_shape, stage_shape
from psmpc_cli.specs.load import load_task

from .transport_windows import ending

BOUNDS = {"position": 0.02, "angle": 0.05, "velocity": 0.03, "angular_velocity": 0.04}


def carrying(task: str, stage: str, bounds: Mapping[str, float]) -> Problem:
    """A problem whose stage ends by the object."""
    end = ", ".join(f"{measure}: {bound}" for measure, bound in bounds.items())
    return build_problem(load_task(task, [f"stages.{stage}.ends_when.object={{{end}}}"]))


def by_object(stage: PlacedStage) -> ByObject:
    """The end of a stage that ends by the object."""
    assert isinstance(stage.end, ByObject)
    return stage.end


def at_random(problem: Problem, index: int, seed: int) -> tuple[PlacedStage, np.ndarray, np.ndarray, np.ndarray]:
    """The stage, a state in its chart, and the object as it is in a gripper: pose and velocity by differences."""
    model = problem.model
    space = model.space
    rng = np.random.default_rng(seed)
    Q = np.array(space.integrate(space.neutral, rng.normal(scale=0.4, size=model.n)))
    v = rng.normal(scale=0.05, size=model.n)
    placed, x = in_own_chart(model, problem.stages[index], Q, v)
    end = by_object(placed)

    def pose_at(time: float) -> np.ndarray:
        gripper = model.poses(np.array(space.integrate(Q, time * v)))[list(model.pose_rows).index(end.frame)]
        return np.asarray(space.composed(gripper, end.inside))

    step = 1e-5
    rate = space.pose_error(pose_at(step), pose_at(-step)) / (2 * step)
    return placed, x, pose_at(0.0), rate


@pytest.mark.parametrize(("task", "stage"), [("transport_grasp", "transport"), ("catch_tumbling", "carry")])
def test_the_rows_are_the_components_that_the_object_has_in_the_gripper(task: str, stage: str) -> None:
    problem = carrying(task, stage, BOUNDS)
    index = [each.name for each in problem.stages].index(stage)
    for seed in range(5):
        placed, x, pose, rate = at_random(problem, index, seed)
        end = by_object(placed)
        space = problem.model.space
        d = space.dimension
        error = space.pose_error(pose, end.destination)
        angle = 2 * np.sin(np.linalg.norm(error[d:]) / 2)
        expected = [np.linalg.norm(error[:d]), angle, np.linalg.norm(rate[:d]), np.linalg.norm(rate[d:])]
        of_object = end.component_numbers[-len(BOUNDS) :]
        rows = problem.costs.ends(placed, x[None])[0][-sum(of_object) :]
        found = np.split(rows, np.cumsum(of_object)[:-1])
        np.testing.assert_allclose([np.linalg.norm(each) for each in found], expected, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found[0], pose[:d] - end.destination[:d], atol=1e-9)
        np.testing.assert_allclose(found[2], rate[:d], rtol=1e-6, atol=1e-9)


def test_windows_keep_the_lengths_within_their_tolerances() -> None:
    """A corner of the box that bounds the components is at the tolerance."""
    placed, *_ = at_random(carrying("catch_tumbling", "carry", BOUNDS), 2, seed=0)
    end = by_object(placed)
    of_object = end.component_numbers[-len(BOUNDS) :]
    corners = np.split(end.half_widths[-sum(of_object) :], np.cumsum(of_object)[:-1])
    assert [np.linalg.norm(corner) for corner in corners] == pytest.approx(list(BOUNDS.values()))


def test_a_row_is_at_its_tolerance_where_the_object_is() -> None:
    problem = carrying("transport_grasp", "transport", {"position": 0.02})
    placed, x, pose, _ = at_random(problem, 2, seed=1)
    end = by_object(placed)
    distance = float(np.linalg.norm(problem.model.space.pose_error(pose, end.destination)[:2]))
    for factor, is_met in ((1.001, True), (0.999, False)):
        problem = carrying("transport_grasp", "transport", {"position": factor * distance})
        placed, x, pose, rate = at_random(problem, 2, seed=1)
        stage = ending(placed, rows=(), tolerance=np.zeros(0), rate_tolerance=None)
        assert bool(problem.costs.met(stage, x[None])[0]) == is_met
        assert by_object(placed)._is_delivered(pose, rate) == is_met
        assert problem.costs.end_error(stage, x) == pytest.approx(1 / factor, rel=1e-6)


def test_derivatives_of_the_rows_are_those_of_differences() -> None:
    problem = carrying("catch_tumbling", "carry", BOUNDS)
    index = [each.name for each in problem.stages].index("carry")
    placed, x, _, _ = at_random(problem, index, seed=3)
    functions = stage_functions(problem.model, stage_shape(placed))
    _, jacobian = functions.end.with_jacobian(x, placed.target)
    step = 1e-6
    differences = []
    for column in range(len(x)):
        ahead = x.copy()
        behind = x.copy()
        ahead[column] += step
        behind[column] -= step
        difference = problem.costs.ends(placed, ahead[None])[0] - problem.costs.ends(placed, behind[None])[0]
        differences.append(difference / (2 * step))
    np.testing.assert_allclose(jacobian.reshape(-1, len(x)), np.array(differences).T, atol=1e-7)


def test_the_cost_of_a_stage_does_not_depend_on_the_object() -> None:
    with_object = carrying("transport_grasp", "transport", BOUNDS)
    without = build_problem(load_task("transport_grasp", ["stages.transport.ends_when.object=null"]))
    placed, x, _, _ = at_random(with_object, 2, seed=4)
    plain, _ = in_own_chart(without.model, without.stages[2], x[: without.model.nq], x[without.model.nq :])
    u = np.ones((1, len(x) // 2))
    assert with_object.costs.at(placed, x[None], u) == without.costs.at(plain, x[None], u)
    assert cost_shape(stage_shape(placed)) != cost_shape(stage_shape(plain))
