"""Closed loops of robots with reaction wheels: limits, balances, what is logged, and that a run repeats."""

from pathlib import Path

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.figures.registry import RUN, figures_of
from psmpc_cli.logs.comparison import compare_runs
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.constraints import node_rows
from psmpc_cli.ocp.window import window_numbers, window_shape
from psmpc_cli.plant.adaptive import AdaptiveDynamics
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.report.texts import measure_rows
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.simulation.replay import logged_solve, replay, rerun
from psmpc_cli.simulation.run import build_experiment, simulate
from psmpc_cli.simulation.verify import Verification
from psmpc_cli.specs.load import Task, load_task, parse_task

from ..wheeled import PYRAMID, changing_in, planar_in, robot_in, spatial_in

LOGGED = {"log": {"ticks": True, "plans": True, "shares": False}}
TIGHT = {"planar": {"torque": 0.2, "momentum": 0.95}, "spatial": {"torque": 0.02, "momentum": 0.08, "initial": 0.05}}


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return simulate(planar_in(tmp_path_factory.mktemp("planar"), LOGGED, **TIGHT["planar"]))


@pytest.fixture(scope="module")
def spatial(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return simulate(spatial_in(tmp_path_factory.mktemp("spatial"), LOGGED, **TIGHT["spatial"]))


@pytest.fixture(scope="module")
def changing(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return simulate(changing_in(tmp_path_factory.mktemp("changing"), LOGGED, unloading=0.004))


RUNS = pytest.mark.parametrize(
    "name", ["planar", *(pytest.param(name, marks=pytest.mark.slow) for name in ("spatial", "changing"))]
)


@RUNS
def test_momentum_of_bodies_and_wheels_balances(name: str, request: pytest.FixtureRequest) -> None:
    run: Run = request.getfixturevalue(name)
    assert run.summary().succeeded
    assert np.abs(run["balance/momentum"]).max() < 1e-9
    assert np.abs(run["balance/energy"]).max() < 1e-9
    assert not run["events/solve_failed"].any()
    turned_by_wheels = [stage.moved_by.is_turned and not stage.moved_by.is_pushed for stage in run.problem.stages]
    without_thrusters = np.array(turned_by_wheels)[run["window/first"]]
    assert without_thrusters.any()
    assert run["effort/base_torque"][without_thrusters][:-1].max() < 1e-15 or name == "changing"


def test_the_wheel_of_the_platform_turns_it_within_its_limits_and_no_thruster_fires() -> None:
    """By 15 degrees and back to rest, though the arms unfold on one side; the wheel stores nothing in the end."""
    folded = {"arm_1": ["60 deg", "-110 deg", "-40 deg"], "arm_2": ["-60 deg", "110 deg", "40 deg"]}
    opened = {**folded, "arm_1": ["40 deg", "-60 deg", "-20 deg"]}
    stage = {
        "name": "turn",
        "skill": "turn",
        "target": {"base": [0, 0, "15 deg"], **opened},
        "ends_when": {"coordinates": ["base.theta", "arms"], "tolerance": 0.01, "velocity": 2e-3},
    }
    weights = {"base": [0, 0, 100], "arms": [10, 10, 10], "control": 0.3}
    task = load_task(
        {
            "robot": "wheeled_platform",
            "mobility": "attitude",
            "initial": {"base": [0, 0, 0], **folded},
            "controller": {"nodes": 15, "horizon": 6},
            "plant": {"low_level_rate": 200},
            "skills": {"turn": {"space": "joint", "weights": weights}},
            "stages": [stage],
            "time_limit": 30,
            **LOGGED,
        }
    )
    run = simulate(task)
    assert run.summary().succeeded
    wheels = Wheels.of(run.problem.model.spec)
    stored = np.abs(run["ticks/wheel_momentum"]) / wheels.momentum
    assert 0.5 < stored.max() <= 1.01
    assert 0.5 < (np.abs(run["ticks/motor_torque"]) / wheels.torque).max() <= 1
    assert stored[-1] < 0.1
    assert "thrusters/firings" not in run
    momentum = run.problem.model.momentum(run["ticks/Q"], run["ticks/Qdot"])
    assert np.abs(momentum[:, :2]).max() < 1e-9
    np.testing.assert_allclose(momentum[:, 2:], -run["ticks/wheel_momentum"], atol=1e-9)


@RUNS
def test_the_closed_loop_is_verified_with_what_wheels_store(name: str, request: pytest.FixtureRequest) -> None:
    """In space they act on the motion: integrated without them it is another one, in the plane it is not."""
    run: Run = request.getfixturevalue(name)
    verification = Verification(run, every=10)
    assert verification.samples == len(run.time)
    assert verification.remarks == ()
    assert verification.loop["plant"].value < 1e-9
    assert verification.horizons["velocity"].value < 1e-7  # as of robots without wheels
    ticks = slice(0, 100)
    n = run.problem.model.n
    times = run["ticks/time"][0] + np.arange(101) / run.task.spec.plant.low_level_rate
    start = np.concatenate([run["ticks/Q"][0], run["ticks/Qdot"][0]])
    empty = AdaptiveDynamics(run.problem.model).integrate("force", start, times, run["ticks/F"][ticks])
    off = np.abs(empty.between_pieces[-1][-n:] - run["ticks/Qdot"][100]).max()
    assert (off < 1e-9) == (name == "planar")


def test_a_spatial_loop_without_its_ticks_is_left_out(tmp_path: Path) -> None:
    """Plans are verified all the same."""
    run = simulate(spatial_in(tmp_path, {"time_limit": 0.3, "log": {"ticks": False, "shares": False}}))
    verification = Verification(run)
    assert (verification.count, verification.samples) == (3, 0)
    assert "without what wheels store at its ticks" in verification.remarks[0]


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_limits_that_bind_are_kept_at_every_tick(name: str, request: pytest.FixtureRequest) -> None:
    """And the robot moves as planned, but where a plan passes a limit a little between its nodes."""
    run: Run = request.getfixturevalue(name)
    wheels = Wheels.of(run.problem.model.spec)
    h = np.abs(run["ticks/wheel_momentum"]) / wheels.momentum
    torque = np.abs(run["ticks/motor_torque"]) / wheels.torque
    assert h.max() <= 1.0 + 1e-12
    assert torque.max() <= 1.0
    assert h.max() > 0.99
    assert torque.max() > 1 - 1e-6
    assert np.abs(run["deviation/Qdot"]).max() < 5e-3
    assert np.median(np.abs(run["deviation/Qdot"]).max(axis=1)) < 2e-5


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_a_plan_knows_what_wheels_store(name: str, request: pytest.FixtureRequest) -> None:
    """At the nodes that it passes until the next samples, from its state there and from that of the plant alike."""
    run: Run = request.getfixturevalue(name)
    model = run.problem.model
    wheels = Wheels.of(model.spec)
    stored = np.vstack([run["ticks/wheel_momentum"], np.full((1, wheels.count), np.nan)])
    samples = [5, len(run.time) // 2, len(run.time) - 8]
    for sample in samples:
        solution = logged_solve(run, sample)
        window = solution.window
        (rows, *_) = (rows for rows in node_rows(model, window_shape(window)) if rows.name.startswith("wheels"))
        argument = np.asarray(rows.argument(window_numbers(window, solution.plan.switch_times)))
        most = rows.bounds(window)[1]
        ticks = np.arange(100 * sample, 100 * sample + 400, 100)
        X = window.chart.states_in_chart(np.hstack([run["ticks/Q"][ticks], run["ticks/Qdot"][ticks]]))
        (values,) = rows.functions.value(X, argument, rows=len(X))
        by_state = values / most * wheels.momentum
        np.testing.assert_allclose(by_state @ wheels.axes.T, stored[ticks] @ wheels.axes.T, rtol=0, atol=1e-9)
        (first,) = rows.functions.value(window.x0, argument)[0]
        np.testing.assert_allclose(first / most * wheels.momentum, run["wheels/momentum"][sample], rtol=0, atol=1e-9)


@RUNS
def test_a_run_repeats_from_its_log_to_the_last_bit(name: str, request: pytest.FixtureRequest) -> None:
    run: Run = request.getfixturevalue(name)
    again = rerun(run)
    assert again is not None
    assert again.differences == ()
    for sample in (0, len(run.time) // 2):
        assert replay(run, sample).largest == 0.0


def recorded(task: Task, samples: int, with_ticks: bool) -> Run:
    """A loop of one's own over the plant of a task."""
    experiment = build_experiment(task)
    drive = experiment.drive
    assert drive is not None
    recorder = psmpc.Recorder(experiment.controller)
    x = experiment.initial_state
    for sample in range(samples + 1):
        command = experiment.controller.step(0.1 * sample, psmpc.State.of(x, drive.momentum))
        if sample == samples:
            recorder.add(command)
            break
        ticks = experiment.plant.advance(0.1 * sample, x, Setpoints(command.u))
        recorder.add(command, ticks if with_ticks else None)
        x = ticks.states[-1]
    return recorder.run(f"time limit of {0.1 * samples:g} s reached")


@pytest.mark.slow
def test_a_loop_of_ones_own_is_recorded_as_simulate_records_it(tmp_path: Path) -> None:
    task = spatial_in(tmp_path, {"time_limit": 0.6, "log.ticks": True})
    simulated = simulate(task)
    with_ticks = recorded(task, 6, with_ticks=True)
    assert compare_runs(simulated, with_ticks).differences == ()
    without = recorded(task, 6, with_ticks=False)
    np.testing.assert_array_equal(without["wheels/momentum"], simulated["wheels/momentum"])
    assert np.isnan(without["wheels/torque"]).all()


def test_summary_and_figure(planar: Run) -> None:
    summary = planar.summary()
    assert summary.wheels is not None and summary.wheels.momentum is not None and summary.wheels.torque is not None
    wheels = Wheels.of(planar.problem.model.spec)
    assert summary.wheels.momentum.value == (np.abs(planar["wheels/momentum"]) / wheels.momentum).max()
    assert summary.wheels.torque.value == pytest.approx(1.0, abs=1e-6)
    rows = dict(measure_rows(summary))
    assert rows["largest momentum of a wheel, of its limit"] == (
        f"{summary.wheels.momentum.where}: {100 * summary.wheels.momentum.value:.1f} % at "
        f"{summary.wheels.momentum.time:.1f} s"
    )
    assert "wheels" in figures_of(RUN, planar)
    figure = psmpc.plot(planar, "wheels")
    above, below = (axes for axes in figure.axes if axes.get_lines())
    for axes, quantity in ((above, "momentum"), (below, "torque")):
        drawn = [line.get_ydata() for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
        np.testing.assert_array_equal(np.array(drawn, dtype=float).T, planar[f"wheels/{quantity}"])


def test_a_plant_without_forces_has_no_wheels(tmp_path: Path) -> None:
    robot = str(robot_in(tmp_path, "free_flyer_arm", PYRAMID))
    run = simulate(psmpc.load_task("fly_and_point", {"robot": robot, "time_limit": 0.2, "plant": "ideal"}))
    assert "wheels/momentum" not in run
    assert run.summary().wheels is None
    assert "wheels" not in figures_of(RUN, run)


THRUSTERS = [
    {"position": place, "direction": direction, "force": 1.0, "shortest_pulse": 0.01}
    for place, direction in (
        ([0, 0.15, 0], [1, 0, 0]),
        ([0, -0.15, 0], [1, 0, 0]),
        ([0, 0.15, 0], [-1, 0, 0]),
        ([0, -0.15, 0], [-1, 0, 0]),
        ([0, 0, 0.15], [0, 1, 0]),
        ([0, 0, -0.15], [0, 1, 0]),
        ([0, 0, 0.15], [0, -1, 0]),
        ([0, 0, -0.15], [0, -1, 0]),
        ([0.15, 0, 0], [0, 0, 1]),
        ([-0.15, 0, 0], [0, 0, 1]),
        ([0.15, 0, 0], [0, 0, -1]),
        ([-0.15, 0, 0], [0, 0, -1]),
    )
]
"""Twelve, in pairs that push along an axis and turn about another."""


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_thrusters_in_pulses_and_wheels_take_turns(tmp_path: Path, plant: str) -> None:
    """Thrusters fire in stages in which they push the base, also against what unloads wheels, and nothing is lost."""
    changed = {**LOGGED, "plant": {"kind": plant}}
    task = changing_in(tmp_path, changed, unloading=0.004)
    robot = robot_in(
        tmp_path, "free_flyer_arm", tuple({**wheel, "unloading": 0.004} for wheel in PYRAMID), thrusters=THRUSTERS
    )
    run = simulate(parse_task(task.task_yaml, robot.read_text(), "thrusters and wheels"))
    assert run.summary().succeeded
    assert np.abs(run["balance/momentum"]).max() < 1e-9
    pushed = np.array([stage.moved_by.is_pushed for stage in run.problem.stages])[run["window/first"]]
    fires = run["thrusters/impulse"].sum(axis=1) > 0
    assert fires[pushed].mean() > 0.5
    assert not fires[~pushed][1:-1].any()
    if plant == "rk4":
        again = rerun(run)
        assert again is not None and again.differences == ()
