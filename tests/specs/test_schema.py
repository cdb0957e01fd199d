import json
import re
from pathlib import Path

import pytest

from psmpc_cli.specs.library import Kind, json_schema, json_schemas

COMMITTED = Path(__file__).parents[2] / "docs" / "schema"


@pytest.mark.parametrize("kind", ["robot", "task"])
def test_committed_schema_is_the_generated_one(kind: Kind) -> None:
    committed = (COMMITTED / f"{kind}.json").read_text(encoding="utf-8")
    assert json.loads(committed) == json_schema(kind), f"psmpc schema {kind} > docs/schema/{kind}.json writes it anew"


def test_both_kinds_are_keyed_by_kind() -> None:
    assert json_schemas() == {"robot": json_schema("robot"), "task": json_schema("task")}


def test_numbers_and_angles() -> None:
    robot = json_schema("robot")["$defs"]
    assert robot["Base"]["properties"]["mass"] == {"description": "mass [kg]", "exclusiveMinimum": 0, "type": "number"}
    number, text = robot["Mount"]["properties"]["angle"]["anyOf"]
    assert number == {"type": "number"}
    assert re.search(text["pattern"], "-30 deg") and not re.search(text["pattern"], "30 degrees")


def test_shorthands_are_allowed() -> None:
    task = json_schema("task")["$defs"]
    assert task["SolverSpec"]["anyOf"][0] == {"enum": ["sqp", "fatrop", "ipopt"]}
    assert task["SkillWeights"]["properties"].keys() == {"control"}
    assert task["SkillWeights"]["additionalProperties"]["type"] == "array"


def test_unknown_keys_are_not() -> None:
    task = json_schema("task")
    assert task["additionalProperties"] is False
    assert task["$defs"]["StageSpec"]["additionalProperties"] is False
