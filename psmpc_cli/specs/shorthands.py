"""Shorter ways to write a mapping: its `kind` alone, or numbers by part side by side with its other keys."""

from collections.abc import Mapping
from typing import Any

from pydantic import GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from psmpc_cli.specs.robot import Spec


class Choice(Spec):
    """A part of a task with a `kind`; the kind alone stands for it with all else at its default."""

    @model_validator(mode="before")
    @classmethod
    def _kind_alone(cls, value: object) -> object:
        return {"kind": value} if isinstance(value, str) else value

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Allow the kind alone."""
        mapping = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"enum": mapping["properties"]["kind"]["enum"]}, mapping]}


class SideBySide(Spec):
    """A model whose field `parts` is not written: its keys stand side by side with the other fields."""

    @model_validator(mode="before")
    @classmethod
    def _gather_parts(cls, value: object) -> object:
        if not isinstance(value, Mapping) or isinstance(value.get("parts"), Mapping):
            return value
        others = [key for key in cls.model_fields if key != "parts" and key in value]
        parts = {key: item for key, item in value.items() if key not in others}
        return {"parts": parts, **{key: value[key] for key in others}}

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Write the parts side by side with the other fields."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        others = {key: item for key, item in schema["properties"].items() if key != "parts"}
        required = [key for key in schema.get("required", ()) if key != "parts"]
        kept: dict[str, Any] = {"type": "object", "description": schema["description"], "properties": others}
        parts = {"additionalProperties": schema["properties"]["parts"]["additionalProperties"]}
        return {**kept, **({"required": required} if required else {}), **parts}
