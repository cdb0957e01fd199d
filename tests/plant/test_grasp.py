"""Robot, object and the grasps between them: laws of physics, both plants against each other, and what grippers do."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from psmpc_cli.control import Controller, State
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.errors import InputError
from psmpc_cli.plant import Setpoints, Ticks, build_plant
from psmpc_cli.plant.grasp import Capture, CapturePlant, build_capture
from psmpc_cli.plant.rk4 import Rk4CapturePlant
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task, load_robot, load_task
from psmpc_cli.specs.object import GRASP_LOADS
from psmpc_cli.specs.robots.robot import stack

from .drawn_grasps import drawn_grasp

Array = np.ndarray


M, TICK = 100, 1e-3


FREE = {"object.grasp.strength": None, "object.grasp.known": False}


KNOWN = {**FREE, "object.grasp.known": True}


def planar(set: dict[str, Any]) -> Task:
    """The transport task with the robot where Capture leads it."""
    start = {"base": [-2, 2, "30 deg"], "arm_1": ["45 deg", "30 deg", "60 deg"]}
    start["arm_2"] = ["-45 deg", "-30 deg", "-60 deg"]
    return load_task("transport_grasp", {"initial": start, **set})


def spatial(set: dict[str, Any]) -> Task:
    """A servicer of two arms with an object that it holds off its centre."""
    robot = model_of("dual_arm_servicer")
    Q = np.r_[robot.neutral[:7], 0.4 * np.sin(np.arange(robot.n - 6))]
    xi, pose = robot.poses(Q), [0.6, 0.1, 0.2, *Q[3:7]]
    arms = dict(zip(list(robot.pose_rows)[1:], xi[1:], strict=True))
    at = {arm: as_pose(robot.space.relative(tip, pose)) for arm, tip in arms.items()}
    body = {"mass": 12.0, "inertia": [1.0, 1.4, 0.8], "motion": {"linear": [0, 0.004, 0], "angular": [0.01, 0, 0.02]}}
    envelope = {"position": 0.1, "angle": 1, "velocity": 0.1, "angular_velocity": 1}
    grasp = {"at": at, "envelope": envelope, "stiffness": [1e4, 1e3]}
    initial = {"base": as_pose(Q[:7]), **{arm: Q[7:][rows].tolist() for arm, rows in joints(robot).items()}}
    target_object = {"shape": [1, 1, 1], "pose": as_pose(np.array(pose)), **body, "grasp": grasp}
    stages = [
        {"name": name, "skill": "move", "target": initial, "ends_when": {"coordinates": "all", "tolerance": 1}}
        for name in ("take", "let")
    ]
    return load_task(
        {
            "robot": "dual_arm_servicer",
            "initial": initial,
            "skills": {"move": {"space": "joint", "weights": {"base": [1] * 6, "arms": [1] * 7}}},
            "stages": stages,
            "object": {**target_object, "taken_by": "take"},
            "plant": {"kind": "rk4", "step": 2e-4},
        },
        set,
    )


@cache
def model_of(robot: str) -> RobotModel:
    return RobotModel(load_robot(robot))


def joints(robot: Any) -> dict[str, slice]:
    return {arm: slice(rows.start - 6, rows.stop - 6) for arm, rows in list(robot.parts.items())[1:]}


def as_pose(numbers: Array) -> dict[str, Any]:
    return {"position": numbers[:3].tolist(), "attitude": {"quaternion": numbers[3:].tolist()}}


def run(task: Task, samples: int = 3, push: float = 1.0, wanted: Array | None = None) -> tuple[list[Ticks], Capture]:
    """Advance a plant whose robot is accelerated at random, its grippers to be closed from the sixth tick on."""
    model = model_of(task.robot.name)
    capture = build_capture(task.spec, model)
    assert capture is not None
    plant = build_plant(task.spec.plant, model, False, None, capture)
    assert isinstance(plant, CapturePlant | Rk4CapturePlant)
    random = np.random.default_rng(4)
    x, made = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)], []
    closed = np.arange(samples * M) >= 5 if wanted is None else wanted
    for k in range(samples):
        u = push * random.uniform(-0.2, 0.2, model.n) * np.ones((M, 1))
        made.append(plant.advance(k * M * TICK, x, Setpoints(u, closed=closed[k * M : (k + 1) * M])))
        x = made[-1].states[-1]
    return made, capture


def kept(task: Task, capture: Capture, x: Array, target_object: Array) -> Array:
    """Momentum and energy of robot and object."""
    model, size = model_of(task.robot.name), capture.law.object_sizes[0]
    Q, v, pose, rate = x[: model.nq], x[model.nq :], target_object[:size], target_object[size:]
    own = np.r_[model.momentum(Q, v), model.kinetic_energy(Q, v)]
    return np.asarray(own + np.r_[capture.body.momentum(pose, rate), capture.body.kinetic_energy(rate)])


BOTH = pytest.mark.parametrize("make", [planar, pytest.param(spatial, marks=pytest.mark.slow)])


@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
@pytest.mark.parametrize("grasp", [FREE, KNOWN])
@BOTH
def test_momentum_and_energy_are_kept(make: Any, plant: str, grasp: dict[str, Any]) -> None:
    task = make({"plant.kind": plant, **grasp})
    made, capture = run(task)
    first, last = made[0], made[-1]
    assert first.target_object is not None and last.target_object is not None and last.target_object.closed.all()
    states = ((first.states[0], first.target_object, 0), (last.states[-1], last.target_object, -1))
    before, after = (kept(task, capture, x, np.r_[o.pose[k], o.v[k]]) for x, o, k in states)
    impulse_and_work = sum(ticks.impulse_and_work for ticks in made)
    assert np.abs(after - before - impulse_and_work)[:-1].max() < 1e-7
    assert abs(after - before - impulse_and_work)[-1] < 1e-6


@BOTH
def test_plants_agree(make: Any) -> None:
    (one, _), (other, _) = (run(make({"plant.kind": plant, **FREE})) for plant in ("rk4", "mujoco"))
    assert one[-1].target_object is not None and other[-1].target_object is not None
    assert one[-1].target_object.pose == pytest.approx(other[-1].target_object.pose, abs=1e-8)
    assert one[-1].target_object.load == pytest.approx(other[-1].target_object.load, abs=1e-5)
    assert one[-1].states[-1] == pytest.approx(other[-1].states[-1], abs=1e-7)


@pytest.mark.parametrize("seed", [2, 4])
def test_plants_agree_on_a_robot_with_rotors(tmp_path: Path, seed: int) -> None:
    """To the rounding errors of 50 ticks: forces are up to 1e3 N."""
    task, x = drawn_grasp(seed, tmp_path, geared=True)
    model = RobotModel(task.robot)
    u = 0.2 * np.sin(np.arange(model.n)) * np.ones((50, 1))
    made = []
    for kind in ("rk4", "mujoco"):
        plant = build_plant(
            task.spec.plant.model_copy(update={"kind": kind}), model, False, None, build_capture(task.spec, model)
        )
        made.append(plant.advance(0.0, x, Setpoints(u, closed=np.ones(50, bool))))
    one, other = made
    assert one.target_object is not None and other.target_object is not None
    assert one.target_object.closed.all() and one.target_object.load.max() > 0.1
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-11)
    np.testing.assert_allclose(one.target_object.load, other.target_object.load, rtol=0, atol=1e-8)


@BOTH
def test_what_a_grasp_gives_to_the_robot_it_takes_from_the_object(make: Any) -> None:
    task = make(FREE)
    made, capture = run(task, samples=1)
    target_object, model, size = made[0].target_object, model_of(task.robot.name), capture.law.object_sizes[0]
    assert target_object is not None
    robot = [model.momentum(made[0].states[k, : model.nq], made[0].states[k, model.nq :]) for k in (0, -1)]
    body = [np.array(capture.body.momentum(target_object.pose[k], target_object.v[k])) for k in (0, -1)]
    assert np.abs(body[1] - body[0]).max() > 1e-3  # it was pulled
    assert robot[1] - robot[0] - made[0].impulse_and_work[:-1] == pytest.approx(-(body[1] - body[0]), abs=1e-9)
    assert size == len(target_object.pose[0])


def test_knowing_the_load_moves_the_robot_as_commanded() -> None:
    """An acceleration of the robot as one body, which does not strain the object; grasps stiff, or their give shows."""
    apart = []
    for set in (FREE, KNOWN):
        task = planar({**set, "object.grasp.stiffness": [1e6, 1e4], "plant.step": 2e-4})
        model, u = model_of(task.robot.name), np.zeros((300, 9))
        u[:, :2] = 0.2, -0.1
        capture = build_capture(task.spec, model)
        plant = build_plant(task.spec.plant, model, False, None, capture)
        x = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
        ticks = plant.advance(0.0, x, Setpoints(u, closed=np.ones(300, bool)))
        apart.append(np.abs(ticks.states[-1, model.nq :] - 0.3 * u[0]).max())
    assert apart[1] < 1e-4 < 0.1 < apart[0]


@pytest.mark.parametrize(
    ("pose", "measure"),
    [([-2.489, 2.858, "30 deg"], 0), ([-2.489, 2.847, "33 deg"], 1)],
)
def test_gripper_outside_its_envelope_stays_open_and_says_by_how_much(pose: list[Any], measure: int) -> None:
    task = planar({"object.pose": pose, "object.grasp.envelope.position": 0.01 if measure == 0 else 1.0})
    made, capture = run(task, samples=1)
    assert made[0].target_object is not None
    events = made[0].target_object.events
    assert [event.what for event in events] == ["missed", "missed"] and {event.time for event in events} == {0.005}
    wanted = (0.011, np.radians(3))[measure]
    assert [event.values[measure] for event in events] == pytest.approx([wanted] * 2, rel=0.1)
    assert not capture.closed.any() and not made[0].target_object.wrench.any()


def test_moving_object_is_outside_the_envelope_of_velocity() -> None:
    task = planar({"object.motion": {"linear": [0.06, 0], "angular": "12 deg"}})
    made, _ = run(task, samples=1)
    assert made[0].target_object is not None
    for event in made[0].target_object.events:
        assert event.what == "missed" and event.values[2] > 0.05
        assert event.values[3] == pytest.approx(np.radians(12), rel=0.02)


def test_grippers_let_go_and_the_object_flies_on() -> None:
    wanted = np.arange(2 * M) < 150
    made, capture = run(planar(FREE), samples=2, wanted=wanted)
    target_object = made[1].target_object
    assert target_object is not None and [event.what for event in target_object.events] == ["let go", "let go"]
    assert target_object.events[0].time == pytest.approx(0.15) and not capture.closed.any()
    assert np.ptp(target_object.v[51:], axis=0).max() == 0 and np.abs(target_object.v[-1]).max() > 1e-3


@pytest.mark.parametrize(("load", "largest"), [("pull", 0.3), ("shear", 0.3), ("moment", 0.03)])
def test_grasp_that_is_loaded_beyond_its_strength_is_lost(load: str, largest: float) -> None:
    strength = {"object.grasp.strength": {load: largest, "filter": 0.05}}
    made, _ = run(planar(strength), samples=5, push=3.0)
    which = list(GRASP_LOADS).index(load)
    flown = [ticks.target_object for ticks in made if ticks.target_object is not None]
    lost = [event for target_object in flown for event in target_object.events if event.what == "lost"]
    assert lost and all(largest < event.values[which] < 2 * largest for event in lost)
    loads, closed = (
        np.concatenate([getattr(target_object, name) for target_object in flown]) for name in ("load", "closed")
    )
    assert (loads[closed][:, which] <= largest).all() and closed.any(axis=1).sum() > 10


@pytest.mark.parametrize("strength", [None, {"pull": 0.3, "filter": 0.05}], ids=["kept", "lost"])
def test_ticks_in_one_call_are_those_in_a_call_each(strength: dict[str, float] | None) -> None:
    """Grippers close, may lose the object, and open within the sample."""
    task = planar({**KNOWN, "object.grasp.strength": strength})
    model = model_of(task.robot.name)
    start = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
    u = 0.6 * np.random.default_rng(4).uniform(-1, 1, (1, model.n)).repeat(3 * M, axis=0)
    wanted = (np.arange(len(u)) >= 5) & (np.arange(len(u)) < 250)

    def advanced(count: int) -> list[Array]:
        capture = build_capture(task.spec, model)
        plant = build_plant(task.spec.plant, model, False, None, capture)
        x = start
        made = list[tuple[Array, ...]]()
        events = list[object]()
        for k in range(0, len(u), count):
            ticks = plant.advance(k * TICK, x, Setpoints(u[k : k + count], closed=wanted[k : k + count]))
            flown = ticks.target_object
            assert flown is not None
            x = ticks.states[-1]
            made.append((ticks.states[1:], ticks.F, flown.pose[1:], flown.wrench, flown.load, flown.closed))
            events += [(event.gripper, event.what, round(event.time, 9)) for event in flown.events]
        assert {what for _, what, _ in events} == {"closed", "lost" if strength else "let go"}
        return [np.concatenate(column) for column in zip(*made, strict=True)]

    for together, each in zip(advanced(len(u)), advanced(1), strict=True):
        np.testing.assert_allclose(together, each, rtol=0, atol=1e-13)


@BOTH
def test_loads_are_the_parts_of_the_wrench_that_a_gripper_puts_on_the_object(make: Any) -> None:
    made, capture = run(make(FREE), samples=3)
    target_object = made[-1].target_object
    assert target_object is not None
    law = capture.law
    d = law.model.dimension
    inside = capture.parameters[:, : law.object_sizes[0]]
    pose = target_object.pose[-2]
    Q, v = np.split(made[-1].states[-2], [law.model.nq])
    *_, loads = law.forces(Q, v, pose, target_object.v[-2], capture.parameters.ravel())
    for i, wrench in enumerate(target_object.wrench[-1]):
        at = law.space.composed(pose, inside[i])[:d] - pose[:d]
        outwards = at / np.linalg.norm(at)
        pull = wrench[:d] @ outwards
        across = wrench[:d] - pull * outwards
        raw = [pull, np.linalg.norm(across), np.linalg.norm(wrench[d:])]
        assert loads.full()[:, i] == pytest.approx(raw, abs=1e-9)


DRAWN = 25
"""Grasps without gears, and as many with them."""


@pytest.mark.slow
@pytest.mark.parametrize("geared", [False, True])
def test_no_grasp_that_is_accepted_diverges(tmp_path: Path, geared: bool) -> None:
    """From velocities up to 0.02 m/s, in another posture than the one that is judged; rates of light links rise."""
    accepted = 0
    for seed in range(DRAWN):
        task, x = drawn_grasp(seed, tmp_path, geared)
        model = RobotModel(task.robot)
        try:
            capture = build_capture(task.spec, model)
        except InputError:
            continue
        accepted += 1
        plant = build_plant(task.spec.plant, model, False, None, capture)
        ticks = plant.advance(0.0, x, Setpoints(np.zeros((150, model.n)), closed=np.ones(150, bool)))
        assert capture is not None and capture.closed.all()
        assert np.abs(ticks.states[:, model.nq :]).max() < 5, seed
    assert accepted > DRAWN / 2


def test_grasps_too_stiff_for_the_step_are_rejected() -> None:
    with pytest.raises(InputError, match=r"stiffness: found a step of 0.001 s, expected at most .* plant.step"):
        run(planar({**FREE, "object.grasp.stiffness": [1e9, 1e2]}))


@pytest.mark.parametrize("known", [True, False])
def test_a_commands_force_counts_a_known_load_in(known: bool) -> None:
    """At the tick of closing it is what the plant applies, but for the pose recorded then, some mm from the task's."""
    task = planar({**FREE, "object.grasp.known": known, "controller.nodes": 12})
    controller, model = Controller(task), model_of(task.robot.name)
    controller.memory = replace(controller.memory, sequence=MovingSequence.of(2, 0.0))
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n))
    command = controller.step(0.0, state)
    plant = build_plant(task.spec.plant, model, False, None, build_capture(task.spec, model))
    applied = plant.advance(0.0, state.vector, Setpoints(command.u[:1], closed=command.closed[:1])).F[0]
    bare = model.inverse_dynamics(state.Q, state.v, command.u[0])
    assert np.abs(command.force(0.0, state) - applied).max() <= 0.02 * np.abs(applied - bare).max()
    assert bool(np.abs(applied - bare).max() > 1.0) == known


@pytest.mark.parametrize("armature", [0.0, 0.3])
def test_the_largest_ratio_of_one_gripper_is_that_of_the_mass_matrices(armature: float) -> None:
    """An object whose centre is in the gripper is what `InertialParameters` hold: H_loaded v = (1 + rho) H v."""
    spec = load_robot("planar_dual_arm")
    model = RobotModel(spec.model_copy(update={"armature": {"arms": (armature,) * 3}}))
    capture = load_task("transport_grasp").spec.body
    grasp = capture.grasp.model_copy(update={"at": {"arm_1": (0.0, 0.0, 0.0)}})
    Q = np.sin(np.arange(9.0))
    ratio, v = HeldLoad(model, FreeBody(7.0, [0.4]), grasp).largest_ratio(Q)
    H = model.mass_matrix(Q)
    loaded = model.mass_matrix(Q, model.nominal.holding(np.array([7.0, 0.0]), np.array([0.4, 0.0])))
    assert ratio == pytest.approx(eigh(loaded - H, H, eigvals_only=True)[-1], rel=1e-9)
    np.testing.assert_allclose(loaded @ v, (1 + ratio) * H @ v, rtol=0, atol=1e-9 * np.abs(loaded @ v).max())
    assert v @ H @ v == pytest.approx(1)


@BOTH
def test_a_law_that_does_not_know_its_load_accelerates_less_by_the_largest_ratio(make: Any) -> None:
    """Commanded along its motion, from rest. The grasps, 40 times as stiff as usual, swing about that for a while."""
    task = make({**FREE, "object.motion": None, "object.grasp.stiffness": [4e5, 4e4], "plant.step": 5e-5})
    model = model_of(task.robot.name)
    capture = build_capture(task.spec, model)
    assert capture is not None
    Q = stack(task.spec.initial, task.robot, "joint")
    ratio, v = HeldLoad(model, capture.body, capture.spec).largest_ratio(Q)
    plant = build_plant(task.spec.plant, model, False, None, capture)
    u = 0.05 * v / np.abs(v).max()
    ticks = plant.advance(0.0, np.r_[Q, np.zeros(model.n)], Setpoints(u * np.ones((M, 1)), closed=np.ones(M, bool)))
    impulse_and_work = ticks.states[-1, model.nq :] / (M * TICK)
    H = model.mass_matrix(Q)
    assert impulse_and_work @ H @ u == pytest.approx(u @ H @ u / (1 + ratio), rel=0.02)
