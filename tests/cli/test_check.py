from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from psmpc_cli.cli.check import check
from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_robot, load_task

TASK, ROBOT = load_task("transport").task_yaml, load_robot("planar_dual_arm").robot_yaml


def run(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(check)
    return CliRunner().invoke(app, arguments)


def test_valid_task_is_a_table() -> None:
    result = run("transport")
    assert result.exit_code == 0
    assert (
        result.stdout
        == """\
transport: On-orbit transport with four stages
robot planar_dual_arm; controller psmpc, horizon 4 s, 100 nodes a stage, sample time 0.1 s; solver sqp; plant rk4
stage          part   target                       ends within  distance of reach  not before
approach       base   -2, 2 m, 30 deg              0.002                           9.99 s
move (joint)   arm_1  0, 0, 0 deg
priority 1     arm_2  0, 0, 0 deg
capture        base   -2, 2 m, 30 deg              0.002                           9.99 s
reach (task)   arm_1  -1.9334, 3.1677 m, 165 deg   0.002        1.036 of 1.200 m
priority 100   arm_2  -3.0446, 2.5261 m, -105 deg  0.002        1.036 of 1.200 m
transport      base   0, 0 m, 0 deg                0.002                           19.97 s
move (joint)   arm_1  45, 45, 60 deg
priority 1     arm_2  -45, -45, -60 deg
release        base   0, 0 m, 0 deg                0.05                            19.97 s
reach (task)   arm_1  1.5, 0 m, 0 deg              0.05         1.200 of 1.200 m
priority 0.01  arm_2  -1.5, 0 m, 0 deg             0.05         1.200 of 1.200 m

"""
    )


def test_valid_robot_is_a_table() -> None:
    result = run("planar_dual_arm")
    assert result.exit_code == 0
    assert (
        result.stdout
        == """\
planar_dual_arm
part   mount                  mass [kg]  inertia [kg m^2]  a + b [m]
base                          30         1.35
arm_1  at 0.3, 0 m, 0 deg     4.2        0.35              0.25 + 0.25
                              4.2        0.35              0.25 + 0.25
                              2          0.0267            0.1 + 0.1
arm_2  at -0.3, 0 m, 180 deg  4.2        0.35              0.25 + 0.25
                              4.2        0.35              0.25 + 0.25
                              2          0.0267            0.1 + 0.1

coordinate  position         velocity             acceleration
base.x      -5 to 5 m        -0.2 to 0.2 m/s
base.y      -5 to 5 m        -0.2 to 0.2 m/s
base.theta  -180 to 180 deg  -0.2 to 0.2 rad/s
arm_1.1     -90 to 90 deg    -0.15 to 0.15 rad/s
arm_1.2     -180 to 180 deg  -0.15 to 0.15 rad/s
arm_1.3     -180 to 180 deg  -0.15 to 0.15 rad/s
arm_2.1     -90 to 90 deg    -0.15 to 0.15 rad/s
arm_2.2     -180 to 180 deg  -0.15 to 0.15 rad/s
arm_2.3     -180 to 180 deg  -0.15 to 0.15 rad/s

"""
    )


def test_comparisons_and_trajectories_are_in_the_table() -> None:
    result = run("tracking", "--set", "priorities.compare=[[trace, unfold, 90], [trace, stow, 100], [unfold, stow, 1]]")
    assert result.exit_code == 0
    lines = [line.split() for line in result.stdout.splitlines()]
    assert "priorities from 3 comparisons: consistency ratio 0.0012, acceptable up to 0.1" in result.stdout.splitlines()
    assert ["trace", "base", "to", "0.8,", "0", "m,", "0", "deg", "0.01", "21.16", "s"] in lines
    assert "priority 93.217    arm_2  to -0.062, 0.933 m, -90 deg  0.01         1.089 of 1.200 m" in result.stdout
    assert ["follows", "16", "s"] in lines


def test_comparisons_without_redundancy_tell_nothing_of_consistency() -> None:
    assert "priorities from 2 comparisons: no more than they need, so nothing tells" in run("tracking").stdout


def test_fixed_time_dwell_and_partial_conditions_are_in_the_table(tmp_path: Path) -> None:
    path = tmp_path / "t.yaml"
    text = TASK.replace("ends_when: {coordinates: [base], tolerance: 2e-3}", "at: 12\n    dwell: 2", 1)
    text = text.replace("{coordinates: [base], tolerance: 2e-3}", "{coordinates: [base.x, arm_1], velocity: 0.01}", 1)
    path.write_text(text.replace("name: approach", 'name: "[bold]approach"').replace("approach:", "'[bold]approach':"))
    with pytest.raises(SpecError, match="expected a name"):
        raise run(str(path)).exception or AssertionError
    path.write_text(text)
    lines = [line.split() for line in run(str(path)).stdout.splitlines()]
    assert ["approach", "base", "-2,", "2", "m,", "30", "deg", "at", "12", "s", "12", "s"] in lines
    assert ["at", "least", "2", "s"] in lines
    assert ["transport", "base", "0,", "0", "m,", "0", "deg", "0.003,", "-,", "-", "(0.01/s)", "21.97", "s"] in lines
    assert ["move", "(joint)", "arm_1", "45,", "45,", "60", "deg", "0.003", "(0.01/s)"] in lines


def test_problems_of_all_files_come_together_after_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(TASK.replace("priority: 100", "priority: -3"))
    Path("robot.yaml").write_text(ROBOT.replace("mass: 30", "mass: 0"))
    Path("far.yaml").write_text(TASK.replace("base: [-2, 2, 30 deg]", "base: [-2, -2, 30 deg]"))
    result = run("bad.yaml", "transport", "robot.yaml", "far.yaml", "nowhere")
    assert isinstance(result.exception, SpecError)
    assert result.exception.exit_code == 2
    assert result.stdout.startswith("transport: ")
    heads = [line.split(" found")[0] for line in str(result.exception).splitlines() if line[0] != " "]
    assert heads == [
        "bad.yaml:21:15: stages[1].priority:",
        "robot.yaml:4:14: base.mass:",
        "far.yaml:22:45: stages[1].target.arm_1:",
        "far.yaml:22:80: stages[1].target.arm_2:",
        "nowhere:",
    ]


def test_remark_is_printed_but_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("odd.yaml").write_text(TASK.replace("base: [-2, 2, 30 deg]", "base: [-2, -2, 30 deg]", 1))
    result = run("odd.yaml")
    assert result.exit_code == 0
    assert "probably not meant:\nodd.yaml:22:20: stages[1].target.base: found the base 4 m from where" in result.stdout
