"""Controllers of spatial robots, stepped by hand on a plant that follows their plans exactly."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.control.controller import Command, Controller, State
from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.objective import StageShape, stage_functions
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.model import load_robot
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task

Array = NDArray[np.float64]


def attitude(axis: list[float], degrees: float) -> dict[str, Any]:
    """An attitude as a task writes it."""
    return {"axis": list(np.array(axis) / np.linalg.norm(axis)), "angle": f"{degrees} deg"}


def run(task: Task, longest: float = 40.0) -> tuple[list[Command], list[float], State]:
    """Step a controller on an ideal plant until it is done: commands, switch times, final state."""
    controller = Controller(task)
    problem = controller.problem
    Q = initial(task)
    state, time, commands = State(Q, np.zeros(problem.model.n)), 0.0, list[Command]()
    while not controller.done and time < longest:
        commands.append(controller.step(time, state))
        plan, time = commands[-1].plan, round(time + task.spec.controller.sample_time, 6)
        found = plan.chart.leave(plan.states_at(np.array([time])))
        state = State(found[0][0], found[1][0])
    assert controller.done
    return commands, [switch.time for command in commands for switch in command.switches], state


def initial(task: Task) -> Array:
    """Coordinates at the start."""
    parts: Mapping[str, tuple[float, ...]] = task.spec.initial
    return np.concatenate([parts[part] for part in task.robot.parts])


def turning(degrees: float, nodes: int = 12) -> Task:
    """The small free-flyer turns about (1, 1, 1), flies half a metre and unfolds its arm."""
    pose = {"position": [0.3, 0.2, -0.3], "attitude": attitude([1, 1, 1], degrees)}
    weights = {"base": [100] * 6, "arm": [10] * 3, "control": 0.1}
    arms = ([0, 0, 0], ["40 deg", "-30 deg", "60 deg"])
    ends = {"coordinates": ["base"], "tolerance": 5e-3}, {"coordinates": ["all"], "tolerance": 5e-3}
    return load_task(
        {
            "robot": "free_flyer_arm",
            "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0, 0]},
            "controller": {"nodes": nodes},
            "skills": {"move": {"space": "joint", "weights": weights}},
            "stages": [
                {"name": "fly", "skill": "move", "target": {"base": pose, "arm": arms[0]}, "ends_when": ends[0]},
                {
                    "name": "unfold",
                    "skill": "move",
                    "priority": 10,
                    "target": {"base": pose, "arm": arms[1]},
                    "ends_when": ends[1],
                },
            ],
        }
    )


@pytest.mark.parametrize("degrees", [175, 180, 185])
def test_a_turn_takes_the_short_way_at_a_rate_within_its_limit(degrees: float) -> None:
    task = turning(degrees)
    commands, _, state = run(task)
    turned = np.array([2 * np.arccos(min(1.0, abs(command.x[3]))) for command in commands])
    assert turned.max() < np.radians(min(degrees, 360 - degrees) + 1)
    wanted = Rotation.from_rotvec(np.radians(degrees) * np.ones(3) / np.sqrt(3))
    reached = Rotation.from_quat(state.Q[[4, 5, 6, 3]])
    assert (wanted.inv() * reached).magnitude() < 0.01
    assert max(np.abs(command.x[-9 + 3 : -9 + 6]).max() for command in commands) < 0.3 * 1.005


def test_the_predicted_switch_time_stays_where_it_is() -> None:
    """About (1, 1, 1), from the sample after it is first seen on."""
    commands, switches, _ = run(turning(120, nodes=25))
    seen = [float(command.instants[0]) for command in commands if len(command.instants)]
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
    commands, switches, _ = run(spatial)
    _, expected, _ = run(planar)
    np.testing.assert_allclose(switches, expected, atol=1e-3)
    X = np.array([command.x for command in commands])
    out_of_plane = X[:, [2, 4, 5, 15, 16, 17]]
    assert np.abs(out_of_plane).max() < 1e-12


@pytest.mark.parametrize("space", ["joint", "task"])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 3.1, np.pi])
def test_derivatives_of_residuals_are_those_of_differences(space: str, angle: float) -> None:
    """At every size of the attitude's error, that of 180 deg included."""
    model = load_robot("free_flyer_arm")
    functions = stage_functions(model, StageShape(space))
    half = np.r_[np.cos(angle / 2), np.sin(angle / 2) * np.array([0.6, 0.0, 0.8])]
    arm = model.poses(np.r_[0, 0, 0, half, 0.1, 0.2, 0.3])[1]
    anchor = np.array([1.0, 0, 0, 0])
    numbers = np.r_[1, 2, 3, half, [0.1, 0.2, 0.3] if space == "joint" else arm, anchor, np.zeros(3)]
    Q = ca.SX.sym("Q", model.n)
    error = functions.residual(Q, numbers)
    jacobian = ca.Function("J", [Q], [ca.jacobian(error, Q)])
    at = np.r_[0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 0.2, 0.1, -0.3]
    exact, step = jacobian(at).full(), 1e-5
    assert np.isfinite(exact).all()

    def residual(Q: Array) -> Array:
        return np.asarray(functions.residual(Q, numbers)).ravel()

    differences = np.column_stack(
        [(residual(at + step * e) - residual(at - step * e)) / (2 * step) for e in np.eye(model.n)]
    )
    np.testing.assert_allclose(exact, differences, atol=1e-6)
    assert np.linalg.norm(residual(np.zeros(model.n))[3:6]) == pytest.approx(angle, abs=1e-12)


def test_simulate_says_that_it_takes_planar_robots_so_far() -> None:
    with pytest.raises(SpecError, match=r"free_flyer_arm.*Controller"):
        simulate(turning(90))


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
