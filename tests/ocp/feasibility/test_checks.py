import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility.checks import ensure_feasible, load_task, remarks, review
from psmpc_cli.ocp.feasibility.forecast import forecast_stages
from psmpc_cli.robot.model import load_robot
from psmpc_cli.robot.reach import furthest_centre
from psmpc_cli.specs.document import Fault, dotted
from psmpc_cli.specs.library import built_ins, find
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.load import load_task as load_valid_task
from psmpc_cli.specs.robots.robot import resolve_limits

from ... import free_flyer

TRANSPORT = load_valid_task("transport")


def transport(*overrides: str) -> Task:
    return load_valid_task("transport", overrides)


def found(task: Task) -> list[str]:
    return [f"{dotted(problem.path)}: {problem.message}" for problem in review(task)]


def stage(at: str) -> str:
    return f"{{name: s, skill: move, target: {{base: [0, 0, 0], arms: [0, 0, 0]}}, {at}}}"


STRETCHED = ("transport", "approach_capture", "transport_grasp")
"""Built-in tasks whose first stage holds the arms stretched, as the paper's does."""


@pytest.mark.parametrize("name", built_ins("task"))
def test_built_in_tasks_are_feasible_and_without_remarks_but_on_stretched_arms(name: str) -> None:
    task = load_valid_task(name)
    ensure_feasible(task)
    found = [dotted(remark.path) for remark in remarks(task, forecast_stages(task))]
    assert found == (["stages[0].target"] if name in STRETCHED else [])


def other_remarks(task: Task) -> list[Fault]:
    """What is remarked beside the arms that a stage could pose, which these tests are not about."""
    return [
        remark for remark in remarks(task, forecast_stages(task)) if "expected the arms posed" not in remark.message
    ]


def noisy(*changes: str) -> list[tuple[str, str]]:
    task = transport("uncertainty.noise={position: 1e-3, angle: 1e-3}", *changes)
    return [(dotted(remark.path), remark.message) for remark in other_remarks(task)]


def test_a_jitter_of_more_than_half_a_sample_is_remarked() -> None:
    assert other_remarks(transport("uncertainty.jitter=0.05")) == []
    (remark,) = other_remarks(transport("uncertainty.jitter=0.08"))
    assert dotted(remark.path) == "uncertainty.jitter"
    assert remark.message.startswith("found 0.08 s, expected at most 0.05 s, half a sample: ")
    assert "commands arrive in bunches" in remark.message


def test_a_tolerance_below_three_sigma_of_its_measurement_is_remarked() -> None:
    """An arm's angle is the sum of the base's and three joints' of 1 mrad each: 3 sqrt(4) = 6 mrad."""
    by_stage = dict(noisy())
    assert list(by_stage) == [f"stages[{i}].ends_when" for i in (0, 1, 2)]
    assert "tolerance of 0.002 for base.x, expected at least 0.003, three standard" in by_stage["stages[0].ends_when"]
    assert "tolerance of 0.0011 for arm_1.theta, expected at least 0.006," in by_stage["stages[1].ends_when"]


@pytest.mark.parametrize(
    "changes",
    [
        ("controller.measurement_noise={}",),
        tuple(f"stages.{stage}.ends_when.tolerance=0.01" for stage in ("approach", "capture", "transport")),
    ],
)
def test_tolerances_above_three_sigma_or_without_noise_are_not_remarked(changes: tuple[str, ...]) -> None:
    assert noisy(*changes) == []


def test_misprint_of_the_paper_names_arm_distance_and_reach() -> None:
    misprinted = parse_task(
        TRANSPORT.task_yaml.replace("base: [-2, 2, 30 deg]", "base: [-2, -2, 30 deg]"),
        TRANSPORT.robot_yaml,
        "paper.yaml",
    )
    with pytest.raises(SpecError) as raised:
        ensure_feasible(misprinted)
    first, second = (line for line in str(raised.value).splitlines() if line.startswith("paper.yaml"))
    assert first == (
        "paper.yaml:22:45: stages[1].target.arm_1: found a pose 5.021 m from the shoulder of arm_1 with the base at "
        "[-2, -2, 30 deg], expected at most its reach of 1.2 m"
    )
    assert second.startswith("paper.yaml:22:80: stages[1].target.arm_2: found a pose 4.741 m")


def test_misprint_in_approach_alone_is_remarked() -> None:
    task = transport("stages.approach.target.base=[-2, -2, 30 deg]")
    assert review(task) == []
    assert [f"{dotted(remark.path)}: {remark.message}" for remark in other_remarks(task)] == [
        'stages[1].target.base: found the base 4 m from where "approach" leaves it, expected it there: '
        "the target of arm_1 is then 5.021 m from its shoulder, its reach is 1.2 m"
    ]


def test_a_base_that_floats_may_be_wanted_elsewhere() -> None:
    """It coasts there, with the momentum that the stage before leaves it."""
    task = transport("stages.approach.target.base=[-2, -2, 30 deg]", "stages.capture.mobility=free-floating")
    assert not any("leaves it" in remark.message for remark in other_remarks(task))


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (
            ["initial.arm_1=[100 deg, 0, 0]"],
            ["initial.arm_1[0]: found arm_1.1 at 100 deg, expected within its limits [-90 deg, 90 deg]"],
        ),
        (
            ["initial_velocity={base: [0, -1, 0]}"],
            ["initial_velocity.base[1]: found base.y at -1 m/s, expected within its limits [-0.2 m/s, 0.2 m/s]"],
        ),
        (
            ["stages.approach.ends_when.velocity=0.01", "stages.approach.ends_when.moving={base: [0, 5, 0]}"],
            [
                "stages[0].ends_when.moving: found base.y at 5 at the end, expected within its limits of velocity, "
                "[-0.2 m/s, 0.2 m/s]"
            ],
        ),
        (
            ["stages.approach.target.base=[-6, 2, 30 deg]"],
            ["stages[0].target.base[0]: found base.x at -6 m, expected within its limits [-5 m, 5 m]"],
        ),
        (
            ["stages.transport.target={base: [0, 0, 0], arms: [0, 0, 200 deg]}"],
            [
                "stages[2].target.arms[2]: found arm_1.3 at 200 deg, expected within its limits [-180 deg, 180 deg]",
                "stages[2].target.arms[2]: found arm_2.3 at 200 deg, expected within its limits [-180 deg, 180 deg]",
            ],
        ),
        (
            ["stages.capture.target.arm_1=[-1.9334, 3.1677, -15 deg]"],
            [
                "stages[1].target.arm_1: found a pose that puts the last joint 1.137 m from the shoulder of arm_1 with "
                "the base at [-2, 2, 30 deg], expected between 0 and 1 m, the reach of the links before the last"
            ],
        ),
        (
            ["skills.reach.limits={arm_2: {position: [[-10 deg, 10 deg], [-180 deg, 180 deg], [-180 deg, 180 deg]]}}"],
            [
                "stages[1].target.arm_2: found a pose that arm_2 can take only beyond its joint limits with the base "
                "at [-2, 2, 30 deg] (1.036 m from its shoulder, within its reach of 1.2 m), expected one within them",
            ],
        ),
        (
            ["skills.reach.limits={base: {position: [[-1, 1], [-5, 5], [-180 deg, 180 deg]]}}"],
            [
                "stages[1].target.base[0]: found base.x at -2 m, expected within its limits [-1 m, 1 m]",
                "stages[0].ends_when: found base.x at -2 m, expected within its limits [-1 m, 1 m], "
                'where "capture" keeps it',
            ],
        ),
        (
            ["skills.move.limits={base: {velocity: [0.1, [-0.1, 0], 0.1]}}"],
            [
                "stages[0].ends_when: found base.y to be moved, expected velocity limits that allow it, "
                "not [-0.1 m/s, 0 m/s]"
            ],
        ),
    ],
)
def test_what_stands_against_a_task_is_named(overrides: Sequence[str], expected: list[str]) -> None:
    assert found(transport(*overrides)) == expected


def wanting_the_base(x: float, *changes: str) -> Task:
    """Two hands reach poses, then the base is to be at x."""
    stages = (
        f"stages.fold.target={{base: [{x}, 0, 0], arm_1: [0.3, 0.3, 0.3], arm_2: [-0.3, -0.3, -0.3]}}",
        "stages.fold.ends_when={coordinates: [base.x, base.y], tolerance: 5e-3}",
    )
    return load_valid_task("float_and_reach", (*stages, *changes))


def test_a_floating_base_is_no_farther_from_the_common_centre_of_mass_than_stretched_arms_have_it() -> None:
    """The bound is that of both arms stretched the same way; the target is tried 1 mm on either side of it."""
    model = load_robot("planar_dual_arm")
    stretched = np.zeros(9)
    stretched[[3, 6]] = np.pi / 2 - np.array([arm.mount.angle for arm in model.spec.arms.values()])  # both to +y
    limits = resolve_limits(model.spec)
    most = furthest_centre(model.spec, limits)
    assert np.linalg.norm(model.centre_of_mass(stretched)) == pytest.approx(most)
    start = model.centre_of_mass(np.r_[0, 0, 0, 0.3, 0.3, 0.3, -0.3, -0.3, -0.3])
    edge = start[0] + np.sqrt((most + 1e-12) ** 2 - (abs(start[1]) - 5e-3) ** 2) + 5e-3
    assert found(wanting_the_base(edge - 1e-3)) == []
    (message,) = found(wanting_the_base(edge + 1e-3))
    assert message.startswith("stages[1].target.base: found the base at least 0.25")
    assert message.endswith(f"expected at most {most:.4g} m, with all arms stretched")


@pytest.mark.parametrize(("x", "reached"), [(2.0, True), (-1.0, False)])
def test_a_floating_base_that_drifts_comes_by_what_lies_ahead(x: float, reached: bool) -> None:
    """At 0.1 m/s over the 40 s of the task's limit; what lies behind is not met."""
    assert (found(wanting_the_base(x, "initial_velocity={base: [0.1, 0, 0]}")) == []) == reached


def test_a_floating_base_that_a_blow_pushes_is_not_judged_by_momentum() -> None:
    assert found(wanting_the_base(2.0, "uncertainty.impulse={at: 1, linear: [1, 0]}")) == []


@pytest.mark.parametrize(("x", "expected"), [(0.004, []), (0.1, ["base.x"])])
def test_a_fixed_base_is_wanted_where_it_is(x: float, expected: list[str]) -> None:
    wanted = [
        f"stages[1].ends_when: found {name} to be moved, expected it where it is: it is fixed" for name in expected
    ]
    assert found(wanting_the_base(x, "mobility=fixed")) == wanted


def test_instant_before_the_stage_can_begin_is_named() -> None:
    task = transport(f"stages.capture={stage('at: 8')}", "object=", "published={}", "monitors=[]")
    assert found(task) == [
        "stages[1].at: found 8 s, expected later: stages[0] cannot end before 9.99 s under the velocity limits"
    ]


def test_base_angle_means_its_nearest_equivalent_unless_exact() -> None:
    turned = "stages.approach.target.base=[-2, 2, 390 deg]"
    assert found(transport(turned)) == []
    assert found(transport(turned, "stages.approach.angles=exact"))[0] == (
        "stages[0].target.base[2]: found base.theta at 390 deg, expected within its limits [-180 deg, 180 deg]"
    )


def test_target_that_nothing_asks_for_is_left_alone() -> None:
    away = "stages.release.target.arm_1=[9, 9, 0]"
    free = ["skills.reach.weights.arm_1=[0, 0, 0]", "stages.release.ends_when.coordinates=[base, arm_2]"]
    assert found(transport(away, *free)) == []
    assert len(found(transport(away))) == 1


def moving(**rows: str) -> str:
    """An override that lets the base, or whatever else is given, of Transport follow two rows within 20 s."""
    parts = {"base": "[[-2, 2, 30 deg], [0, 0, 0]]", "arms": "[[0, 0, 0], [0, 0, 0]]", **rows}
    written = ", ".join(f"{part}: {value}" for part, value in parts.items())
    return f"stages.transport.target={{times: [0, 20], {written}}}"


def test_every_row_of_a_trajectory_must_lie_within_limits() -> None:
    assert found(transport(moving())) == []
    assert found(transport(moving(base="[[-2, 5.5, 30 deg], [0, 0, 0]]", arm_2="[[0, 0, 0], [0, 0, 190 deg]]"))) == [
        "stages[2].target.base[0][1]: found base.y at 5.5 m, expected within its limits [-5 m, 5 m]",
        "stages[2].target.arm_2[1][2]: found arm_2.3 at 190 deg, expected within its limits [-180 deg, 180 deg]",
    ]


def test_every_pose_of_a_trajectory_must_be_within_reach() -> None:
    far = "stages.trace.target.arm_1[5]=[1.5, 1.5, 90 deg]"
    turned = "stages.trace.target.arm_2[7]=[-0.54, 1.222, 90 deg]"
    assert found(load_valid_task("tracking", [far, turned])) == [
        "stages[1].target.arm_1[5]: found a pose 1.648 m from the shoulder of arm_1 with the base at [0.178, 0.207, "
        "0 deg], expected at most its reach of 1.2 m",
        "stages[1].target.arm_2[7]: found a pose that puts the last joint 1.265 m from the shoulder of arm_2 with the "
        "base at [0.322, 0.289, 0 deg], expected between 0 and 1 m, the reach of the links before the last",
    ]


def test_trajectory_faster_than_the_velocity_limits_is_remarked_where_it_is_worst() -> None:
    rows = "base: [[-2, 2, 30 deg], [-0.5, 1, 30 deg], [0, 0, 0]], arms: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]"
    task = transport(f"stages.transport.target={{times: [0, 5, 10], {rows}}}")
    assert review(task) == []
    assert [f"{dotted(remark.path)}: {remark.message}" for remark in other_remarks(task)] == [
        "stages[2].target.base[1][0]: found base.x to move at 0.3 m/s from 0 s to 5 s, expected within its velocity "
        "limits [-0.2 m/s, 0.2 m/s]: the robot falls behind"
    ]
    unweighed = transport(
        f"stages.transport.target={{times: [0, 5, 10], {rows}}}",
        "skills.move.weights.base=[0, 100, 10]",
        "stages.transport.ends_when.coordinates=[base.y]",
    )
    assert other_remarks(unweighed) == []


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        (["stages.release.priority=0.1"], "stages[3].priority"),
        (["stages.transport.priority=0.1"], "stages[3].priority"),
        (["controller.kind=smpc"], "controller.kind"),
        (["stages.release.priority=100", "stages.transport.priority=1e4"], None),
        (["stages.release.priority=1", "controller.kind=hard"], None),
        (["stages.release.priority=1", "object.let_go_by=null"], None),
    ],
    ids=["release", "carry", "no_priorities", "same_ratio", "one_stage", "never_let_go"],
)
def test_a_priority_that_may_open_grippers_while_they_carry_is_remarked(changes: list[str], path: str | None) -> None:
    task = transport(*changes)
    assert [dotted(remark.path) for remark in other_remarks(task)] == ([path] if path else [])


def test_priorities_of_an_object_with_a_mass_are_not_remarked_since_hands_keep_hold_of_it() -> None:
    task = load_valid_task("transport_grasp", ["stages.release.priority=1"])
    assert other_remarks(task) == []


def test_base_that_follows_a_path_is_compared_with_where_it_is_left_at_its_first_row() -> None:
    task = load_valid_task("tracking")
    assert other_remarks(task) == []
    shifted = load_valid_task("tracking", ["stages.unfold.target.base=[1.5, 0, 0]"])
    (remark,) = other_remarks(shifted)
    assert dotted(remark.path) == "stages[1].target.base[0]"
    assert remark.message.startswith('found the base 1.5 m from where "unfold" leaves it')


def test_a_time_limit_no_run_can_keep_is_remarked_on() -> None:
    """It is no error: a run may be meant to stop early."""
    task = transport("time_limit=19.9")
    assert review(task) == []
    (remark,) = other_remarks(task)
    assert remark.message.endswith('"release" cannot end before under the velocity limits')


POSES = ("the reach of the links before the last", "[0.3, 0.2, -0.3], turned by 120 deg")


@pytest.mark.parametrize(
    ("change", "path", "words"),
    [
        ("stages.reach.target.arm.position=[3, 3, 3]", "stages[1].target.arm", ("5.015 m", "reach of 0.46 m")),
        ("stages.reach.target.arm.attitude={rpy: [0, 0, 0]}", "stages[1].target.arm", POSES),
        ("stages.fly.target.arm=[130 deg, 0, 0]", "stages[0].target.arm[0]", ("arm.1 at 130 deg", "120 deg]")),
        ("limits.base={velocity: [0.2, 0.2, 0, 0.3, 0.3, 0.3]}", "stages[0].ends_when", ("base.z", "[0 m/s, 0 m/s]")),
        (
            "limits.base={velocity: [0.2, 0.2, 0.2, 0, 0, 0]}",
            "stages[0].ends_when",
            ("the attitude of base", "[0 deg/s, "),
        ),
        ("initial.arm=[0, 0, 130 deg]", "initial.arm[2]", ("arm.3 at 130 deg",)),
        (
            "stages.reach={name: r, skill: joint, target: {base: {position: [0, 0, 0]}, arm: [0, 0, 0]}, at: 3}",
            "stages[1].at",
            ("4.014 s",),
        ),
    ],
)
def test_what_stands_against_a_task_in_space_is_named(change: str, path: str, words: Sequence[str]) -> None:
    (fault,) = review(free_flyer.reaching(change))
    assert dotted(fault.path) == path
    assert all(word in fault.message for word in words), fault.message


def test_a_pose_that_no_joints_within_their_limits_take_is_remarked_with_the_nearest() -> None:
    """Ten degrees of each joint: no proof, as in the plane, but the best of many starts."""
    stiff = "limits={arm: {position: [[-10 deg, 10 deg], [-10 deg, 10 deg], [-10 deg, 10 deg]]}}"
    task = free_flyer.reaching(stiff)
    assert review(task) == []
    (remark,) = other_remarks(task)
    assert dotted(remark.path) == "stages[1].target.arm"
    assert "the nearest misses it by 0.12 m and 13 deg" in remark.message


def test_a_base_that_turns_faster_than_it_may_along_a_trajectory_is_remarked() -> None:
    rows = [{"position": [0.5 * k, 0, 0], "attitude": free_flyer.attitude([0, 0, 1], 60 * k)} for k in range(3)]
    target = {"times": [0, 2, 4], "base": rows, "arm": [[0, 0, 0]] * 3}
    task = free_flyer.turning(0, f"stages.fly.target={json.dumps(target)}")
    found = [f"{dotted(remark.path)}: {remark.message}" for remark in other_remarks(task)]
    assert [line.partition(" from ")[0] for line in found] == [
        "stages[0].target.base[1][0]: found base.x to move at 0.25 m/s",
        "stages[0].target.base[1][5]: found base.rz to move at 30 deg/s",
    ]


@pytest.mark.parametrize(
    ("change", "path", "words"),
    [
        ("stages.capture.ends_when.tolerance=0.02", "object.grasp.envelope.position", "arrive within 0.0283 m"),
        ("stages.capture.ends_when.velocity=null", "object.grasp.envelope.velocity", "does not bound arm_"),
        ("object.grasp.envelope.angle=1e-4", "object.grasp.envelope.angle", "arrive within 0.0011 rad"),
        ("object.grasp.at.arm_1=[4, 0, 0 deg]", "stages[1].target.arm_1", "its reach of 1.2 m"),
        (
            "stages.capture.target.arm_1=[-1.92, 3.16, 165 deg]",
            "object.grasp.at.arm_1",
            "leads arm_1, expected it there",
        ),
    ],
)
def test_grippers_that_cannot_close_on_an_object(change: str, path: str, words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_task("transport_grasp", [change])
    assert f"{path}: found" in str(error.value) and words in str(error.value)
    assert str(error.value).count(f"{path}: found") == 1


def unknown_load(task: str, changes: dict[str, object]) -> list[tuple[str, str]]:
    """Remarks on a built-in task whose low-level law does not know the load."""
    unknown = load_valid_task(task, {"object.grasp.known": False, **changes})
    return [(dotted(remark.path), remark.message) for remark in other_remarks(unknown)]


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("transport_grasp", ("an object of 20 kg", "2.31 times", "arm_1.2", '"transport"', "30 %", "expected true")),
        ("catch_tumbling", ("an object of 15 kg", "31.7 times", "left.6", '"carry"', "3.1 %", "armatures")),
    ],
)
def test_a_load_that_outweighs_a_robot_which_does_not_know_of_it_is_remarked(task: str, words: Sequence[str]) -> None:
    ((path, message),) = unknown_load(task, {})
    assert path == "object.grasp.known"
    for word in words:
        assert word in message


@pytest.mark.parametrize(("factor", "remarked"), [(0.43, False), (0.44, True)])
def test_a_light_load_need_not_be_known(factor: float, remarked: bool) -> None:
    """The ratio is proportional to the load: 1 is that of 20 kg / 2.308."""
    light = {"object.mass": 20 * factor, "object.inertia": 2.67 * factor}
    assert bool(unknown_load("transport_grasp", light)) == remarked


@pytest.mark.parametrize(
    ("armature", "mass", "words"),
    [(0.0, 10, ["arm_1.2", "armatures"]), (30.0, 10, []), (30.0, 20, ["base.theta"])],
)
def test_armatures_count_in_what_a_load_is_compared_with(
    armature: float, mass: float, words: list[str], tmp_path: Path
) -> None:
    """Between 10 and 20 kg the base alone is too light, and no armature is asked for."""
    text = find("robot", "planar_dual_arm").read_text()
    geared = tmp_path / "geared.yaml"
    geared.write_text(f"{text}armature: {{arms: [{armature}, {armature}, {armature}]}}\n")
    changes = {"robot": str(geared), "object.mass": mass, "object.inertia": 2.67 * mass / 20}
    found = " ".join(message for _, message in unknown_load("transport_grasp", changes))
    assert bool(found) == bool(words) and all(word in found for word in words)
    assert ("armature" in found) == ("armatures" in words)


def test_loading_a_task_raises_all_that_stands_against_it() -> None:
    """Not only the first of it; without these checks the task is loaded as it is."""
    beyond = {"initial.base": [-50, 2, 0], "stages.approach.target.base": [40, 2, 0]}
    with pytest.raises(SpecError) as caught:
        load_task("transport", beyond)
    assert "initial.base[0]: found base.x at -50 m, expected within its limits" in str(caught.value)
    assert "stages[0].target.base[0]: found base.x at 40 m, expected within its limits" in str(caught.value)
    task = load_task("transport", beyond, feasibility=False)
    assert task.spec.initial["base"] == (-50, 2, 0)
    assert str(caught.value) == task.source.report(review(task))


BY_PART = {"control": {"base": 6 * [1], "arm": [1, 1, 1]}}


@pytest.mark.parametrize(
    ("weights", "mobility", "path", "says"),
    [
        (BY_PART, "attitude", "control.base", "expected 0 for x, y, z, or none: nothing pushes the base"),
        ({"control": {"base": [0, 0, 0, 1, 1, 1], "arm": [1, 1, 1]}}, "attitude", "", ""),
        ({"control": 1}, "attitude", "", ""),
        ({"force": {"base": 6 * [1]}}, "attitude", "force.base", "found weights without effect"),
        ({"base": [1, 0, 0, 1, 1, 1]}, "attitude", "base", "expected 0 for x, y, z, or arms that follow it"),
        ({"rate": {"base": 6 * [1]}}, "free-floating", "rate.base", "nothing moves the base where it is free-floating"),
        (BY_PART, "free-flying", "", ""),
    ],
)
def test_weights_of_a_base_that_nothing_acts_on_are_remarked(
    weights: dict[str, object], mobility: str, path: str, says: str
) -> None:
    """In a task whose other skill has the base turned, so that such weights are no faults."""
    turn = {"base": [0, 0, 0, 1, 1, 1], "arm": [1, 1, 1], "control": 1}
    changes = {
        "skills.turn": {"space": "joint", "mobility": mobility, "weights": {**turn, **weights}},
        "stages.turn.ends_when": {"coordinates": "arm", "tolerance": "1 deg"},
    }
    task = load_valid_task("turn_and_look", changes)
    remarked = [remark for remark in other_remarks(task) if dotted(remark.path).startswith("skills")]
    assert [dotted(remark.path) for remark in remarked] == ([f"skills.turn.weights.{path}"] if path else [])
    assert all(says in remark.message for remark in remarked)


def test_a_turn_of_the_start_that_wheels_cannot_store_is_remarked() -> None:
    """The robot has 0.36 kg m^2 at most about any axis, and wheels store 0.139 N m s about z."""
    moving = {"initial_velocity": {"base": [0.1, 0, 0, 0, 0, 0.2]}}
    assert other_remarks(load_valid_task("turn_and_look", moving)) == []
    (remark,) = other_remarks(load_valid_task("turn_and_look", {"initial_velocity": {"base": [0.1, 0, 0, 0, 0, 0.6]}}))
    assert dotted(remark.path) == "initial_velocity"
    assert "expected at most 0.06 N m s" in remark.message
    flying = {"initial_velocity": {"base": [0, 0, 0, 0, 0, 0.6]}, "mobility": "free-floating"}
    changes = {"stages.turn.ends_when": {"coordinates": "arm", "tolerance": "1 deg"}, "stages.turn.onset": "arm"}
    assert other_remarks(load_valid_task("turn_and_look", {**flying, **changes})) == []
