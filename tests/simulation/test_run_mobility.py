"""Runs whose stages have bases that different things move: momentum, forces and velocities across their switches."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from psmpc_cli.logs.run import Run
from psmpc_cli.report.texts import measure_rows
from psmpc_cli.robot.configuration import SPACE
from psmpc_cli.robot.model import load_robot
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

BESIDE = {"arm_1": ["20 deg", "60 deg", "40 deg"], "arm_2": ["-20 deg", "-60 deg", "-40 deg"]}
FOLDED = {"arm_1": ["60 deg", "2.2 deg", "72.8 deg"], "arm_2": ["-60 deg", "-2.2 deg", "-72.8 deg"]}
AT_OBJECT = {"arm_1": {"object": "arm_1"}, "arm_2": {"object": "arm_2"}}


@cache
def taken_while_floating(mobility: str, plant: str, step: float | None = None) -> Run:
    """A planar robot beside an object: it settles, takes it and folds its arms while nothing pushes it, then flies."""
    on_arms = {"arm_1": [10, 10, 1], "arm_2": [10, 10, 1], "control": 4}
    of_joints = {"arm_1": [100, 100, 10], "arm_2": [100, 100, 10], "control": 4}
    stages = [
        {
            "name": "settle",
            "skill": "fly",
            "target": {"base": [0, 0, 0], **BESIDE},
            "ends_when": {"coordinates": ["base"], "tolerance": 0.01, "velocity": 2e-3},
        },
        {
            "name": "take",
            "skill": "grasp",
            "priority": 10,
            "target": AT_OBJECT,
            "ends_when": {"coordinates": ["arms"], "tolerance": 2e-3, "velocity": 0.01},
        },
        {
            "name": "fold",
            "skill": "fold",
            "priority": 10,
            "target": FOLDED,
            "ends_when": {"coordinates": ["arms"], "tolerance": 0.05},
        },
        {
            "name": "fly",
            "skill": "fly",
            "target": {"base": [0, -0.1, 0], **FOLDED},
            "ends_when": {"coordinates": ["base"], "tolerance": 0.01, "velocity": 0.01},
        },
    ]
    task = {
        "robot": "planar_dual_arm",
        "initial": {"base": [0, -0.03, 0], **BESIDE},
        "controller": {"nodes": 12},
        "plant": {"kind": plant, "low_level_rate": 500, **({} if step is None else {"step": step})},
        "time_limit": 30,
        "skills": {
            "fly": {"space": "joint", "weights": {"base": [100, 100, 10], **of_joints}},
            "grasp": {"space": "task", "mobility": mobility, "weights": on_arms},
            "fold": {"space": "joint", "mobility": mobility, "weights": of_joints},
        },
        "stages": stages,
        "limits": {"base": {"acceleration": [0.2, 0.2, 0.5]}, "arms": {"acceleration": [0.5, 0.5, 0.5]}},
        "object": {
            "shape": [1.2, 0.4],
            "pose": [0, 0.978, 0],
            "mass": 20,
            "inertia": 2.67,
            "taken_by": "take",
            "grasp": {
                "at": {"arm_1": [0.6415, 0, "135 deg"], "arm_2": [-0.6415, 0, "-135 deg"]},
                "envelope": {"position": 0.01, "angle": "2 deg", "velocity": 0.05, "angular_velocity": "10 deg"},
                "stiffness": [1000, 100],
                "strength": {"pull": 60, "filter": 0.2},
                "known": True,
            },
        },
        "log": {"ticks": True, "shares": False},
    }
    return simulate(load_task(mounted(task) if mobility == "fixed" else task))


def mounted(task: dict[str, Any]) -> dict[str, Any]:
    """Return the task for a base that a mount holds, beside the object from the start."""
    changed = {**task, "mobility": "fixed", "initial": {"base": [0, 0, 0], **BESIDE}}
    changed["limits"] = {"arms": task["limits"]["arms"]}
    changed["skills"] = {
        name: {"space": skill["space"], "weights": {k: w for k, w in skill["weights"].items() if k != "base"}}
        for name, skill in task["skills"].items()
    }
    settle, take, fold, fly = task["stages"]
    ends = {"coordinates": ["arms"], "tolerance": 0.05, "velocity": 0.05}
    changed["stages"] = [
        {**settle, "target": BESIDE, "ends_when": ends},
        take,
        fold,
        {**fly, "target": FOLDED, "ends_when": ends},
    ]
    return changed


@cache
def turned_by_wheels() -> Run:
    """A free-flyer in space flies with thrusters, turns by torque alone, and floats while its arm moves."""
    base = {"position": [0.05, 0, 0], "attitude": {"rpy": [0, 0, "10 deg"]}}
    stages = [
        {
            "name": "fly",
            "skill": "fly",
            "target": {"base": base, "arm": [0, 0.5, -0.5]},
            "ends_when": {"coordinates": ["base"], "tolerance": 0.02},
        },
        {
            "name": "turn",
            "skill": "fly",
            "mobility": "attitude",
            "target": {"base": {**base, "attitude": {"rpy": [0, 0, "25 deg"]}}, "arm": [0, 0.8, -0.2]},
            "ends_when": {"coordinates": ["base.rx", "base.ry", "base.rz"], "tolerance": 0.02},
        },
        {
            "name": "reach",
            "skill": "reach",
            "target": {"arm": [0.3, 0.3, -0.8]},
            "ends_when": {"coordinates": ["arm"], "tolerance": 0.02},
        },
    ]
    weights = {"base": [100, 100, 100, 10, 10, 10], "arm": [10, 10, 10], "control": 1}
    task = {
        "robot": "free_flyer_arm",
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0.5, -0.5]},
        "controller": {"nodes": 10},
        "plant": {"kind": "rk4", "low_level_rate": 500},
        "skills": {
            "fly": {"space": "joint", "weights": weights},
            "reach": {"space": "joint", "mobility": "free-floating", "weights": {"arm": [10, 10, 10], "control": 1}},
        },
        "stages": stages,
        "log": {"ticks": True, "shares": False},
        "time_limit": 30,
    }
    return simulate(load_task(task))


@cache
def taken_in_space(plant: str, step: float | None = None) -> Run:
    """A small free-flyer with its hand at an object takes it and moves its arm, while nothing pushes or turns it."""
    hand = load_robot("free_flyer_arm").poses(np.array([0, 0, 0, 1, 0, 0, 0, 0, 0.5, -0.5]))[1]
    at = np.array([-0.1, 0, 0.05, 1, 0, 0, 0])
    centre = SPACE.composed(hand, SPACE.relative(SPACE.neutral, at))
    pose = {"position": centre[:3].tolist(), "attitude": {"quaternion": centre[3:].tolist()}}
    stages = [
        {
            "name": "take",
            "skill": "grasp",
            "target": {"arm": {"object": "arm"}},
            "ends_when": {"coordinates": ["arm.x", "arm.y", "arm.z"], "tolerance": 5e-3},
        },
        {
            "name": "fold",
            "skill": "fold",
            "target": {"arm": [0.2, 0.8, -0.8]},
            "ends_when": {"coordinates": ["arm"], "tolerance": 0.02},
        },
    ]
    task = {
        "robot": "free_flyer_arm",
        "mobility": "free-floating",
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0.5, -0.5]},
        "controller": {"nodes": 10},
        "plant": {"kind": plant, "low_level_rate": 500, **({} if step is None else {"step": step})},
        "skills": {
            "grasp": {"space": "task", "weights": {"arm": [10, 10, 10, 0, 0, 0], "control": 1}},
            "fold": {"space": "joint", "weights": {"arm": [10, 10, 10], "control": 1}},
        },
        "stages": stages,
        "object": {
            "shape": [0.2, 0.1, 0.1],
            "pose": pose,
            "mass": 2,
            "inertia": [0.003, 0.008, 0.008],
            "motion": {"linear": [0.004, 0.002, -0.003], "angular": [0.01, 0.02, -0.01]},
            "taken_by": "take",
            "grasp": {
                "at": {"arm": {"position": at[:3].tolist(), "attitude": {"quaternion": at[3:].tolist()}}},
                "envelope": {"position": 0.01, "angle": "2 deg", "velocity": 0.05, "angular_velocity": "10 deg"},
                "stiffness": [200, 2],
                "known": True,
            },
        },
        "log": {"ticks": True, "shares": False},
        "time_limit": 20,
    }
    return simulate(load_task(task))


def ticks_within(run: Run, stage: int) -> np.ndarray:
    """Tell which ticks of a run are in a stage, none of a switch among them."""
    begins, ends = run.stages["switch_time"][[stage - 1, stage]]
    times = run["ticks/time"]
    return np.asarray((times > begins + 0.005) & (times < ends - 0.005))


def samples_within(run: Run, stage: int) -> np.ndarray:
    """Tell which samples of a run begin and end in a stage, after grippers have come to rest."""
    begins, ends = run.stages["switch_time"][[stage - 1, stage]]
    return np.asarray((run.time >= begins) & (run.time + 0.1 <= ends))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mobility", "kept", "plant"), [("free-floating", 3, "rk4"), ("free-floating", 3, "mujoco"), ("attitude", 2, "rk4")]
)
def test_momentum_is_kept_where_nothing_pushes(mobility: str, kept: int, plant: str) -> None:
    """With empty hands, and with the object in them, whose grasps give: what nothing pushes, or turns, has no force."""
    run = taken_while_floating(mobility, plant)
    assert run.summary().succeeded
    n = run.problem.model.n
    for stage in (1, 2):
        ticks = ticks_within(run, stage)
        assert ticks.sum() > 300
        assert (run["ticks/F"][ticks][:, :kept] == 0).all()
        assert np.abs(run["ticks/F"][ticks]).max() > 0.1
    free = ticks_within(run, 1)
    momentum = run.problem.model.balance(run["ticks/Q"][free], run["ticks/Qdot"][free])[:, :kept]
    assert np.ptp(momentum, axis=0).max() < 1e-9
    held = samples_within(run, 2)
    assert np.ptp(run["balance/momentum"][held], axis=0).max() < 1e-7
    assert np.abs(run["deviation/Q"][samples_within(run, 1)][:, : n - 6]).max() < 1e-3
    assert np.abs(run["deviation/Q"][held][:, : n - 6]).max() < 1e-3


@pytest.mark.slow
def test_what_nothing_pushes_or_turns_keeps_its_momentum_in_space() -> None:
    """Linear momentum while a torque turns the base, all of it while nothing does."""
    run = turned_by_wheels()
    assert run.summary().succeeded
    for stage, kept in ((1, 3), (2, 6)):
        ticks = ticks_within(run, stage)
        assert ticks.sum() > 200
        assert (run["ticks/F"][ticks][:, :kept] == 0).all()
        momentum = run.problem.model.balance(run["ticks/Q"][ticks], run["ticks/Qdot"][ticks])[:, :6]
        assert np.ptp(momentum[:, :kept], axis=0).max() < 1e-9
        assert np.abs(run["deviation/Q"][samples_within(run, stage)][:, :6]).max() < 1e-3
        if kept == 3:
            assert np.ptp(momentum[:, 3:], axis=0).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_a_fixed_base_takes_an_object(plant: str) -> None:
    """The mount bears what hands and object do to the base; MuJoCo does not say its force."""
    run = taken_while_floating("fixed", plant)
    assert run.summary().succeeded
    assert (run["ticks/Q"][:, :3] == 0).all()
    assert np.ptp(run["balance/energy"]) < 1e-7
    if plant == "rk4":
        assert np.ptp(run["balance/momentum"], axis=0).max() < 1e-7


@pytest.mark.slow
def test_velocities_do_not_jump_where_thrusters_are_switched() -> None:
    """Beside grippers that close: from tick to tick they change by what limits of acceleration allow."""
    run = taken_while_floating("free-floating", "rk4")
    change = np.abs(np.diff(run["ticks/Qdot"], axis=0))
    closing = run.stages["switch_time"][1]
    before = run["ticks/time"][1:] < closing - 0.005
    tick = 1 / 500
    assert change[before][:, 3:].max() <= 0.5 * tick * 1.01
    assert change[before][:, :3].max() <= 0.5 * tick * 1.01


@pytest.mark.slow
def test_the_error_of_the_momentum_falls_with_the_fourth_power_of_the_step() -> None:
    """Robot and held object, under the same commands, with steps of a tick and of half a tick."""
    runs = (
        taken_while_floating("free-floating", "rk4"),
        taken_while_floating("free-floating", "rk4", 1e-3),
    )
    errors = [np.ptp(run["balance/momentum"][samples_within(run, 2)], axis=0).max() for run in runs]
    assert errors[1] < errors[0] / 8 or errors[0] < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_momentum_with_a_held_object_is_kept_in_space(plant: str) -> None:
    """Of robot and object, which brings some of its own: no force on the base, and the balance stays within 1e-7."""
    run = taken_in_space(plant)
    summary = run.summary()
    assert summary.succeeded
    assert run["grasp/closed"][-1].all()
    held = samples_within(run, 1)
    assert held.sum() > 15
    assert (run["ticks/F"][ticks_within(run, 1)][:, :6] == 0).all()
    assert np.abs(np.diff(run["ticks/Q"][ticks_within(run, 1)][:, 7:], axis=0)).max() > 1e-4
    assert np.ptp(run["balance/momentum"][held], axis=0).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_its_error_falls_with_the_fourth_power_of_the_step(plant: str) -> None:
    """With steps of a tick and of half a tick: by 16, to a quarter."""
    coarse, fine = (
        np.ptp(run["balance/momentum"][samples_within(run, 1)], axis=0).max()
        for run in (taken_in_space(plant), taken_in_space(plant, 1e-3))
    )
    assert coarse / fine == pytest.approx(16, rel=0.25)


@pytest.mark.slow
def test_the_summary_says_what_became_of_momentum_and_base_where_it_floats() -> None:
    """A blow of 0.5 N s after the first quarter of a second; then nothing."""
    blow = {"uncertainty": {"impulse": {"at": 0.25, "linear": [0.3, 0.4], "angular": 0.1}}}
    run = simulate(load_task("float_and_reach", {"time_limit": 1.0, **blow}))
    (floating,) = run.summary().floating
    assert floating.name == "reach"
    assert floating.linear == pytest.approx(0.5, abs=1e-6)
    moved = run["state/Q"][-1, :3] - run["state/Q"][0, :3]
    assert floating.distance == pytest.approx(np.linalg.norm(moved[:2]))
    assert floating.angle == pytest.approx(abs(moved[2])) and floating.angle > 1e-3
    (row,) = [text for name, text in measure_rows(run.summary()) if name.endswith("where it floats")]
    assert row.startswith("reach: 0.5000 N s, ") and row.endswith(" deg")
    undisturbed = simulate(load_task("float_and_reach", {"time_limit": 0.3}))
    assert undisturbed.summary().floating[0].linear < 1e-9
    flying = simulate(load_task("thrust_and_reach", {"time_limit": 0.2}))
    assert flying.summary().floating == ()
