"""Closed loops in stages that avoid plumes: what does not fire, what is logged of it, and that nothing else changes."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.figures.instants import plot_thrusters
from psmpc_cli.logs.run import Run
from psmpc_cli.report.texts import measure_rows
from psmpc_cli.simulation.replay import replay, rerun
from psmpc_cli.simulation.run import simulate

from ..plumed import AHEAD, FOLDED, before_a_panel, robot_in

pytestmark = pytest.mark.slow

THRUSTERS = ("thruster_3", "thruster_4")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return simulate(before_a_panel(tmp_path_factory.mktemp("robot")))


def test_a_thruster_that_points_at_the_panel_does_not_fire_and_the_mission_succeeds(run: Run) -> None:
    """Those beside it brake. With `ignored` these two do."""
    assert run.summary().succeeded
    shut = run["thrusters/shut"]
    assert (shut[:, AHEAD] == 1).mean() > 0.4
    assert not np.delete(shut, AHEAD, axis=1).any()
    fires = run["ticks/thrust"].reshape(len(run.time), 100, -1) > 0
    assert not (fires & (shut > 0)[:, None]).any()
    assert fires[..., 8:].any() and fires[..., :2].any()


def test_without_the_key_those_thrusters_brake(run: Run, tmp_path: Path) -> None:
    ignored = simulate(before_a_panel(tmp_path, plumes=None))
    assert ignored["thrusters/impulse"][:, AHEAD].sum() > 10
    assert "thrusters/shut" not in ignored
    assert ignored.summary().thrusters.shut is None
    assert ignored.summary().duration <= run.summary().duration


def test_a_plume_alone_changes_nothing_to_the_last_bit(tmp_path: Path) -> None:
    """Nor does a stage that avoids them where nothing ever reaches anything, but for how plans are bounded."""
    for folder in ("with", "without"):
        (tmp_path / folder).mkdir()
    short = {"time_limit": 1.0, "plumes": None}
    with_plumes = simulate(before_a_panel(tmp_path, robot_in(tmp_path / "with"), **short))
    without = simulate(before_a_panel(tmp_path, robot_in(tmp_path / "without", plume=None), **short))
    np.testing.assert_array_equal(with_plumes.u, without.u)
    np.testing.assert_array_equal(with_plumes["ticks/thrust"], without["ticks/thrust"])
    far = {"obstacles": [{"name": "panel", "shape": {"sphere": 0.1}, "pose": [50, 0, 0]}]}
    looked_at = simulate(before_a_panel(tmp_path, robot_in(tmp_path / "with"), **{**short, **far, "plumes": "avoided"}))
    np.testing.assert_allclose(looked_at.u, without.u, atol=1e-9)
    assert not looked_at["thrusters/shut"].any()


def test_a_run_repeats_and_its_windows_are_read_from_its_log(run: Run) -> None:
    again = rerun(run)
    assert again is not None and again.differences == ()
    assert replay(run, len(run.time) // 2).largest == 0.0


def test_summary_and_figure_say_which_thrusters_were_shut(run: Run, tmp_path: Path) -> None:
    (row,) = [text for name, text in measure_rows(run.summary()) if name == "thrusters shut because of plumes"]
    assert all(f"{name} for " in row for name in THRUSTERS) and row.count(" for ") == 2
    shut = run.summary().thrusters.shut
    assert set(shut) == set(THRUSTERS)
    assert shut["thruster_3"] == pytest.approx(0.1 * run["thrusters/shut"][:, 2].sum())
    figure = plot_thrusters(run)
    axes = figure.axes[1]
    assert "grey: shut because of its plume" in axes.get_title()
    widths = [bar.get_facecolor()[:3] for bar in axes.patches]
    assert widths.count((0.85, 0.85, 0.85)) == int((run["thrusters/shut"] > 0).sum())


@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_thrusters_are_shut_from_the_tick_on_at_which_a_stage_begins_that_avoids_plumes(
    tmp_path: Path, plant: str
) -> None:
    """In the middle of a sample; in the stage before they fire on."""
    brake = {
        "name": "brake",
        "skill": "move",
        "target": {"base": [0.8, 0, 0], **FOLDED},
        "at": 0.55,
    }
    stay = {**brake, "name": "stay", "plumes": "avoided", "ends_when": {"coordinates": "base", "tolerance": 0.01}}
    del stay["at"]
    task = before_a_panel(
        tmp_path,
        plumes=None,
        plant=plant,
        stages=[brake, stay],
        initial={"base": [0.8, 0, 0], **FOLDED},
        initial_velocity={"base": [0.25, 0, 0]},
        time_limit=1.5,
        controller={"horizon": 4, "nodes": 20},
    )
    run = simulate(task)
    thrust = run["ticks/thrust"][:, AHEAD]
    switch = round(run.stages["switch_time"][0] * 1e3)
    assert switch == 550
    assert thrust[:switch].any() and not thrust[switch:].any()
    np.testing.assert_allclose(run["thrusters/shut"][5, AHEAD], 0.5, atol=0.011)
    assert (run["thrusters/shut"][6:, AHEAD] == 1).all() and not run["thrusters/shut"][:5].any()
    assert run.summary().momentum_error < 1e-9


def test_commands_that_come_late_shut_thrusters_when_they_act(tmp_path: Path) -> None:
    task = before_a_panel(
        tmp_path,
        uncertainty={"delay": "0.13 s"},
        controller={"horizon": 8, "nodes": 20, "delay": "0.13 s"},
    )
    run = simulate(task)
    assert run.summary().succeeded
    shut = np.repeat(run["thrusters/shut"], 100, axis=0)
    assert not ((run["ticks/thrust"] > 0) & (shut == 1)).any()
    assert (shut[:, AHEAD] == 1).any()
