"""What a task file may say, and the shorter ways to say it."""

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task, parse_task
from psmpc_cli.specs.task import EndCondition, SkillWeights, TaskSpec
from psmpc_cli.specs.uncertainty import UncertaintySpec

TASK = load_task("transport").task_yaml
ROBOT = load_task("transport").robot_yaml

ONE_GRIPPER = ["object.grasp.at={arm_1: [0.6415, 0, 135 deg]}", "stages.capture.target.arm_2=[-3.04, 2.52, -105 deg]"]


def edited(old: str, new: str) -> TaskSpec:
    assert old in TASK
    return parse_task(TASK.replace(old, new), ROBOT, "transport").spec


def test_weights_are_beside_control() -> None:
    flat = {"base": [1, 2, 3], "arms": [4, 5], "control": {"base": [1, 1, 1], "arms": [2, 2]}}
    weights = SkillWeights.model_validate(flat)
    assert weights.parts == {"base": (1, 2, 3), "arms": (4, 5)}
    assert weights.control == {"base": (1, 1, 1), "arms": (2, 2)}
    assert SkillWeights.model_validate({"base": [1, 2, 3]}).control == 1.0


def test_task_is_the_same_after_a_round_trip_through_plain_data() -> None:
    spec = load_task("transport", {"by_controller": {}}).spec
    assert TaskSpec.model_validate(spec.model_dump()) == spec
    assert TaskSpec.model_validate_json(spec.model_dump_json()) == spec


def test_tolerance_may_be_given_by_part() -> None:
    ends_when = edited("tolerance: 0.012", "tolerance: {base: 0.05, arms: [0.05, 0.05, 3 deg]}").stages[3].ends_when
    assert ends_when is not None and isinstance(ends_when.tolerance, dict)
    assert ends_when.tolerance["base"] == (0.05,)
    assert ends_when.tolerance["arms"] == pytest.approx((0.05, 0.05, 0.05235987755982989))


@pytest.mark.parametrize(("written", "seconds"), [("2 s", 2), ("0.5s", 0.5), (1.5, 1.5), (0, 0)])
def test_a_condition_may_have_to_hold(written: object, seconds: float) -> None:
    assert EndCondition.model_validate({"coordinates": "all", "hold": written}).hold == seconds


@pytest.mark.parametrize(
    ("path", "value", "kept"),
    [
        ("stages.approach.target.base[2]", "30", "30 rad"),
        ("stages.capture.target.arm_1[2]", "-45", "-45 rad"),
        ("initial.arm_1[1]", "90", "7 rad"),
        ("object.pose[2]", "30", "-30 rad"),
        ("limits", "{base: {position: [[-5, 5], [-5, 5], [-180, 180]]}}", None),
    ],
)
def test_angle_beyond_a_turn_needs_a_unit(path: str, value: str, kept: str | None) -> None:
    number = value if kept else "-180"
    with pytest.raises(SpecError, match=rf'{number} rad \(did you mean "{number} deg"\?\)'):
        load_task("transport", [f"{path}={value}"])
    if kept:
        load_task("transport", {path: kept})
    assert load_task("transport", ["stages.approach.target.base[0]=30"]).spec.stages[0].target["base"][0] == 30


def test_angle_of_a_robot_beyond_a_turn_needs_a_unit() -> None:
    with pytest.raises(SpecError, match=r'arms.arm_1.mount.angle: found 90 rad \(did you mean "90 deg"\?\)'):
        parse_task(TASK, ROBOT.replace("angle: 0 deg", "angle: 90", 1), "transport")


def uncertainty(*changes: str) -> UncertaintySpec:
    return load_task("transport", [f"uncertainty.{change}" for change in changes]).spec.uncertainty


@pytest.mark.parametrize(
    ("change", "plant", "measurement"),
    [
        ("noise.position=1e-3", False, True),
        ("noise.angle=1e-3", False, True),
        ("noise.velocity=1e-3", False, True),
        ("noise.angular_velocity=1e-3", False, True),
        ("mass=0.1", True, False),
        ("inertia={arm_2: 0.1}", True, False),
        ("centre_of_mass=0.01", True, False),
        ("friction.coulomb={arm_1: [0, 0, 0.1]}", True, False),
        ("force_limits={base: 10}", True, False),
        ("impulse={at: 3, linear: [1, 0]}", True, False),
        ("payload={mass: 5, inertia: 0.7}", True, False),
        ("delay=2", False, False),
    ],
)
def test_uncertainty_is_of_the_plant_or_of_the_measurement(change: str, plant: bool, measurement: bool) -> None:
    spec = uncertainty(change)
    assert spec.in_force
    assert (spec.changes_the_plant, spec.measures_with_noise) == (plant, measurement)
    if plant:
        with pytest.raises(SpecError, match="with plant ideal"):
            load_task("transport", ["plant=ideal", f"uncertainty.{change}"])


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
