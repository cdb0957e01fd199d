"""The object of a task."""

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        (["object.grasp.stiffness=[-1, 1]"], "object.grasp.stiffness[0]", "greater than 0"),
        (["object.inertia=null"], "object.mass", '"inertia"'),
        (["object.grasp.strength={filter: 0.1}"], "object.grasp.strength", "at least one of pull, shear, moment"),
        (["object.grasp.strength.shear=-1"], "object.grasp.strength.shear", "greater than 0"),
        (
            ["object.let_go_by=transport", "stages.transport.ends_when.object=null"],
            "object.let_go_by",
            "a stage holds the object",
        ),
        (["plant=ideal"], "object.mass", "rk4 or mujoco"),
        (["stages.capture.target.arm_1={object: arm_3}"], "stages[1].target.arm_1.object", "arm_1, arm_2"),
        (["stages.transport.target.arm_1={object: arm_1}"], "stages[2].target.arm_1", "skill in task space"),
        (["object.destination.tolerance=[1]"], "object.destination.tolerance", "3 entries"),
        (["uncertainty.payload={mass: 1, inertia: 1}"], "uncertainty.payload", "mass of its own"),
        (["stages.transport.ends_when.object={}"], "stages[2].ends_when.object", "at least one of position"),
        (["stages.capture.ends_when.object={velocity: 0.1}"], "stages[1].ends_when.object", "holds the object"),
        (["stages.transport.ends_when.object={speed: 0.1}"], "stages[2].ends_when.object.speed", "velocity"),
        (["stages.transport.ends_when.object={velocity: -1}"], "stages[2].ends_when.object.velocity", "greater"),
        (["stages.transport.ends_when={velocity: 0.1}"], "stages[2].ends_when", '"coordinates", "object", "momentum"'),
    ],
)
def test_objects_with_a_mass_that_make_no_sense(changes: list[str], path: str, words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_task("transport_grasp", changes)
    assert f"{path}: found" in str(error.value) and words in str(error.value)
    assert str(error.value).count(": found") == 1


@pytest.mark.parametrize("key", ["object.inertia", "controller.load_prior"])
def test_moments_of_inertia_are_those_that_a_body_can_have(key: str) -> None:
    """Of the object, and of what the controller takes it for."""
    moments = [1, 1, 3] if key == "object.inertia" else {"mass": 5, "inertia": [1, 1, 3]}
    wanted = "found moments that no body has, expected none larger than the sum of the other two"
    with pytest.raises(SpecError, match=wanted) as error:
        load_task("catch_tumbling", {"object.grasp.known": "estimated", key: moments})
    assert str(error.value).count(": found") == 1
    assert f"{'object' if key == 'object.inertia' else key}.inertia: found" in str(error.value)


def test_a_stage_that_ends_by_the_object_needs_a_destination() -> None:
    changes = ["stages.transport.ends_when.object={velocity: 0.1}", "object.destination=null"]
    with pytest.raises(SpecError, match="with a mass and a destination"):
        load_task("transport_grasp", changes)


@pytest.mark.parametrize("key", ["inertia", "motion", "destination", "grasp"])
def test_what_only_a_body_has_needs_a_mass(key: str) -> None:
    written = load_task("catch_drifting").source.value(("object", key))
    with pytest.raises(SpecError, match=f'object.{key}: found no mass, expected also "mass"'):
        load_task("transport", {f"object.{key}": written})


def test_a_coast_to_the_object_takes_some_time() -> None:
    target = {"object": [0, -1.978, 0], "met_in": 0}
    with pytest.raises(SpecError, match=r"base\.met_in: found 0, expected a time longer than 0 s"):
        load_task("capture_floating", {"stages.approach.target.base": target})
