"""The task as printed, and how it and the shipped one differ."""

import math

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility.checks import load_task as load_feasible_task
from psmpc_cli.paper.departures import CONTROLLER_AS_PRINTED, DEPARTURES, PRINTED, SHIPPED, Departure, load_variant
from psmpc_cli.specs.controller import AS_PRINTED
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.task import TaskSpec

OWN_WORDS = {"name": "", "description": ""}


def content(spec: TaskSpec) -> TaskSpec:
    """A task without its texts; limits that repeat the robot's are none, and `as_printed` is the keys that it sets."""
    controller = spec.controller.model_copy(update={"as_printed": False})
    return spec.model_copy(update={**OWN_WORDS, "limits": {}, "controller": controller})


def test_the_tasks_differ_in_the_departures_alone() -> None:
    printed, shipped = (load_task(name).spec for name in (PRINTED, SHIPPED))
    assert content(load_task(SHIPPED, [change for one in DEPARTURES for change in one.printed]).spec) == content(
        printed
    )
    assert content(load_variant(PRINTED, None).spec) == content(printed)
    back = [change for one in DEPARTURES for change in one.shipped]
    off = ("controller.as_printed=false", *CONTROLLER_AS_PRINTED)
    assert content(load_task(PRINTED, [*off, *back]).spec) == content(shipped)


@pytest.mark.parametrize("base", [PRINTED, SHIPPED])
@pytest.mark.parametrize("departure", DEPARTURES, ids=[one.name for one in DEPARTURES])
def test_a_departure_is_switched_alone(base: str, departure: Departure) -> None:
    plain, switched = (load_variant(base, one) for one in (None, departure))
    assert content(plain.spec) != content(switched.spec)
    back = departure.printed if base == PRINTED else departure.shipped
    off = ("controller.as_printed=false", *CONTROLLER_AS_PRINTED) if base == PRINTED else ()
    assert content(load_task(base, [*off, *back]).spec) == content(plain.spec)


def test_every_key_of_as_printed_is_a_departure() -> None:
    keys = [change.partition("=")[0] for change in CONTROLLER_AS_PRINTED]
    assert keys == [f"controller.{key}" for key in AS_PRINTED]


def test_the_task_has_what_is_printed_of_stages_ends_starts_and_limits() -> None:
    task = load_task(PRINTED)
    spec = task.spec
    assert spec.controller.as_printed
    assert (spec.controller.horizon, spec.controller.nodes, spec.solver.traits.real_time) == (4.0, 100, False)
    assert [stage.priority for stage in spec.stages] == [1, 100, 1, 0.01]
    assert [stage.skill for stage in spec.stages] == ["move", "reach", "move", "reach"]
    for stage in spec.stages:  # every row of (30) and (31)
        assert stage.ends_when is not None and stage.onset is None
        assert len(stage.ends_when.tolerances(task.robot, spec.skills[stage.skill].space)) == 9
    assert (spec.onset.kind, spec.onset.epsilon) == ("control", 1e-4)
    half, whole = math.pi / 2, math.pi
    position = ((-half, half), (-whole, whole), (-whole, whole))
    arms = spec.limits["arms"]
    assert arms.position is not None
    assert [bound for pair in arms.position for bound in pair] == pytest.approx([b for pair in position for b in pair])
    assert arms.velocity == ((-0.15, 0.15),) * 3
    base = spec.limits["base"]
    assert base.position is not None and base.position[:2] == ((-5, 5), (-5, 5))
    assert base.velocity == ((-0.2, 0.2),) * 3


def test_the_printed_sign_of_approach_puts_the_object_out_of_reach() -> None:
    base = "[-2, -2, 30 deg]"
    changes = [f"stages.{stage}.target.base={base}" for stage in ("approach", "capture")]
    with pytest.raises(SpecError) as caught:
        load_feasible_task(PRINTED, changes)
    for arm, distance in (("arm_1", 5.021), ("arm_2", 4.741)):
        assert f"found a pose {distance} m from the shoulder of {arm}" in str(caught.value)
