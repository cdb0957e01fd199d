"""The kinds of value a description is made of: numbers, angles, names, bounds. Each says what it expected."""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    Strict,
    WithJsonSchema,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from psmpc_cli.specs.document import resolve

_ANGLE = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?) *(deg|rad|°)")

ANGLE_PATTERN = r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)? *(deg|rad|°)$"
"""`_ANGLE` as JSON Schema writes it."""


def angle(word: str) -> float | None:
    """Return the angle [rad] that a word such as `30 deg` means, or None if it is no angle."""
    match = _ANGLE.fullmatch(word)
    if match is None:
        return None
    number, unit = float(match[1]), match[2]
    return number if unit == "rad" else math.radians(number)


EXPECTED = "expected"
"""Error type of everything raised here; its message is what was expected."""

NAME_PATTERN = r"^[^\s./\\\[\]=:,]+( [^\s./\\\[\]=:,]+)*$"
"""Names appear in paths, messages, files and datasets."""

LONGEST_NAME = 60

LARGEST, SMALLEST = 1e12, 1e-12
"""Magnitude of a number, and of one that must not be 0: what is computed from them stays far from a float's range."""

LARGEST_WHOLE = 2**63 - 1
"""What a file holds of whole numbers."""

Pair = tuple[float, float]

_WITH_UNIT: dict[str, Any] = {"type": "string", "pattern": ANGLE_PATTERN}
_NUMBER_OR_ANGLE: dict[str, Any] = {"anyOf": [{"type": "number"}, _WITH_UNIT]}
_NOT_NEGATIVE: dict[str, Any] = {"anyOf": [{"type": "number", "minimum": 0}, _WITH_UNIT]}
_POSITIVE: dict[str, Any] = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, _WITH_UNIT]}
_PAIR: dict[str, Any] = {"type": "array", "items": _NUMBER_OR_ANGLE, "minItems": 2, "maxItems": 2}
_TEXT: dict[str, Any] = {"type": "string"}


def _listed(items: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a list that is not empty."""
    return {"type": "array", "items": items, "minItems": 1}


def expected(what: str) -> PydanticCustomError:
    """Return the error that says what would have been right."""
    return PydanticCustomError(EXPECTED, "{what}", {"what": what})


def number(value: object) -> float:
    """Return a finite number as float; a text or a truth value is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise expected(_a_number(value))
    if not math.isfinite(value):
        raise expected("a finite number (a float ends at 1.8e308)")
    if abs(value) > LARGEST:
        raise expected(f"a number of at most {LARGEST:g} in magnitude")
    return float(value)


def not_tiny(value: float) -> float:
    """Return a number above 0 that can be divided by."""
    if 0 < value < SMALLEST:
        raise expected(f"a number of at least {SMALLEST:g}")
    return value


def _a_number(instead_of: object) -> str:
    """Say that a number was expected, and what keeps a text from being one."""
    if not isinstance(instead_of, str):
        return "a number"
    if angle(instead_of) is not None:
        return "a number without a unit"
    return "a number" if isinstance(resolve(instead_of), bool | str | None) else "a number without quotes"


def number_or_angle(value: object) -> float:
    """Return a finite number, or an angle with its unit in rad."""
    if isinstance(value, str):
        radians = angle(value)
        if radians is None:
            raise expected(f"{_a_number(value)}, or an angle such as 30 deg")
        return number(radians)
    return number(value)


def whole(value: object) -> int:
    """Return a whole number as int."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1:
        raise expected("a whole number")
    if abs(value) > LARGEST_WHOLE:
        raise expected(f"a whole number of at most {LARGEST_WHOLE}")
    return int(value)


def intervals(value: object) -> object:
    """Return a number of intervals, or auto."""
    if value == "auto":
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1 or not 2 <= value <= 1000:
        raise expected("a whole number from 2 to 1000, or auto")
    return int(value)


def name(value: object) -> str:
    """Return a text that can be a name."""
    if not isinstance(value, str):
        raise expected("a name (in quotes if it looks like a number)")
    if len(value) > LONGEST_NAME or not value.isprintable() or not re.fullmatch(NAME_PATTERN, value):
        raise expected(f"a name of at most {LONGEST_NAME} characters without . / \\ [ ] = : , and double spaces")
    return value


def pair(value: object) -> object:
    """Return a list that may be a pair."""
    if not isinstance(value, list | tuple):
        raise expected("a pair [low, high]")
    return value


def ordered(bounds: Pair) -> Pair:
    """Return a pair (low, high) in this order."""
    if bounds[0] > bounds[1]:
        raise expected("the lower bound first, [low, high]")
    return bounds


def mirrored(value: object) -> object:
    """Return a number v as the pair (-v, v); a pair as it is."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise expected("a number, or a pair [low, high]")
    size = number_or_angle(value)
    if size < 0:
        raise expected("a number of at least 0, or a pair [low, high]")
    return 0.0 - size, size


def around_rest(bounds: Pair) -> Pair:
    """Return a pair (low, high) with 0 between them."""
    if not bounds[0] <= 0 <= bounds[1]:
        raise expected("a pair [low, high] around 0, or the robot could not rest")
    return bounds


def alone_or_list(value: object) -> object:
    """Return a list; a text alone is a list of one."""
    if not isinstance(value, str | list | tuple):
        raise expected("a name, or a list of names")
    return [value] if isinstance(value, str) else value


def number_alone_or_list(value: object) -> object:
    """Return a list; a number alone is a list of one."""
    return value if isinstance(value, list | tuple | dict) else [value]


def row(value: object) -> object:
    """Return a list that may be one row of a trajectory."""
    if not isinstance(value, list | tuple):
        raise expected("a list of numbers, one row of values for every time")
    return value


def comparison(value: object) -> object:
    """Return a list that may be a paired comparison."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise expected("a comparison [stage, stage, ratio]")
    return value


def way_of(value: object) -> str:
    """Tell a target that moves from one that stands still."""
    if not isinstance(value, Mapping):
        return "trajectory" if isinstance(value, BaseModel) else "parts"
    rows = any(isinstance(item, list | tuple) and item and isinstance(item[0], list | tuple) for item in value.values())
    return "trajectory" if "times" in value or rows else "parts"


def shape_of(value: object) -> str:
    """Tell a mapping by part from a single number."""
    return "parts" if isinstance(value, Mapping) else "number"


Number = Annotated[float, BeforeValidator(number)]
Positive = Annotated[float, Field(gt=0), BeforeValidator(number), AfterValidator(not_tiny)]
NotNegative = Annotated[float, Field(ge=0), BeforeValidator(number)]
Angle = Annotated[float, BeforeValidator(number_or_angle), WithJsonSchema(_NUMBER_OR_ANGLE)]
Whole = Annotated[int, BeforeValidator(whole)]
Intervals = Annotated[
    int | Literal["auto"],
    BeforeValidator(intervals),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 2, "maximum": 1000}, {"const": "auto"}]}),
]
Flag = Annotated[bool, Strict()]
Name = Annotated[str, BeforeValidator(name), WithJsonSchema({"type": "string", "pattern": NAME_PATTERN})]
Interval = Annotated[tuple[Angle, Angle], BeforeValidator(pair), AfterValidator(ordered), WithJsonSchema(_PAIR)]
Rate = Annotated[
    tuple[Angle, Angle],
    BeforeValidator(mirrored),
    AfterValidator(ordered),
    AfterValidator(around_rest),
    WithJsonSchema({"anyOf": [*_NOT_NEGATIVE["anyOf"], _PAIR]}),
]
Coordinates = Annotated[
    tuple[str, ...],
    Field(min_length=1),
    BeforeValidator(alone_or_list),
    WithJsonSchema({"anyOf": [_TEXT, _listed(_TEXT)]}),
]
Size = Annotated[float, Field(ge=0), BeforeValidator(number_or_angle), WithJsonSchema(_NOT_NEGATIVE)]
Width = Annotated[
    float, Field(gt=0), BeforeValidator(number_or_angle), AfterValidator(not_tiny), WithJsonSchema(_POSITIVE)
]
Widths = Annotated[
    tuple[Width, ...],
    BeforeValidator(number_alone_or_list),
    WithJsonSchema({"anyOf": [*_POSITIVE["anyOf"], _listed(_POSITIVE)]}),
]
Row = Annotated[tuple[Angle, ...], BeforeValidator(row)]
Comparison = Annotated[tuple[str, str, Positive], BeforeValidator(comparison)]


class Spec(BaseModel):
    """Frozen, strict about unknown keys; the parent of every part of a specification."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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
