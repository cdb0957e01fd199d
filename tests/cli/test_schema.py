import json

import pytest
import typer
from typer.testing import CliRunner, Result

from psmpc_cli.cli.schema import schema
from psmpc_cli.specs.library import Kind, json_schema


def run(*arguments: str) -> Result:
    app = typer.Typer(rich_markup_mode=None)
    app.command()(schema)
    return CliRunner().invoke(app, arguments)


@pytest.mark.parametrize("kind", ["robot", "task"])
def test_one_kind(kind: Kind) -> None:
    assert json.loads(run(kind).stdout) == json_schema(kind)


def test_both_kinds_by_kind() -> None:
    assert json.loads(run().stdout) == {"robot": json_schema("robot"), "task": json_schema("task")}


def test_unknown_kind_is_met_with_the_kinds() -> None:
    result = run("plant")
    assert result.exit_code == 2
    assert "'robot', 'task'" in result.output
