"""The tables of keys in docs/tasks.md and docs/robots.md, from the models; run as a script it writes them anew."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from psmpc_cli.specs.document import ANGLE_PATTERN
from psmpc_cli.specs.fields import NAME_PATTERN, SECONDS_PATTERN
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import TaskSpec

DOCS = Path(__file__).parents[2] / "docs"
ROOTS: dict[str, type[BaseModel]] = {"tasks.md": TaskSpec, "robots.md": RobotSpec}

MARKED = re.compile(r"(?<=<!-- keys of )(\w+)( -->\n).*?(?=<!-- end -->)", re.DOTALL)
UNITS = {
    *("1", "m", "rad", "s", "kg", "kg m^2", "Hz", "m/s", "rad/s", "m/s^2", "rad/s^2"),
    *("N", "N m", "N s", "N m s", "N m s/rad"),
}
NOT_WRITTEN = "parts"
"""Stands for keys that are parts of the robot."""

SECTIONS = {
    model: section
    for section, models in {
        "robots.md#limits": "PartLimits",
        "#controller": "ControllerSpec HtmpcSpec",
        "#solver-and-plant": "SolverSpec PlantSpec",
        "#skills": "SkillSpec SkillWeights",
        "#stages": "StageSpec",
        "#trajectories": "TrajectorySpec",
        "#end-conditions": "EndCondition",
        "#priorities-from-paired-comparisons": "PrioritiesSpec",
        "#actual-starts": "OnsetSpec",
        "#object-and-monitors": "ObjectSpec MonitorSpec",
        "#uncertainty": "UncertaintySpec FrictionSpec NoiseSpec ImpulseSpec PayloadSpec",
        "#published-and-log": "PublishedRun LogSpec",
        "#bodies": "Base Arm Mount Link Tool",
    }.items()
    for model in models.split()
}
"""Where a model is described."""


def with_tables(name: str, text: str) -> str:
    """Return a page with every marked table written from its model."""
    schema = ROOTS[name].model_json_schema()
    models = {**schema["$defs"], ROOTS[name].__name__: schema}
    return MARKED.sub(lambda match: f"{match[1]}{match[2]}{table(models[match[1]], models)}\n", text)


def documented(text: str) -> set[str]:
    """Return the models that have a table on a page."""
    return {match[1] for match in MARKED.finditer(text)}


def models_of(name: str) -> set[str]:
    """Return the models that a page must have a table of."""
    schema = ROOTS[name].model_json_schema()
    here = {model for model in schema["$defs"] if SECTIONS[model].startswith(("#", name))}
    return {ROOTS[name].__name__, *here}


def table(model: Mapping[str, Any], models: Mapping[str, Any]) -> str:
    """Return the keys of a model as a table."""
    mapping = _mapping(model)
    rows = [
        _row(key, value, key in mapping.get("required", ()), models)
        for key, value in mapping["properties"].items()
        if key != NOT_WRITTEN
    ]
    return "\n".join(["| key | value | unit | default | meaning |", "|---|---|---|---|---|", *rows])


def _mapping(model: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the mapping among the ways to write a model."""
    return model if "properties" in model else next(_mapping(way) for way in model["anyOf"] if "enum" not in way)


def _row(key: str, value: Mapping[str, Any], required: bool, models: Mapping[str, Any]) -> str:
    meaning, units = _without_unit(value["description"])
    default = "required" if required else _default(value, models)
    return f"| `{key}` | {_words(value, models)} | {units} | {default} | {meaning} |"


def _without_unit(description: str) -> tuple[str, str]:
    """Return a description without the unit at its end, and all units in it."""
    groups = [
        match for match in re.finditer(r" \[([^\]]*)\]", description) if {*re.split(r", ", match[1])}.issubset(UNITS)
    ]
    units = "; ".join(match[1] for match in groups)
    if len(groups) == 1:
        return description[: groups[0].start()] + description[groups[0].end() :], units
    return description, units


def _default(value: Mapping[str, Any], models: Mapping[str, Any]) -> str:
    default = value.get("default")
    if default is None or default in ("", {}, []):
        return "none"
    return "its keys' defaults" if isinstance(default, Mapping) else f"`{json.dumps(default)}`".replace('"', "")


def _words(value: Mapping[str, Any] | bool, models: Mapping[str, Any]) -> str:
    """Say what a value may be; the schema `true` allows any."""
    if isinstance(value, bool):
        return "any value of [that key](#keys-of-one-controller)"
    if "$ref" in value:
        return f"[mapping]({SECTIONS[value['$ref'].rpartition('/')[2]]})"
    for key in ("anyOf", "oneOf"):
        if key in value:
            return _either([way for way in value[key] if way.get("type") != "null"], models)
    if "enum" in value or "const" in value:
        return ", ".join(f"`{choice}`" for choice in value.get("enum", [value.get("const")]))
    kind = value["type"]
    if kind == "array":
        return _list(value, models)
    if kind == "object":
        named = next(iter(value.get("patternProperties", {}).values()), value.get("additionalProperties"))
        return f"by name: {_words(named, models)}"
    if kind == "string":
        kinds = {NAME_PATTERN: "name", ANGLE_PATTERN: "angle", SECONDS_PATTERN: "`2 s`"}
        return kinds.get(value.get("pattern", ""), "text")
    return {"boolean": "`true`, `false`", "integer": "whole number", "number": "number"}[kind] + _bounds(value)


def _either(ways: list[Mapping[str, Any]], models: Mapping[str, Any]) -> str:
    """Name alternatives; a number or an angle with its unit is one kind of value."""
    words = sorted(dict.fromkeys(_words(way, models) for way in ways), key=lambda word: word == "[low, high]")
    if len(words) > 1 and words[0].startswith("number") and words[1] == "angle":
        words[:2] = [words[0].replace("number", "number or angle", 1)]
    return ", or ".join(words)


def _list(value: Mapping[str, Any], models: Mapping[str, Any]) -> str:
    if "prefixItems" in value:
        words = [_words(item, models) for item in value["prefixItems"]]
        return "[low, high]" if words == ["number or angle"] * 2 else f"[{', '.join(words)}]"
    least = f", at least {value['minItems']}" if value.get("minItems", 0) > 1 else ""
    return f"list of {_words(value['items'], models)}{least}"


def _bounds(value: Mapping[str, Any]) -> str:
    if value["type"] == "boolean":
        return ""
    texts = {"exclusiveMinimum": "> {:g}", "minimum": ">= {:g}", "maximum": "<= {:g}", "exclusiveMaximum": "< {:g}"}
    found = [text.format(value[key]) for key, text in texts.items() if key in value]
    return f" {' and '.join(found)}" if found else ""


if __name__ == "__main__":
    for page in ROOTS:
        path = DOCS / page
        path.write_text(with_tables(page, path.read_text(encoding="utf-8")), encoding="utf-8")
