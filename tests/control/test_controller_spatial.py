"""Controllers of spatial robots, stepped by hand on a plant that follows their plans exactly."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from psmpc_cli.logs.summary import LEVEL_ACCURACY
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.model import load_robot
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import Task, load_task

from ..free_flyer import attitude, reaching, turning
from ..stepped import stepped


@pytest.mark.parametrize("degrees", [175, 180, 185])
def test_a_turn_takes_the_short_way_at_a_rate_within_its_limit(degrees: float) -> None:
    task = turning(degrees)
    commands, _, state = stepped(task)
    turned = np.array([2 * np.arccos(min(1.0, abs(command.state[3]))) for command in commands])
    assert turned.max() < np.radians(min(degrees, 360 - degrees) + 1)
    wanted = Rotation.from_rotvec(np.radians(degrees) * np.ones(3) / np.sqrt(3))
    reached = Rotation.from_quat(state.Q[[4, 5, 6, 3]])
    assert (wanted.inv() * reached).magnitude() < 0.01
    assert max(np.abs(command.state[-9 + 3 : -9 + 6]).max() for command in commands) < 0.3 * 1.005


@pytest.mark.slow
def test_a_later_stage_with_a_high_priority_acts_early_and_ends_sooner() -> None:
    """In a mission with a skill of every kind."""
    ends = [stepped(reaching(f"controller.kind={kind}"))[1] for kind in ("psmpc", "smpc", "hard")]
    assert ends[0][1] + 0.2 < ends[1][1] < ends[2][1]
    assert [end[0] for end in ends] == pytest.approx([4.4] * 3, abs=0.15)


@pytest.mark.slow
def test_one_level_of_htmpc_is_hard_switching_and_more_keep_earlier_stages() -> None:
    hard, one, several = (
        stepped(turning(120, f"controller.kind={kind}", f"controller.htmpc.depth={depth}"))
        for kind, depth in (("hard", 1), ("htmpc", 1), ("htmpc", 2))
    )
    np.testing.assert_array_equal([c.state for c in hard[0]], [c.state for c in one[0]])
    first, second = zip(*(c.levels for c in several[0] if len(c.levels) == 2), strict=True)
    assert all(solved.outcome is Outcome.OPTIMAL for solved in second)
    kept, own = (np.array([solved.costs[0] for solved in level]) for level in (second, first))
    assert (kept <= own * (1 + 1e-3 + LEVEL_ACCURACY)).all()
    assert kept.max() > 0.1


SETTINGS = {
    "htmpc by errors": ("controller.kind=htmpc", "controller.htmpc.constraint=error"),
    "automatic nodes": ("controller.nodes=auto",),
    "several starts": ("controller.multistart=3",),
    "soft limits": ("controller.soft_limits=true",),
    "fatrop": ("solver.kind=fatrop",),
    "ipopt": ("solver.kind=ipopt",),
}


@cache
def switches_of_the_turn() -> list[float]:
    """The switch times of the mission without another setting."""
    return stepped(turning(120))[1]


@pytest.mark.slow
@pytest.mark.parametrize("changes", SETTINGS.values(), ids=list(SETTINGS))
def test_with_every_setting_the_mission_is_done(changes: tuple[str, ...]) -> None:
    commands, switches, _ = stepped(turning(120, *changes))
    assert not any({"solve_failed", "unmeasured"} & command.events for command in commands)
    again = switches_of_the_turn()
    rest = "controller.kind=htmpc" in changes  # its second stage begins when the first is over
    assert switches == pytest.approx(again, abs=2.5 if rest else 0.8 if "auto" in changes[0] else 1e-3)


@pytest.mark.slow
def test_a_tumbling_target_is_followed_through_more_than_a_turn() -> None:
    """At a constant rate between rows 100 deg apart: no way is shorter than that of the target."""
    rows = [{"position": [0.1 * k, 0, 0], "attitude": attitude([1, 2, 3], 100 * k)} for k in range(5)]
    moving = {"times": [8 * k for k in range(5)], "base": rows, "arm": [[0, 0, 0]] * 5}
    commands, switches, _ = stepped(turning(0, f"stages.fly.target={json.dumps(moving)}"), longest=50)
    assert switches[0] == pytest.approx(32, abs=0.01)
    for command in commands[10:280]:  # then the next stage is in the window
        wanted = Rotation.from_rotvec(np.radians(100 / 8 * command.time) * np.array([1, 2, 3]) / np.sqrt(14))
        assert (wanted.inv() * Rotation.from_quat(command.state[[4, 5, 6, 3]])).magnitude() < 0.01


@pytest.mark.slow
def test_an_arm_that_points_exactly_away_turns_round() -> None:
    """There no derivative says which way."""
    still = {"base": {"position": [0, 0, 0]}, "arm": [0, 0, 0]}
    changes = [f"stages.{name}.target={json.dumps(still)}" for name in ("fly", "reach")]
    _, _, state = stepped(
        reaching("stages.reach.skill=joint", *changes, f"stages.look.target={json.dumps({**still, 'arm': [-5, 0, 0]})}")
    )
    assert np.abs(state.Q[8] + state.Q[9]) == pytest.approx(np.pi, abs=0.05)


@pytest.mark.slow
def test_the_predicted_switch_time_stays_where_it_is() -> None:
    """About (1, 1, 1), from the sample after it is first seen on."""
    commands, switches, _ = stepped(turning(120, "controller.nodes=25"))
    seen = [float(command.switch_times[0]) for command in commands if len(command.switch_times)]
    assert len(seen) > 5
    assert np.ptp(seen[1:]) < 0.01
    assert switches[0] == pytest.approx(seen[-1], abs=1e-3)


PLANAR_IN_SPACE = """<robot name="planar">
<link name="base"><inertial><mass value="30"/><inertia ixx="1" iyy="1" izz="1.35"/></inertial></link>
{}
</robot>"""


LINK = """<link name="{name}"><inertial><origin xyz="{a} 0 0"/><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}"/></inertial></link>
<joint name="j{name}" type="revolute"><parent link="{on}"/><child link="{name}"/>
<origin xyz="{x} 0 0" rpy="0 0 {turn}"/>
<axis xyz="0 0 1"/><limit lower="-{most}" upper="{most}" velocity="0.15"/></joint>
"""


def in_space(folder: Path) -> Path:
    """The paper's robot on a base with six degrees of freedom, as URDF."""
    parts = []
    for arm, side in (("arm_1", 1), ("arm_2", -1)):
        on, x, turn = "base", 0.3 * side, 0.0 if side > 0 else np.pi
        for number, (mass, inertia, a) in enumerate(
            ((4.2, 0.35, 0.25), (4.2, 0.35, 0.25), (2.0, 0.0267, 0.1)), start=1
        ):
            most = np.pi / 2 if number == 1 else np.pi
            parts.append(
                LINK.format(name=f"{arm}_{number}", a=a, mass=mass, inertia=inertia, on=on, x=x, turn=turn, most=most)
            )
            on, x, turn = f"{arm}_{number}", 2 * a, 0.0
        parts.append(f'<link name="{arm}_tool"/><joint name="{arm}_fixed" type="fixed"><parent link="{on}"/>')
        parts.append(
            f'<child link="{arm}_tool"/><origin xyz="0.2 0 0" rpy="0 0 {0.0 if side > 0 else -np.pi}"/></joint>'
        )
    (folder / "planar.urdf").write_text(PLANAR_IN_SPACE.format("\n".join(parts)))
    arms = ", ".join(f"{arm}: {{tip: {arm}_tool}}" for arm in ("arm_1", "arm_2"))
    limits = "limits: {base: {velocity: [0.2, 0.2, 0.2, 0.2, 0.2, 0.2]}}"
    (folder / "robot.yaml").write_text(f"urdf: planar.urdf\nbase: base\narms: {{{arms}}}\n{limits}\n")
    return folder / "robot.yaml"


def in_both(planar: Task, robot: Path) -> Task:
    """A planar task for the same robot on a base with six degrees of freedom."""

    def pose(x: float, y: float, theta: float) -> dict[str, Any]:
        return {"position": [x, y, 0], "attitude": attitude([0, 0, 1], np.degrees(theta))}

    spec, stages = planar.spec, []
    for stage in spec.stages:
        target: Any = stage.target
        space = spec.skills[stage.skill].space
        moved = {part: pose(*row) if part == "base" or space == "task" else list(row) for part, row in target.items()}
        ends: Any = stage.ends_when
        ending = {"coordinates": list(ends.coordinates), "tolerance": ends.tolerance}
        stages.append(
            {"name": stage.name, "skill": stage.skill, "priority": stage.priority, "target": moved, "ends_when": ending}
        )
    skills = {}
    for name, skill in spec.skills.items():
        weights: dict[str, Any] = {"control": skill.weights.control}
        for part, row in skill.weights.parts.items():
            in_plane = part == "base" or skill.space == "task"
            weights[part] = [row[0], row[1], row[0], row[2], row[2], row[2]] if in_plane else list(row)
        skills[name] = {"space": skill.space, "weights": weights}
    start = {part: pose(*row) if part == "base" else list(row) for part, row in spec.initial.items()}
    settings = {"nodes": spec.controller.nodes, "zeta": spec.controller.zeta}
    return load_task(
        {"robot": str(robot), "initial": start, "controller": settings, "skills": skills, "stages": stages}
    )


@pytest.mark.slow
def test_the_paper_s_robot_on_a_base_with_six_degrees_of_freedom_moves_as_in_the_plane(tmp_path: Path) -> None:
    planar = load_task("approach_capture", {"controller.nodes": 12})
    spatial = in_both(planar, in_space(tmp_path))
    commands, switches, _ = stepped(spatial)
    _, expected, _ = stepped(planar)
    np.testing.assert_allclose(switches, expected, atol=1e-3)
    X = np.array([command.state for command in commands])
    out_of_plane = X[:, [2, 4, 5, 15, 16, 17]]
    assert np.abs(out_of_plane).max() < 1e-12


def test_a_redundant_arm_is_drawn_to_where_it_is() -> None:
    """An arm of seven joints has a posture row for each, and no other arm has."""
    stage = {"name": "hold", "skill": "reach", "ends_when": {"coordinates": ["all"], "tolerance": 0.01}}
    servicer = load_robot("dual_arm_servicer")
    rest = [0.1, 0.5, 0.0, 1.0, 0.0, 0.5, 0.0]
    base = {"position": [0, 0, 0]}
    poses = servicer.poses(np.r_[0, 0, 0, 1, 0, 0, 0, rest, rest])
    target = {"base": base, "left": list(poses[1]), "right": list(poses[2])}
    task = load_task(
        {
            "robot": "dual_arm_servicer",
            "initial": {"base": base, "left": rest, "right": rest},
            "skills": {"reach": {"space": "task", "weights": {"base": [10] * 6, "arms": [5] * 6, "control": 0.1}}},
            "stages": [{**stage, "target": target}],
        }
    )
    (built,) = build_problem(task).stages
    np.testing.assert_allclose(built.weights[18:], 5e-3)
