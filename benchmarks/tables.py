"""The tables of the documentation that take seconds: from the code, from benchmarks' results, and from short runs.

    python benchmarks/tables.py NAME WORDS         such as keys TaskSpec; pages.py writes all of them

A test compares them with the pages.
"""

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from pages import markdown
from pydantic import BaseModel
from typer.main import get_command

import psmpc_cli as psmpc
from psmpc_cli.cli.app import app
from psmpc_cli.logs import conditions, schema
from psmpc_cli.paper.claims import load_claims
from psmpc_cli.solvers.base import Outcome
from psmpc_cli.specs.fields import ANGLE_PATTERN, COORDINATE_PATTERN, LENGTH_PATTERN, NAME_PATTERN, SECONDS_PATTERN
from psmpc_cli.specs.robots.robot import PlanarRobot, SpatialRobot, UrdfRobot
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.studies.measures import WHOLE_RUN, over_weights

BASELINE = Path(__file__).with_name("baseline.yaml")

UNITS = {
    *("1", "m", "rad", "s", "kg", "kg m^2", "Hz", "m/s", "rad/s", "m/s^2", "rad/s^2"),
    *("N", "N m", "N s", "N m s", "N m s/rad"),
}
KINDS = {
    NAME_PATTERN: "name",
    ANGLE_PATTERN: "angle",
    LENGTH_PATTERN: "length",
    COORDINATE_PATTERN: "length or angle",
    SECONDS_PATTERN: "`2 s`",
}
"""Kinds of texts, by their patterns."""

WITH_UNIT = {
    "angle": "number or angle",
    "length": "number or length",
    "length or angle": "number, length or angle",
}
"""What numbers are called that may be written with their units, by the kind of those texts."""

BOUNDS = {"exclusiveMinimum": "> {:g}", "minimum": ">= {:g}", "maximum": "<= {:g}", "exclusiveMaximum": "< {:g}"}

STATED_DEFAULT = re.compile(r"[;,] (?:by )?default:? ([^;]+)$")
"""What a description says at its end of a key that is not given."""

LEADING = ("name", "description", "urdf", "base", "arms")
"""Keys of robots that stand first in a table: a class has those of its parent first."""

SECTIONS = {
    model: section
    for section, models in {
        "robots.md#limits": "PartLimits",
        "robots.md#geometry": "PlacedShape ShapeSpec",
        "#controller": "ControllerSpec HtmpcSpec",
        "#the-prior-of-a-load": "LoadPriorSpec",
        "#solver-and-plant": "SolverSpec PlantSpec",
        "#skills": "SkillSpec SkillWeights",
        "#stages": "StageSpec",
        "capture.md#try-again": "RetrySpec",
        "#trajectories": "TrajectorySpec",
        "#end-conditions": "EndCondition",
        "#by-the-object": "ObjectEndSpec",
        "#by-the-momentum": "MomentumEndSpec",
        "#cones": "ConeSpec ConeTargetSpec",
        "#priorities-from-paired-comparisons": "PrioritiesSpec",
        "#actual-starts": "OnsetSpec",
        "#object-and-monitors": "ObjectSpec MonitorSpec",
        "#an-object-with-a-mass": "MotionSpec DestinationSpec GraspSpec EnvelopeSpec StrengthSpec OnObject",
        "#obstacles-and-clearance": "ObstacleSpec ClearanceSpec RoutesSpec",
        "#uncertainty": "ObjectErrorSpec UncertaintySpec FrictionSpec StateNoiseSpec NoiseSpec ImpulseSpec PayloadSpec",
        "#published-and-log": "PublishedRun LogSpec",
        "#base-keys": "Base",
        "#arm-keys": "Arm",
        "#mount-keys": "Mount",
        "#link-keys": "Link",
        "#tool-keys": "Tool",
        "#spatial-base-keys": "SpatialBase",
        "#spatial-arm-keys": "SpatialArm",
        "#spatial-link-keys": "SpatialLink",
        "#spatial-joint-keys": "SpatialJoint",
        "#spatial-tool-keys": "SpatialTool",
        "#wheel-keys": "Wheel",
        "#spatial-wheel-keys": "SpatialWheel",
        "#thruster-keys": "PlanarThruster",
        "#spatial-thruster-keys": "SpatialThruster",
        "#plume-keys": "Plume",
        "#your-own-urdf": "Tip",
    }.items()
    for model in models.split()
}
"""Where a model is described."""


def keys(name: str) -> Iterator[str]:
    """Yield the table of the keys of a model of tasks or robots."""
    models: dict[str, Any] = {}
    for root in (TaskSpec, PlanarRobot, SpatialRobot, UrdfRobot):
        models |= models_of(root)
    ways = [models[name], *models[name].get("anyOf", ())]
    mapping = next(way for way in ways if "properties" in way)
    properties = mapping["properties"]
    order = [*LEADING, *(key for key in properties if key not in LEADING)]
    rows = (_row(key, properties[key], mapping) for key in order if key in properties)
    return markdown(rows, "key", "value", "unit", "default", "meaning")


def models_of(root: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schemas of a model and of those within it, by name."""
    found = root.model_json_schema()
    return {**found["$defs"], root.__name__: found}


def _row(key: str, value: Mapping[str, Any], mapping: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a key; a unit and a default that its description states have columns of their own."""
    meaning, default = value["description"], value.get("default")
    groups = [each for each in re.finditer(r" \[([^\]]*)\]", meaning) if {*each[1].split(", ")} <= UNITS]
    if len(groups) == 1:
        meaning = meaning[: groups[0].start()] + meaning[groups[0].end() :]
    if key in mapping.get("required", ()) or "const" in value:
        shown = "required"
    elif default is None or default in ("", {}, []):
        stated = STATED_DEFAULT.search(meaning)
        shown = stated[1] if stated else "none"
        meaning = STATED_DEFAULT.sub("", meaning)
    else:
        shown = "its keys' defaults" if isinstance(default, Mapping) else f"`{json.dumps(default)}`".replace('"', "")
    return f"`{key}`", _words(value), "; ".join(each[1] for each in groups), shown, meaning


def _words(value: Mapping[str, Any] | bool) -> str:
    """Describe what a value may be; the schema `true` allows any."""
    if isinstance(value, bool):
        return "any value of [that key](#keys-of-one-controller)"
    if "$ref" in value:
        return f"[mapping]({SECTIONS[value['$ref'].rpartition('/')[2]]})"
    if ways := value.get("anyOf", value.get("oneOf")):
        return _either([way for way in ways if way.get("type") != "null"])
    if "enum" in value or "const" in value:
        return ", ".join(f"`{choice}`" for choice in value.get("enum", [value.get("const")]))
    match value["type"]:
        case "array":
            return _list(value)
        case "object":
            named = next(iter(value.get("patternProperties", {}).values()), value.get("additionalProperties"))
            return f"by name: {_words(named)}"
        case "string":
            return KINDS.get(value.get("pattern", ""), "text")
        case "boolean":
            return "`true`, `false`"
        case kind:
            bounds = " and ".join(text.format(value[key]) for key, text in BOUNDS.items() if key in value)
            return f"{'whole number' if kind == 'integer' else 'number'} {bounds}".strip()


def _either(ways: list[Mapping[str, Any]]) -> str:
    """Name alternatives; a number and one with its unit are one kind of value."""
    words = sorted(dict.fromkeys(map(_words, ways)), key=lambda word: word == "[low, high]")
    if len(words) > 1 and words[0].startswith("number") and words[1] in WITH_UNIT:
        words[:2] = [words[0].replace("number", WITH_UNIT[words[1]], 1)]
    return ", or ".join(words)


def _list(value: Mapping[str, Any]) -> str:
    if "prefixItems" in value:
        words = [_words(item) for item in value["prefixItems"]]
        return "[low, high]" if words == [WITH_UNIT["length or angle"]] * 2 else f"[{', '.join(words)}]"
    least, most = value.get("minItems", 0), value.get("maxItems")
    bounds = f", {least} to {most}" if most else f", at least {least}" if least > 1 else ""
    return f"list of {_words(value['items'])}{bounds}"


def datasets(along: str, *condition: str) -> Iterator[str]:
    """Yield the table of the datasets along a dimension, or fixed ones, that logs have under a condition, if any.

    Args:
        along: Path of the scale of the dimension, or `fixed`.
        condition: Words of the name of one of `conditions`.
    """
    only = vars(conditions)["_".join(condition or ("always",)).upper()]
    sizes = {
        "time": "K",
        "ticks/tick": "M",
        "coordinate": "n",
        "pose_coordinate": "m",
        "stage": "S",
        "momentum": "3 or 6",
        "gripper": "A",
        schema.Q_COORDINATE: "nq",
    }
    rows = []
    for column in schema.columns("" if along == "fixed" else along):
        if column.only is only:
            dims = column.dims if along == "fixed" else [sizes.get(name, name) for name in column.dims]
            shape = ["K", "its longest"] if column.ragged else dims
            comma = "," if along != "fixed" and len(shape) == 1 else ""
            rows.append((f"`{column.path}`", f"({', '.join(shape)}{comma})", column.units, column.long_name))
    return markdown(rows, "dataset", "shape", "units", "what")


def quantities() -> Iterator[str]:
    """Yield the table of what a study records of each of its runs, and in which studies."""
    by_study = {"sweeps": over_weights(1), "draws": WHOLE_RUN}
    studies: dict[tuple[str, str, str], list[str]] = {}
    for study, columns in by_study.items():
        for column in columns:
            studies.setdefault((f"`{column.path}`", column.units, column.long_name), []).append(study)
    names = list(dict.fromkeys(name for name, _, _ in studies))  # rows of one name stand together
    together = sorted(studies.items(), key=lambda study: names.index(study[0][0]))
    rows = ((*cells, ", ".join(recorded)) for cells, recorded in together)
    return markdown(rows, "array", "units", "what", "recorded by")


def outcomes() -> Iterator[str]:
    """Yield the table of how solves end, by what logs have in `solver/status`."""
    return markdown(((f"`{outcome.name.lower()}`", outcome.value) for outcome in Outcome), "status", "meaning")


def commands() -> Iterator[str]:
    """Yield the table of the commands."""
    given = vars(get_command(app))["commands"]
    rows = ((f"`psmpc {name}`", command.get_short_help_str(200)) for name, command in given.items())
    return markdown(rows, "command", "what it does")


def options(name: str) -> Iterator[str]:
    """Yield the table of a command's arguments and options, as its help has them."""
    command = vars(get_command(app))["commands"][name]
    with command.make_context(name, [], resilient_parsing=True) as context:
        records = (parameter.get_help_record(context) for parameter in command.get_params(context))
        pairs = [record for record in records if record is not None and record[0] != "--help"]
    rows = ((f"`{_cell(given)}`", _cell(meaning).replace("<", "&lt;")) for given, meaning in pairs)
    return markdown(rows, "argument or option", "what it does") if pairs else iter(("It takes no options.",))


def _cell(text: str) -> str:
    """Return a text of the help as a cell of a table: without bars, one space between words."""
    return " ".join(text.replace("|", "/").split())


def baseline(*names: str) -> Iterator[str]:
    """Yield the table of the transport task at N_s = 100 from benchmarks/baseline.yaml, all of it or some rows."""
    published = psmpc.load_task("transport").spec.published
    ends_of_htmpc = {claim.id: claim.number for claim in load_claims() if claim.id.startswith("htmpc.t")}
    measured = yaml.safe_load(BASELINE.read_text(encoding="utf-8"))
    rows = []
    for name in names or measured:
        found, paper = measured[name], published.get(name)
        if paper is not None:
            rows.append((f"{name}, published", *_times(paper.switch_time, paper.actual_start), "", ""))
        if name == "htmpc":
            ends = dict(zip(STAGES, ends_of_htmpc.values(), strict=True))
            rows.append((f"{name}, published", *_times(ends, {}), "", ""))
        apart = ", ".join(f"{found['gripper_distance'][stage]:.3f}" for stage in ("capture", "transport"))
        rows.append((name, *_times(found["switch_time"], found["actual_start"]), apart, found["mission"]))
    return markdown(rows, "", *TIMES, "grippers apart at the ends of Capture, Transport [m]", "mission")


STAGES = ("approach", "capture", "transport", "release")

TIMES = ("Capture starts [s]", "Approach ends", "Capture ends", "Transport ends", "end")


def _times(ends: Mapping[str, float], starts: Mapping[str, float]) -> Iterator[str]:
    """Yield the cells of the columns of times."""
    yield f"{starts['capture']:.1f}" if "capture" in starts else "-"
    for stage in STAGES:
        yield f"{ends[stage]:.2f}" if stage in ends else "-"


def transport() -> Iterator[str]:
    """Yield the table of the transport task on coarse meshes."""
    rows = []
    for nodes, kind in ((12, "psmpc"), (12, "smpc"), (12, "hard"), (25, "psmpc")):
        changes = {"controller.nodes": nodes, "controller.kind": kind, "log.shares": False}
        run = psmpc.simulate(psmpc.load_task("transport", changes))
        times = (dict(zip(run.stage_names, run.stages[key], strict=True)) for key in ("switch_time", "actual_start"))
        rows.append((nodes, kind, *_times(*times), "succeeded" if run.summary().succeeded else "failed"))
    return markdown(rows, "N_s", "controller", *TIMES, "mission")


POSED = {
    "stages.approach.target.arm_1": ["45 deg", "30 deg", "60 deg"],
    "stages.approach.target.arm_2": ["-45 deg", "-30 deg", "-60 deg"],
}
"""Joints with which Approach of the transport task holds the grippers where Capture wants them."""


def posed(*names: str) -> Iterator[str]:
    """Yield the table of the transport task whose Approach holds the arms stretched, as published, or ready.

    The names are those of its rows, without any all of them.
    """
    controllers: Mapping[str, Mapping[str, Any]] = {
        "psmpc": {},
        "smpc": {"controller.kind": "smpc"},
        "hard": {"controller.kind": "hard"},
        "hard, free end": {"controller.kind": "hard", "controller.one_stage": "free_end", "by_controller": {}},
    }
    rows = []
    for name in names or controllers:
        chosen = controllers[name]
        cells = []
        for arms in ({}, POSED):
            changes = {"controller.nodes": 25, "log.shares": False, **chosen, **arms}
            summary = psmpc.simulate(psmpc.load_task("transport", changes)).summary()
            failed = "" if summary.succeeded else ", failed"
            cells += [f"{summary.duration:.1f}{failed}", f"{summary.control_effort:.2f}"]
        rows.append((f"`{name}`", *cells))
    return markdown(rows, "controller", "stretched: end [s]", "effort", "held ready: end [s]", "effort, held ready")


TABLES: Mapping[str, Callable[..., Iterable[str]]] = {
    function.__name__: function
    for function in (keys, datasets, quantities, outcomes, commands, options, baseline, transport, posed)
}


def table(name: str, *words: str) -> str:
    """Return the text of a table."""
    return "".join(f"{line}\n" for line in TABLES[name](*words))


if __name__ == "__main__":
    print(table(*sys.argv[1:]), end="")
