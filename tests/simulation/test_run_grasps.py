"""Missions whose grippers miss an object or lose it: they end, or the sequence returns to an earlier stage."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.figures.coordinates import plot_errors, plot_states
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.report.texts import describe_mission, measure_rows, stage_rows
from psmpc_cli.report.view import view
from psmpc_cli.simulation.recorder import Recorder
from psmpc_cli.simulation.replay import continue_run, replay, rerun
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.verify import Verification
from psmpc_cli.specs.robots.robot import stack

from ..near_captures import AGAIN, UNKNOWN_DRIFT, near_capture

MISSED = "arm_1 and arm_2 missed the object at the end of capture, at 0.0 s"
WEAK = {"object.grasp.strength": {"pull": 1.0, "filter": 0.1}}


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An object that is missed once and taken at the second try, up to some time later."""
    task = near_capture(UNKNOWN_DRIFT, AGAIN, {"time_limit": 4})
    return simulate(task, tmp_path_factory.mktemp("again") / "again.h5")


def test_a_missed_object_ends_the_mission_unless_it_is_to_go_on() -> None:
    task = near_capture(UNKNOWN_DRIFT, {"time_limit": 0.5})
    ended = simulate(task)
    assert (ended.final["time"], ended.attributes["stuck"]) == (0.1, False)
    assert describe_mission(ended.summary()).startswith(f"Mission failed: {MISSED}")
    flown = simulate(task, keep_going=True)
    assert (flown.final["time"], flown.attributes["end_reason"]) == (0.5, "time limit of 0.5 s reached")
    for run in (ended, flown):
        assert "events/missed" not in run
        comparison = rerun(run)
        assert comparison is not None and not comparison.differences


@pytest.mark.parametrize("delay", ["0.2 s", 0])
def test_a_delay_of_commands_makes_no_miss(delay: str | int) -> None:
    """Grippers that have not yet been told to close report nothing, known or not to the controller."""
    delays = {"controller.delay": delay, "uncertainty.delay": "0.2 s"}
    missed = simulate(near_capture(UNKNOWN_DRIFT, delays))
    assert missed.final["time"] == pytest.approx(0.3)
    run = simulate(near_capture({**delays, "time_limit": 1.0}))
    assert run["grasp/closed"][-1].all()
    assert run.attributes["end_reason"] == "time limit of 1 s reached"


def test_the_sequence_returns_and_the_object_is_taken(again: Run) -> None:
    first = again["window/first"]
    (sample,) = np.flatnonzero(again["events/returned"])
    assert (again.time[sample], first[sample - 1], first[sample]) == (0.1, 1, 0)
    np.testing.assert_array_equal(again["events/missed"], again["events/returned"])
    assert again["grasp/closed"][-1].all()
    assert (again["grasp/closed_at"] > 0.2).all()
    summary = again.summary()
    assert summary.returned_at == (0.1,)
    assert {verdict.name: verdict.held for verdict in summary.monitors}["object taken"]
    assert dict(measure_rows(summary))["grasp tried again"] == "1 time: at 0.1 s"
    assert [stage.tries for stage in summary.stages] == [2] * 4
    headings, rows = stage_rows(summary)
    assert {row[headings.index("try")] for row in rows} == {"2 of 2"}


def test_stages_that_come_again_have_several_spans_and_the_times_of_the_last(again: Run) -> None:
    spans = again.spans
    assert [span.name for span in spans] == ["capture", "approach", "capture", "transport"]
    assert [span.start for span in spans[1:]] == [span.end for span in spans[:-1]]
    assert spans[0].end == 0.1
    times = {span.name: span.end for span in spans[1:3]}
    assert times == dict(zip(again.stage_names[:2], again.stages["switch_time"][:2], strict=True))
    assert [index for index, _ in again.switches] == [0, 1, 0, 1]
    approach = again.summary().stages[0]
    assert (approach.actual_start, approach.duration) == (0.1, pytest.approx(spans[1].end - 0.1))


def test_figures_and_pages_show_a_stage_again(again: Run, tmp_path: Path) -> None:
    for plot in (plot_states, plot_errors):
        strip = plot(again).axes[0]
        assert [text.get_text() for text in strip.texts].count("capture") == 2
    page = view(again).save(tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count('"start":') >= 4


def test_windows_before_and_after_a_return_are_replayed(again: Run) -> None:
    (sample,) = np.flatnonzero(again["events/returned"])
    for each in (sample - 1, sample, sample + 1):
        assert replay(again, int(each)).largest == 0.0
    assert not again["solver/warm"][sample]


@pytest.mark.slow
def test_a_log_with_a_return_is_repeated_completed_and_verified(again: Run, tmp_path: Path) -> None:
    comparison = rerun(again)
    assert comparison is not None and not comparison.differences

    def interrupt(sample: object) -> None:
        if getattr(sample, "number", 0) == 8:
            raise KeyboardInterrupt

    part = simulate(again.task, tmp_path / "part.h5", interrupt)
    assert part.interrupted
    continued = continue_run(part)
    assert continued is not None and not continued.differences
    np.testing.assert_array_equal(read_run(tmp_path / "part.h5").time, again.time)
    assert Verification(again, every=10).horizons["position"].value < 1e-3


def test_the_mission_ends_when_all_tries_are_used_up() -> None:
    tight = {"object.grasp.envelope.velocity": 1e-9}
    run = simulate(near_capture(AGAIN, tight))
    summary = run.summary()
    assert len(summary.returned_at) == 2
    assert summary.reason.startswith("arm_1 and arm_2 missed the object at the end of capture")
    assert summary.reason.endswith("in the last of 3 tries")


def test_a_capture_that_takes_too_long_is_tried_again() -> None:
    never = {"stages.capture.ends_when.tolerance": 1e-9, "time_limit": 3}
    retry = {"stages.capture.if_missed": {"back_to": "approach", "times": 1, "timeout": "0.5 s"}}
    run = simulate(near_capture(never, retry))
    summary = run.summary()
    (returned_at,) = summary.returned_at
    first = run.spans[0]
    assert (first.name, first.start) == ("capture", pytest.approx(0, abs=0.1))
    assert first.end == returned_at == pytest.approx(first.start + 0.5, abs=0.1)
    assert summary.reason.startswith("arm_1 and arm_2 did not take the object before the timeout of capture, at ")
    assert summary.reason.endswith("in the last of 2 tries")
    assert not run["grasp/closed"].any()
    comparison = rerun(run)
    assert comparison is not None and not comparison.differences


def test_a_lost_object_ends_the_mission_or_is_taken_again() -> None:
    lost = simulate(near_capture(WEAK))
    assert "lost the object in transport" in lost.attributes["end_reason"]
    task = near_capture(WEAK, {"stages.transport.if_missed": {"back_to": "capture"}})
    run = simulate(task)
    (returned_at,) = run.summary().returned_at
    first = run["window/first"][np.searchsorted(run.time, returned_at - 1e-9) :]
    assert first[0] == 1
    assert run.summary().reason.endswith("in the last of 2 tries")
    assert [stage.tries for stage in run.summary().stages] == [1, 2, 2, 2]
    assert not run["grasp/closed"][int(np.flatnonzero(run["events/returned"])[0])].any()


def test_grippers_of_a_partial_grasp_open_at_once() -> None:
    """In a loop of one's own, whose grippers report: one closed, the other missed."""
    task = near_capture(AGAIN)
    controller = Controller(task)
    recorder = Recorder(controller)
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    pose = np.array(task.spec.body.pose)
    recorder.add(controller.step(0.0, state, pose, {}))
    back = controller.step(0.1, state, pose, {"arm_1": True, "arm_2": False})
    recorder.add(back)
    assert {"missed", "returned"} <= back.events
    assert (back.stage.name, back.closed.any(), controller.failure) == ("approach", False, "")
    stale = controller.step(0.2, state, pose, {"arm_1": False, "arm_2": False})
    recorder.add(stale)
    assert "missed" not in stale.events
    assert recorder.run().summary().returned_at == (0.1,)


def test_a_loop_of_ones_own_says_that_its_mission_has_failed() -> None:
    task = near_capture()
    controller = Controller(task)
    recorder = Recorder(controller)
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    for sample, holding in enumerate([{}, {"arm_1": True}, {"arm_1": True, "arm_2": True}, {"arm_2": np.bool_(False)}]):
        assert controller.failure == ""
        recorder.add(controller.step(0.1 * sample, state, np.array(task.spec.body.pose), holding))
    assert controller.failure == "arm_2 lost the object in transport, at 0.3 s"
    assert not controller.done
    assert recorder.run().attributes["end_reason"] == controller.failure
