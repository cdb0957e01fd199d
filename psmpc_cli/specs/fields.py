"""The kinds of value that descriptions are made of, and the base of their models: every error says what it expected."""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    Strict,
    Tag,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError

from psmpc_cli.specs.document import DECIMAL, LARGEST, Document, Fault, Location, choice, suggestion

NAME_PATTERN = r"^[^\s./\\\[\]=:,]+( [^\s./\\\[\]=:,]+)*$"
"""Names appear in paths, messages, files and datasets."""

SECONDS_PATTERN = rf"^{DECIMAL} *s$"
ANGLE_PATTERN = rf"^{DECIMAL} *(deg|rad|°)$"
LENGTH_PATTERN = rf"^{DECIMAL} *m$"
COORDINATE_PATTERN = rf"^{DECIMAL} *(m|deg|rad|°)$"

FLAW = "flaw"
"""Type of every validation error of a `Spec`; its context holds the parts of the message."""

Pair = tuple[float, float]

RuleErrors = Iterator[tuple[Location, PydanticCustomError]]
"""What is wrong inside a value, with the path from it."""

Fields = Mapping[str, Any]
"""The valid fields of a model before the one that a rule is about."""


def flaw(tail: str, found: str | None = None, at_key: bool = False) -> PydanticCustomError:
    """Create the error `found <found><tail>`; without `found` the message describes the value in the file."""
    return PydanticCustomError(FLAW, "{tail}", {"tail": tail, "found": found, "at_key": at_key})


def expected(what: str, found: str | None = None, at_key: bool = False) -> PydanticCustomError:
    """Create the error of a value that is not `what`, see `flaw`."""
    return flaw(f", expected {what}", found, at_key)


def validated_by(
    rule: Callable[[Any, Fields, Any], RuleErrors], as_written: bool = False, always: bool = False
) -> WrapValidator:
    """Create the validator of a field that applies one of our rules after pydantic has validated the value.

    It stands in the field's annotation: `Annotated[Controller, validated_by(controller_faults)]`.

    Args:
        rule: Yields the errors of the value, each with its path from the value. It is called with the value, the valid
            fields of the model before it, and the `Context`: what is known of the rest of the description.
        as_written: Whether the rule gets the value as it is written in the file, such as `30 deg`, instead of the valid
            one.
        always: Whether the rule also applies without a context, as where a model is built in Python.
    """

    def apply_rule(value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        valid = handler(value)
        flaws = rule(value if as_written else valid, info.data, info.context) if always or info.context else ()
        found: list[Any] = [{"type": error, "loc": at, "input": value} for at, error in flaws]
        if found:
            raise ValidationError.from_exception_data("rules", found)
        return valid

    return WrapValidator(apply_rule)


def _untitled(schema: dict[str, Any]) -> None:
    """Leave out of a model's JSON Schema the titles, which only repeat the keys."""
    for each in (schema, *schema["properties"].values()):
        each.pop("title", None)


class Spec(BaseModel):
    """The parent of every part of a description: frozen, and strict about unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", serialize_by_alias=True, json_schema_extra=_untitled)

    replaced_keys: ClassVar[Mapping[str, str]] = {}
    """What to write instead of keys that earlier versions had, or that are named otherwise."""

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Replace pydantic's messages by what was found and expected here."""
        try:
            return handler(value)
        except ValidationError as error:
            flaws = list(_errors_in_our_words(error.errors(include_url=False), cls))
        raise ValidationError.from_exception_data(cls.__name__, flaws)


def keys_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by their keys in a file, which some have another name for than Python allows."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _errors_in_our_words(details: list[ErrorDetails], model: type[Spec]) -> Iterator[Any]:
    """Yield pydantic's errors of a model in the words of our messages: what was found, and what was expected.

    Errors that follow from another one are left out: that a key is missing which is misspelt, and that a list is too
    short of which only wrong entries do not count.

    Args:
        details: The errors, as pydantic has them.
        model: The model that was validated.

    Yields:
        Mappings with the keys type, loc and input, from which pydantic builds a ValidationError.
    """
    keys = keys_of(model)
    unknown = [str(detail["loc"][0]) for detail in details if detail["type"] == "extra_forbidden"]
    misspelt = {suggestion(key, keys) for key in unknown}
    for detail in details:
        kind = detail["type"]
        at = detail["loc"]
        context = detail.get("ctx", {})
        value = detail["input"]
        if kind == "missing" and at[0] in misspelt:
            continue
        if kind == "too_short" and len(value) >= context["min_length"]:
            continue  # wrong entries do not count
        if kind in _EXPLANATIONS:
            error = _EXPLANATIONS[kind](detail, model)
        else:
            error = expected(_WORDINGS.get(kind, detail["msg"]).format(**context))
        yield {"type": error, "loc": at, "input": value}


def _mapping_of(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    return expected(f"a mapping ({keys_of(model)[str(detail['loc'][0])].description})")


def _mapping_with(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    return expected(f"a mapping with the keys {', '.join(keys_of(model))}")


def _unknown_key(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    key = str(detail["loc"][0])
    if key in model.replaced_keys:
        return expected(model.replaced_keys[key], "an unknown key", at_key=True)
    return flaw(choice(key, keys_of(model)), "an unknown key", at_key=True)


def _missing_key(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    key = str(detail["loc"][0])
    return expected(f"{keys_of(model)[key].description}", f'no key "{key}"', at_key=True)


def _other_choice(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    return flaw(choice(str(detail["input"]), re.findall(r"'([^']*)'", detail["ctx"]["expected"])))


def _own_flaw(detail: ErrorDetails, model: type[Spec]) -> PydanticCustomError:
    return flaw(**detail["ctx"])


_EXPLANATIONS: Mapping[str, Callable[[ErrorDetails, type[Spec]], PydanticCustomError]] = {
    FLAW: _own_flaw,
    "extra_forbidden": _unknown_key,
    "missing": _missing_key,
    "literal_error": _other_choice,
    "model_type": _mapping_with,
    "model_attributes_type": _mapping_with,
    "dict_type": _mapping_of,
    "mapping_type": _mapping_of,
}
"""What is said of an error of pydantic, by its type."""


_WORDINGS = {
    "string_type": "a text (in quotes if it looks like a number)",
    "bool_type": "true or false",
    "int_from_float": "a whole number",
    "tuple_type": "a list",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "a length of at least {min_length}",
    "string_too_short": "a text that is not empty",
}


def faults_of(error: ValidationError, document: Document) -> Iterator[Fault]:
    """Yield every error of a validation with its path in the document; its `loc` also names branches of unions."""
    for detail in error.errors(include_url=False):
        path: Location = ()
        for step in detail["loc"]:
            path = (*path, step) if (*path, step) in document.origins else path
        context = detail["ctx"]
        yield Fault(path, f"found {context['found'] or document.found(path)}{context['tail']}", context["at_key"])


class Choice(Spec):
    """A part of a task with a `kind`; in YAML the kind alone means a mapping with all other keys at their defaults."""

    @model_validator(mode="before")
    @classmethod
    def _kind_alone(cls, value: object) -> object:
        return {"kind": value} if isinstance(value, str) else value

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Allow the kind alone."""
        mapping = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"enum": mapping["properties"]["kind"]["enum"]}, mapping]}


class InlineParts(Spec):
    """A model whose field `parts` is not written in YAML: its keys are beside those of the other fields."""

    @model_validator(mode="before")
    @classmethod
    def _gather_parts(cls, value: object) -> object:
        if not isinstance(value, Mapping) or isinstance(value.get("parts"), Mapping):
            return value
        no_parts = {*keys_of(cls), *cls.replaced_keys} - {"parts"}
        others = {key: item for key, item in value.items() if key in no_parts}
        return {"parts": {key: item for key, item in value.items() if key not in others}, **others}

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Write the parts beside the other fields."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        parts = schema["properties"].pop("parts")
        return {**schema, "additionalProperties": parts["additionalProperties"]}


def number(value: object) -> float:
    """Return a finite number as float; a text or a truth value is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise expected("a number")
    if not abs(value) <= LARGEST:
        raise expected(f"a number of at most {LARGEST:g} in magnitude")
    return float(value)


def number_or_angle(value: object) -> float:
    """Return a finite number, or an angle with its unit in rad."""
    if isinstance(value, str):
        if not re.fullmatch(ANGLE_PATTERN, value):
            raise expected("a number, or an angle such as 30 deg")
        size = float(value.rstrip(" degra°"))
        value = size if value.endswith("rad") else math.radians(size)
    return number(value)


def _length(value: object) -> float:
    """Return a finite number, or a length with its unit in m."""
    if isinstance(value, str):
        if not re.fullmatch(LENGTH_PATTERN, value):
            raise expected("a length, such as 0.2 or 0.2 m")
        value = float(value.rstrip(" m"))
    return number(value)


def _coordinate(value: object, rate: str = "") -> float:
    """Return a finite number, a length with its unit in m, or an angle with its unit in rad; see `unit_errors`.

    Args:
        value: The number as it is written.
        rate: Units of a rate of coordinates, which has no unit of its own where it is written.
    """
    if isinstance(value, str) and not re.fullmatch(COORDINATE_PATTERN, value):
        of_rate = f"a number in {rate}, such as 0.2, 0.2 m or 30 deg"
        raise expected(of_rate if rate else "a number, an angle such as 30 deg, or a length such as 0.2 m")
    is_length = isinstance(value, str) and value.endswith("m")
    return _length(value) if is_length else number_or_angle(value)


def unit_errors(written: object, unit: str, turns: bool = True, rate: str = "") -> RuleErrors:
    """Yield the error of a number that is written with the unit of another kind of coordinate, or lacks a unit.

    A length may be `0.2` or `0.2 m`, an angle `0.5`, `0.5 rad` or `30 deg`. An angle without a unit of more than one
    turn is an error, since degrees are meant most likely.

    Args:
        written: The number as it is written; a value that is no number has no error here.
        unit: Unit of the coordinate: m, rad, or 1 for parts of a quaternion.
        turns: Whether an angle beyond one turn needs its unit; that of a rate does not.
        rate: Unit of the number if it is a rate of the coordinate, such as m/s^2; it is only for the message, since
            rates are written with the unit of the coordinate.

    Yields:
        The empty path and the error, at most once.
    """
    kind = f"a number in {rate}" if rate else {"m": "a length", "rad": "an angle"}.get(unit, "a number")
    if isinstance(written, str) and re.fullmatch(COORDINATE_PATTERN, written):
        if unit != ("m" if written.endswith("m") else "rad"):
            example = {"m": ", such as 0.2 or 0.2 m", "rad": ", such as 0.5, 0.5 rad or 30 deg"}.get(unit, " alone")
            yield (), expected(f"{kind}{example}")
    elif unit == "rad" and turns:
        yield from within_a_turn(written, {}, None)


def within_a_turn(written: object, earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors for an angle of more than a turn without a unit: degrees, most likely."""
    if isinstance(written, int | float) and abs(written) > 2 * math.pi * (1 + 1e-9):
        wanted = f"an angle within one turn, or one with its unit: {written:g} deg, {written:g} rad"
        yield (), expected(wanted, f'{written:g} rad (did you mean "{written:g} deg"?)')


def _seconds(value: object) -> float:
    if isinstance(value, str):
        if not re.fullmatch(SECONDS_PATTERN, value):
            raise expected("a number, or seconds such as 2 s")
        value = float(value.removesuffix("s"))
    return number(value)


def _seconds_or_auto(value: object) -> object:
    if isinstance(value, str) and value != "auto" and not re.fullmatch(SECONDS_PATTERN, value):
        raise expected("seconds such as 0.13 s, or auto")
    seconds = value if value == "auto" else _seconds(value)
    if isinstance(seconds, float) and seconds < 0:
        raise expected("a number of at least 0, or auto")
    return seconds


def ensure(test: Callable[[Any], bool], what: str) -> WrapValidator:
    """Create a validator of valid values that must also be `what`."""
    return validated_by(
        lambda value, _before, _context: iter(() if test(value) else [((), expected(what))]), always=True
    )


def _intervals(value: object) -> object:
    if value != "auto" and not (isinstance(value, int | float) and value % 1 == 0 and 2 <= value <= 1000):
        raise expected("a whole number from 2 to 1000, or auto")
    return value


def is_name(text: str) -> bool:
    """Tell whether a text may be a name."""
    return len(text) <= 60 and text.isprintable() and re.fullmatch(NAME_PATTERN, text) is not None


def _name(value: object) -> str:
    if not isinstance(value, str):
        raise expected("a name (in quotes if it looks like a number)")
    if not is_name(value):
        raise expected("a name of at most 60 characters without . / \\ [ ] = : , and double spaces")
    return value


def one_of(names: Callable[[Any], Collection[str]], kind: str | None = None) -> WrapValidator:
    """Create a validator of a name that must be among those that the context lists, if it lists any.

    Args:
        names: Returns them from the context.
        kind: For keys of a mapping, what they name.
    """

    def rule(name: str, earlier_fields: Fields, context: Any) -> RuleErrors:
        valid = names(context)
        if valid and name not in valid:
            yield (), flaw(choice(name, valid), kind and f"no such {kind}", at_key=kind is not None)

    return validated_by(rule)


def listed(what: str, length: int | None = None) -> BeforeValidator:
    """Create a validator of a list, of a fixed length if one is given."""

    def check(value: object) -> object:
        if not isinstance(value, list | tuple) or length not in (None, len(value)):
            raise expected(what)
        return value

    return BeforeValidator(check)


ESTIMATED = "estimated"
"""Of a load whose mass and moments of inertia the controller finds out."""


def _known(value: object) -> object:
    if not (isinstance(value, bool) or value == ESTIMATED):
        raise expected("true, false or estimated")
    return value


def _mirrored(value: object, read: Callable[[object], float]) -> object:
    """Return a number v as the pair (-v, v); a pair as it is."""
    if isinstance(value, list | tuple):
        return value
    size = read(value)
    return 0.0 - size, size


class _Or:
    """Adds other ways to write a value to its JSON Schema; for a list, its single entry."""

    def __init__(self, *ways: dict[str, Any]) -> None:
        self.ways = ways

    def __get_pydantic_json_schema__(self, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        own = handler(core_schema)
        one = own.get("items", {})
        return {"anyOf": [*(one.get("anyOf", [one]) if one else []), own, *self.ways]}


_or_angle = _Or({"type": "string", "pattern": ANGLE_PATTERN})
_or_length = _Or({"type": "string", "pattern": LENGTH_PATTERN})
_or_unit = _Or({"type": "string", "pattern": COORDINATE_PATTERN})
_not_tiny = ensure(lambda value: not 0 < value < 1e-12, "a number of at least 1e-12")

Number = Annotated[float, BeforeValidator(number)]
Positive = Annotated[float, Field(gt=0), BeforeValidator(number), _not_tiny]
NotNegative = Annotated[float, Field(ge=0), BeforeValidator(number)]
PositiveOrNone = Annotated[
    float,
    BeforeValidator(number),
    _not_tiny,
    ensure(lambda value: value >= 0, "a number greater than 0"),
    WithJsonSchema({"type": "number", "minimum": 0}),
]
Fraction = Annotated[float, Field(ge=0, lt=1), BeforeValidator(number)]
Known = Annotated[bool | Literal["estimated"], BeforeValidator(_known)]
Seconds = Annotated[float, Field(ge=0), BeforeValidator(_seconds), _Or({"type": "string", "pattern": SECONDS_PATTERN})]
SecondsOrAuto = Annotated[
    float | Literal["auto"],
    BeforeValidator(_seconds_or_auto),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "minimum": 0},
                {"type": "string", "pattern": SECONDS_PATTERN},
                {"const": "auto"},
            ]
        }
    ),
]
Angle = Annotated[float, BeforeValidator(number_or_angle), _or_angle]
Length = Annotated[float, Field(gt=0), BeforeValidator(_length), _not_tiny, _or_length]
Coordinate = Annotated[float, BeforeValidator(_coordinate), _or_unit]
CoordinateWidth = Annotated[float, Field(gt=0), BeforeValidator(_coordinate), _not_tiny, _or_unit]
Direction = Annotated[float, BeforeValidator(number_or_angle), validated_by(within_a_turn, as_written=True), _or_angle]
Size = Annotated[float, Field(ge=0), BeforeValidator(number_or_angle), _or_angle]
Width = Annotated[float, Field(gt=0), BeforeValidator(number_or_angle), _not_tiny, _or_angle]
Whole = Annotated[int, BeforeValidator(number)]
Intervals = Annotated[
    int | Literal["auto"],
    BeforeValidator(_intervals),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 2, "maximum": 1000}, {"const": "auto"}]}),
]
Flag = Annotated[bool, Strict()]
Name = Annotated[str, BeforeValidator(_name), WithJsonSchema({"type": "string", "pattern": NAME_PATTERN})]
Vector2 = Annotated[tuple[Number, Number], listed("2 entries", 2)]
Vector3 = Annotated[tuple[Number, Number, Number], listed("3 entries", 3)]
Angles3 = Annotated[tuple[Direction, Direction, Direction], listed("3 angles", 3)]
Axis = Annotated[Vector3, ensure(lambda axis: abs(math.hypot(*axis) - 1) <= 1e-6, "an axis of length 1")]
_Bounds = Annotated[tuple[Coordinate, Coordinate], listed("a pair [low, high]", 2)]
Interval = Annotated[_Bounds, ensure(lambda pair: pair[0] <= pair[1], "the lower bound first, [low, high]")]
_velocity = partial(_coordinate, rate="m/s or rad/s")
_acceleration = partial(_coordinate, rate="m/s^2 or rad/s^2")
_jerk = partial(_coordinate, rate="m/s^3 or rad/s^3")
OneVelocity = Annotated[float, BeforeValidator(_velocity), _or_unit]
_Acceleration = Annotated[float, BeforeValidator(_acceleration), _or_unit]
_Jerk = Annotated[float, BeforeValidator(_jerk), _or_unit]
_pair = listed("a pair [low, high]", 2)
_may_rest = ensure(
    lambda pair: pair[0] <= 0 <= pair[1],
    "a number of at least 0, or a pair [low, high] around 0: the robot must be able to rest",
)
_or_one = _Or({"type": "number", "minimum": 0}, {"type": "string", "pattern": COORDINATE_PATTERN})
Velocity = Annotated[
    tuple[OneVelocity, OneVelocity], _pair, BeforeValidator(partial(_mirrored, read=_velocity)), _may_rest, _or_one
]
Acceleration = Annotated[
    tuple[_Acceleration, _Acceleration],
    _pair,
    BeforeValidator(partial(_mirrored, read=_acceleration)),
    _may_rest,
    _or_one,
]
Jerk = Annotated[
    tuple[_Jerk, _Jerk],
    _pair,
    BeforeValidator(partial(_mirrored, read=_jerk)),
    _may_rest,
    _or_one,
    ensure(lambda pair: pair[0] < 0 < pair[1], "a number greater than 0: the robot must be able to accelerate"),
]
Force = Annotated[
    tuple[Number, Number],
    listed("a pair [low, high]", 2),
    BeforeValidator(partial(_mirrored, read=number)),
    ensure(
        lambda pair: pair[0] <= 0 <= pair[1] and pair[0] < pair[1],
        "a number greater than 0, or a pair [low, high] around 0: the robot must be able to rest, and to move",
    ),
    _Or({"type": "number", "exclusiveMinimum": 0}),
]

_Key = TypeVar("_Key")
_One = TypeVar("_One")
_Each = TypeVar("_Each")
_one_alone = BeforeValidator(lambda value: value if isinstance(value, list | tuple | dict) else [value])
Several = Annotated[tuple[_One, ...], _one_alone, _Or()]
"""A list, or one entry alone."""

OneOrMore = Annotated[tuple[_One, ...], Field(min_length=1), _one_alone, _Or()]
"""A list that is not empty, or one entry alone."""

Sparse = Annotated[_One, Field(exclude_if=lambda value: not value)]
"""A value that a task's digest leaves out where it is none or 0."""

OrByPart = Annotated[
    Annotated[_One, Tag("number")] | Annotated[Mapping[_Key, _Each], Tag("parts")],
    Discriminator(lambda value: "parts" if isinstance(value, Mapping) else "number"),
]
"""One number for all parts, or numbers by part: `OrByPart[one, key, each]`."""

Part = Annotated[str, one_of(lambda context: context.sizes and [*context.sizes, "arms"], "part of the robot")]
ArmName = Annotated[str, one_of(lambda context: context.sizes and [*context.sizes, "arms"][1:], "part of the robot")]


Quaternion = Annotated[
    tuple[Number, Number, Number, Number],
    listed("4 entries", 4),
    ensure(lambda value: math.hypot(*value) >= 1e-6, "a quaternion w, x, y, z that is not 0"),
]


class Attitude(Spec):
    """An attitude, in one of three ways."""

    rpy: Angles3 | None = Field(None, description="angles about the fixed axes x, y, z, in this order [rad]")
    quaternion: Quaternion | None = Field(None, description="quaternion w, x, y, z of any length")
    axis: Axis | None = Field(None, description="unit vector about which `angle` turns")
    angle: Direction | None = Field(None, description="turn about `axis` [rad]")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        given = {key for key, value in self if value is not None}
        if given not in ({"rpy"}, {"quaternion"}, {"axis", "angle"}):
            raise expected("either rpy, or quaternion, or axis and angle")
        return self

    @property
    def numbers(self) -> list[float]:
        """The unit quaternion w, x, y, z."""
        from scipy.spatial.transform import Rotation

        if self.quaternion is not None:
            return [float(part) for part in np.array(self.quaternion) / np.linalg.norm(self.quaternion)]
        if self.rpy is not None:
            turn = Rotation.from_euler("xyz", self.rpy)
        else:
            turn = Rotation.from_rotvec((self.angle or 0.0) * np.array(self.axis))
        x, y, z, w = turn.as_quat().tolist()
        return [w, x, y, z]


class Pose(Spec):
    """A pose in space."""

    position: Vector3 = Field(description="x, y, z [m]")
    attitude: Attitude = Field(Attitude(quaternion=(1, 0, 0, 0)), description="attitude, by default none")

    @property
    def numbers(self) -> list[float]:
        """Position and unit quaternion."""
        return [*self.position, *self.attitude.numbers]


def is_pose(value: object) -> bool:
    """Tell whether a value is written as a pose in space."""
    return isinstance(value, Mapping) and any(key in value for key in Pose.model_fields)


def _in_numbers(value: object, info: ValidationInfo) -> object:
    """Return a pose as its numbers unless the robot is planar; any other value as it is."""
    if not (is_pose(value) and info.context and info.context.sizes.get("base") != 3):
        return value
    return Pose.model_validate(value, context=info.context).numbers


or_pose = BeforeValidator(_in_numbers)
Numbers = Annotated[tuple[Coordinate, ...], or_pose]
"""Numbers of a part; those of a base or an end-effector in space may be written as a pose."""

Row = Annotated[tuple[Coordinate, ...], listed("a list of numbers, one row of values for every time"), or_pose]
