from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.figures.registry import FIGURES, figures_of
from psmpc_cli.logs.comparison import compare_runs
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.report.pages import report_run
from psmpc_cli.report.texts import describe_mission
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.simulation.verify import Verification
from psmpc_cli.specs.load import Task, parse_task

from ..free_flyer import turning
from ..short_runs import TASK

TRANSPORT = psmpc.load_task("transport", {"controller.nodes": 8, "time_limit": 1.0, "log.ticks": True})
THERE_AND_BACK = parse_task(TASK, TRANSPORT.robot_yaml, "there and back")


def recorded(task: Task, with_ticks: bool = False, longest: float = np.inf) -> psmpc.Run:
    """Record a loop of one's own over the plant of a task, until the controller is done or to a time [s]."""
    experiment = build_experiment(task)
    controller = experiment.controller
    recorder = psmpc.Recorder(controller)
    x = experiment.initial_state
    time = 0.0
    while True:
        command = controller.step(time, psmpc.State.of(x))
        if controller.done or time >= longest - 1e-9:
            recorder.add(command)
            return recorder.run(f"time limit of {longest:g} s reached")
        ticks = experiment.plant.advance(time, x, Setpoints(command.u, closed=command.closed))
        recorder.add(command, ticks if with_ticks else None)
        x = ticks.states[-1]
        time = len(recorder) * task.spec.controller.sample_time


@pytest.mark.parametrize(
    "task", [TRANSPORT, turning(30, "controller.nodes=6", "time_limit=0.5")], ids=["plane", "space"]
)
def test_a_loop_with_ticks_is_recorded_as_simulate_records_it(task: Task) -> None:
    own = recorded(task, with_ticks=True, longest=task.spec.time_limit)
    comparison = compare_runs(psmpc.simulate(task), own)
    assert [each.path for each in comparison.differences] == []
    assert own.attributes["plant"] == "own loop"


CLEAR = {"obstacles": [{"name": "post", "shape": {"sphere": 0.1}, "pose": [1.9, 0.6, 0]}], "clearance": {}}


@pytest.mark.slow
def test_without_ticks_nobody_knows_whether_something_touched() -> None:
    task = psmpc.load_task("transport", {"controller.nodes": 8, "time_limit": 0.5, **CLEAR})
    for with_ticks, held in ((True, True), (False, False)):
        (check, _) = recorded(task, with_ticks, longest=0.5).summary().monitors
        assert (check.name, check.held, np.isfinite(check.margin)) == ("nothing touched", held, held)
        assert np.isnan(check.broken_at)


def test_a_loop_that_gives_commands_alone_lacks_what_only_ticks_tell() -> None:
    own = recorded(TRANSPORT, longest=1.0)
    simulated = psmpc.simulate(TRANSPORT)
    known = (
        "time",
        "state/Q",
        "state/Qdot",
        "control/u",
        "pose/xi",
        "window/instants",
        "window/presence",
        "window/share",
    )
    for path in (*known, "stages/actual_start", "final/end_time", "final/Q", "effort/control"):
        np.testing.assert_array_equal(own[path], simulated[path], err_msg=path)
    # a sample ends at the time of the next command, and of its last tick: a sum of other terms, equal to rounding
    np.testing.assert_allclose(own["deviation/Q"], simulated["deviation/Q"], rtol=0, atol=1e-14)
    for path in ("force/F", "effort/base_force", "balance/momentum"):
        assert np.isnan(own[path]).all()
    assert "ticks/time" not in own
    assert set(figures_of("run", simulated)) - set(figures_of("run", own)) == {"forces"}
    with pytest.raises(psmpc.InputError, match="found no figure 'forces'"):
        psmpc.plot(own, "forces")


@pytest.mark.slow
def test_a_mission_is_shown_saved_and_read_back(tmp_path: Path) -> None:
    run = recorded(THERE_AND_BACK)
    assert run.attributes["finished"]
    assert run.summary().succeeded
    assert np.isfinite(run.stages["switch_time"]).all()
    path = tmp_path / "own.h5"
    run.save(path)
    assert compare_runs(run, psmpc.read_run(path)).differences == ()
    assert psmpc.view(path).html == psmpc.view(run).html
    assert FIGURES["run"]["forces"].caption not in report_run(run).html
    for name in figures_of("run", run):
        assert psmpc.plot(run, name).axes


def test_a_loop_whose_forces_are_not_known_is_verified_by_its_plans() -> None:
    task = parse_task(TASK, TRANSPORT.robot_yaml, "there and back", ["log.ticks=true"])
    controller = psmpc.Controller(task)
    recorder = psmpc.Recorder(controller)
    n = controller.problem.model.n
    Q = np.zeros((1, n))
    v = np.zeros((1, n))
    while not controller.done:
        time = len(recorder) * task.spec.controller.sample_time
        command = controller.step(time, psmpc.State(Q[-1], v[-1]))
        Q, v = command.plan.chart.from_chart(command.plan.states_at(command.edges))
        forces = np.full(command.u.shape, np.nan)
        recorder.add(command, psmpc.Ticks(time=command.edges, states=np.hstack([Q, v]), F=forces))
    run = recorder.run()
    assert np.isnan(run.ticks["F"]).all()
    assert Verification(run).samples == len(run.time)


def test_a_run_ends_where_its_last_stage_does() -> None:
    task = THERE_AND_BACK
    controller = psmpc.Controller(task)
    recorder = psmpc.Recorder(controller)
    state = psmpc.State(np.zeros(controller.problem.model.n), np.zeros(controller.problem.model.n))
    after = 0
    while after < 3:
        command = controller.step(len(recorder) * task.spec.controller.sample_time, state)
        recorder.add(command)
        Q, v = command.plan.chart.from_chart(command.plan.states_at(command.edges[-1:]))
        state = psmpc.State(Q[0], v[0])
        after += controller.done
    run = recorder.run()
    assert run.attributes["end_reason"] == "back met its end condition"
    assert len(run.time) == len(recorder) - 3


def test_what_becomes_of_an_object_with_a_mass_is_not_judged() -> None:
    task = psmpc.load_task("catch_drifting", {"controller.nodes": 8})
    controller = psmpc.Controller(task)
    recorder = psmpc.Recorder(controller)
    model = controller.problem.model
    for sample in range(3):
        state = psmpc.State(model.neutral, np.zeros(model.n))
        recorder.add(controller.step(0.1 * sample, state, np.array(task.spec.object.pose)))
    run = recorder.run("tried")
    assert "object/pose" not in run
    checks = run.summary().monitors
    assert [(each.held, np.isnan(each.margin)) for each in checks] == [(False, True)] * len(checks)
    assert run.attributes["end_reason"] == "tried"
    completed = replace(run, attributes={**run.attributes, "finished": True})
    assert describe_mission(completed.summary()).startswith("Mission not judged: tried")


def test_a_wrong_command_is_an_error_and_is_not_recorded() -> None:
    controller = psmpc.Controller(TRANSPORT)
    recorder = psmpc.Recorder(controller)
    n = controller.problem.model.n
    with pytest.raises(psmpc.InputError, match="found no command, expected at least one"):
        recorder.run()
    command = controller.step(0.0, psmpc.State(np.zeros(n), np.zeros(n)))
    other = psmpc.Controller(TRANSPORT).step(0.0, psmpc.State(np.zeros(n), np.zeros(n)))
    ticks = psmpc.Ticks(time=np.zeros(3), states=np.zeros((3, 2 * n)), F=np.zeros((2, n)))
    of_sample = psmpc.Ticks(time=command.edges, states=np.zeros((101, 2 * n)), F=np.zeros((100, n)))
    cut = replace(of_sample, commanded=np.zeros((2, n)))
    backwards = replace(of_sample, time=command.edges[::-1])
    later = replace(of_sample, time=command.edges + 1.0)
    with_gain = replace(of_sample, impulse_and_work=np.zeros(3))
    in_words = replace(of_sample, impulse_and_work="much")
    for wrong, message in (
        ((other,), "command: found .*expected one of <Controller psmpc for transport"),
        ((3,), "command: found 3, expected a Command"),
        ((command, 3), "ticks: found 3"),
        ((command, ticks), r"ticks.time: found an array \(3,\).*numbers \(101,\)"),
        ((command, backwards), r"ticks.time: found 0.1 s to 0 s, expected ascending times from 0 s on"),
        ((command, later), r"ticks.time: found 1 s to 1.1 s, expected ascending times from 0 s on"),
        ((command, with_gain), r"ticks.impulse_and_work: found an array \(3,\).*numbers \(4,\)"),
        ((command, in_words), r"ticks.impulse_and_work: found the text \"much\", expected numbers \(4,\)"),
        ((command, cut), r"ticks.commanded: found an array \(2, 9\).*numbers \(100, 9\)"),
    ):
        with pytest.raises(psmpc.InputError, match=message):
            recorder.add(*wrong)
    recorder.add(command)
    with pytest.raises(psmpc.InputError, match="found 0 s after 0 s, expected a later one"):
        recorder.add(command)
    assert repr(recorder) == "<Recorder of transport: 1 command>"
    with pytest.raises(psmpc.InputError, match=r"controller: found .*expected a Controller"):
        psmpc.Recorder(TRANSPORT)


def test_what_a_controller_hands_out_is_read_only() -> None:
    controller = psmpc.Controller(TRANSPORT)
    n = controller.problem.model.n
    command = controller.step(0.0, psmpc.State(np.zeros(n), np.zeros(n)))
    for array in (command.state, command.u, command.edges, command.plan.X, command.plan.u, command.solution.plan.X):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_ticks_that_were_added_can_be_written_to_again() -> None:
    """A loop may use the same arrays at every sample."""
    controller = psmpc.Controller(TRANSPORT)
    recorder = psmpc.Recorder(controller)
    n = controller.problem.model.n
    command = controller.step(0.0, psmpc.State(np.zeros(n), np.zeros(n)))
    X = np.zeros((101, 2 * n))
    impulse_and_work = np.zeros(4)
    recorder.add(
        command, psmpc.Ticks(time=command.edges, states=X, F=np.zeros((100, n)), impulse_and_work=impulse_and_work)
    )
    X[:] = 7.0
    impulse_and_work[:] = 7.0
    run = recorder.run()
    assert not run.ticks["Q"].any()
    assert X.flags.writeable and impulse_and_work.flags.writeable
