"""The object of a task."""

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task

ONE_GRIPPER = ["object.grasp.at={arm_1: [0.6415, 0, 135 deg]}", "stages.capture.target.arm_2=[-3.04, 2.52, -105 deg]"]


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        (["object.grasp.stiffness=[-1, 1]"], "object.grasp.stiffness[0]", "greater than 0"),
        (["object.inertia=null"], "object.mass", '"inertia"'),
        (["object.grasp.known=true", *ONE_GRIPPER], "object.grasp.known", "one gripper"),
        (["plant=ideal"], "object.mass", "rk4 or mujoco"),
        (["stages.capture.target.arm_1={object: arm_3}"], "stages[1].target.arm_1.object", "arm_1, arm_2"),
        (["stages.transport.target.arm_1={object: arm_1}"], "stages[2].target.arm_1", "skill in task space"),
        (["object.destination.tolerance=[1]"], "object.destination.tolerance", "3 entries"),
        (["uncertainty.payload={mass: 1, inertia: 1}"], "uncertainty.payload", "mass of its own"),
    ],
)
def test_objects_with_a_mass_that_make_no_sense(changes: list[str], path: str, words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_task("transport_grasp", changes)
    assert f"{path}: found" in str(error.value) and words in str(error.value)
    assert str(error.value).count(": found") == 1


@pytest.mark.parametrize("key", ["inertia", "motion", "destination", "grasp"])
def test_what_only_a_body_has_needs_a_mass(key: str) -> None:
    written = load_task("catch_drifting").source.value(("object", key))
    with pytest.raises(SpecError, match=f'object.{key}: found no mass, expected also "mass"'):
        load_task("transport", {f"object.{key}": written})
