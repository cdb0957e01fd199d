"""JSON Schema of robot and task descriptions, for editors."""

from typing import Any

from psmpc_cli.specs.library import Kind
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import TaskSpec

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of one kind of description."""
    model = RobotSpec if kind == "robot" else TaskSpec
    schema = _untitled(model.model_json_schema())
    return {"$schema": DIALECT, "title": f"psmpc {kind}", **schema}


def json_schemas() -> dict[str, Any]:
    """Return the JSON Schema of both kinds, by kind."""
    return {"robot": json_schema("robot"), "task": json_schema("task")}


def _untitled(schema: Any) -> Any:
    """Return a schema without the titles that only repeat the keys."""
    if isinstance(schema, dict):
        return {
            key: _untitled(value) for key, value in schema.items() if not (key == "title" and isinstance(value, str))
        }
    return [_untitled(item) for item in schema] if isinstance(schema, list) else schema
