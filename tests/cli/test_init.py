from pathlib import Path

import typer
from typer.testing import CliRunner, Result

from psmpc_cli.cli.init import init
from psmpc_cli.errors import InputError
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import load_robot, load_task


def run(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(init)
    return CliRunner().invoke(app, arguments)


def test_every_built_in_is_copied_and_loads_to_the_same(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "project"
    result = run(str(folder))
    assert result.exit_code == 0
    assert sorted(result.stdout.split()) == sorted(str(path) for path in folder.rglob("*") if path.is_file())
    for name in built_ins("task"):
        copied = load_task(folder / "tasks" / f"{name}.yaml")
        assert copied.spec.model_copy(update={"robot": "planar_dual_arm"}) == load_task(name).spec
        assert copied.robot == load_task(name).robot
    for name in built_ins("robot"):
        assert load_robot(folder / "robots" / f"{name}.yaml").spec == load_robot(name).spec


def test_copied_task_uses_the_copied_robot(tmp_path: Path) -> None:
    run(str(tmp_path))
    robot = tmp_path / "robots" / "planar_dual_arm.yaml"
    robot.write_text(robot.read_text().replace("mass: 30", "mass: 60"))
    assert load_task(tmp_path / "tasks" / "transport.yaml").robot.base.mass == 60


def test_mode_line_leads_to_the_copied_schema(tmp_path: Path) -> None:
    run(str(tmp_path))
    for path in (*tmp_path.glob("robots/*.yaml"), *tmp_path.glob("tasks/*.yaml")):
        mode = path.read_text().splitlines()[0]
        assert (path.parent / mode.partition("$schema=")[2]).resolve().is_file()


def test_nothing_is_overwritten_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "tasks").mkdir()
    mine = tmp_path / "tasks" / "transport.yaml"
    mine.write_text("mine")
    result = run(str(tmp_path))
    assert isinstance(result.exception, InputError)
    assert str(result.exception) == f"found {mine}, expected no such file (--force overwrites)"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]
    assert mine.read_text() == "mine"
    assert run(str(tmp_path), "--force").exit_code == 0
    assert load_task(mine).spec.name == "transport"


def test_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = run(str(tmp_path / "file"))
    assert isinstance(result.exception, InputError)
    assert "found no place to write to (" in str(result.exception)
