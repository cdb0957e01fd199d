"""What must fit together in a task and its robot: parts, lengths, coordinates, limits, times, priorities, uncertainty.

The checks read the document, not the validated data, so that every fault is reported at once: a check needs only the
values that it reads to be valid. The rules of single values and of names are part of their types (fields.py, task.py).
"""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import product
from typing import get_args

from pydantic import BaseModel

from psmpc_cli.specs.coordinates import (
    QUANTITIES,
    Space,
    error_axes,
    limits_of_part,
    names,
    stands_for,
    target_axes,
)
from psmpc_cli.specs.document import Document, Raw
from psmpc_cli.specs.messages import Fault, choice, counted, dotted, quoted
from psmpc_cli.specs.priorities import check_agreement
from psmpc_cli.specs.robot import PartLimits
from psmpc_cli.specs.task import (
    ControllerSpec,
    PlantSpec,
    PrioritiesSpec,
    SkillSpec,
    SolverSpec,
    TaskSpec,
    UncertaintySpec,
)

Axes = Mapping[str, tuple[str, ...]]
"""Names of the numbers of every part."""

RESERVED = ("base", "arms", "all", "control", "times")
"""Names that have another meaning wherever arms are named."""

SPACES: tuple[Space, ...] = get_args(SkillSpec.model_fields["space"].annotation)
CONTROLLERS: tuple[str, ...] = get_args(ControllerSpec.model_fields["kind"].annotation)

REQUIRED: dict[Space, tuple[str, ...]] = {"point": ("base",)}
"""Parts that targets and weights must have, where these are not all: not every arm has to point at something."""

BOUNDS = ("above_start_at_most", "below_start_at_most", "at_most", "at_least")
"""Ways to bound a monitored signal."""

TURN = 2 * math.pi * (1 + 1e-9)
"""Largest angle without a unit [rad]."""

ROUNDING = 1e-6
"""By how much a ratio of times may miss a whole number, and shares their sum."""

MOST_SAMPLES = 1000
"""Samples of a horizon."""

MOST_STEPS = 20_000
"""Steps of the integrator in a sample: more take seconds."""


def parts_of(robot: Document | None) -> dict[str, int]:
    """Return the parts of a robot and their numbers of coordinates; empty if they cannot be read."""
    arms = dict(Raw(robot)["arms"].items()) if robot is not None else {}
    lengths = {name: arm["links"].length or 0 for name, arm in arms.items()}
    readable = lengths and all(lengths.values()) and not any(name in RESERVED for name in lengths)
    return {"base": 3, **lengths} if readable else {}


def known_names(task: Document, parts: Mapping[str, int]) -> dict[str, Collection[str]]:
    """Return the names that fields of a task or robot may refer to, by their key in the validation context."""
    raw = Raw(task)
    arms = [part for part in parts if part != "base"]
    return {
        "skills": [name for name, _ in raw["skills"].items()],
        "stages": raw["stages"].texts("name"),
        "controllers": CONTROLLERS,
        "frames": list(parts),
        "parts": [*parts, "arms"] if parts else [],
        "arms": [*arms, "arms"] if arms else [],
        "joint coordinates": names(parts, "joint") if parts else [],
    }


def check_robot(document: Document) -> Iterator[Fault]:
    """Give what does not fit together in a robot description."""
    robot, parts = Raw(document), parts_of(document)
    for name, arm in robot["arms"].items():
        if name in RESERVED:
            yield arm.fault(f"none of {', '.join(RESERVED)}", f"the reserved name {quoted(name)}", at_key=True)
        yield from _within_a_turn(arm["mount"]["angle"])
        yield from _within_a_turn(arm["tool"]["angle"])
    yield from _limit_lengths(robot["limits"], target_axes(parts, "joint"))


def check_task(document: Document, robot: Document | None) -> Iterator[Fault]:
    """Give what does not fit together in a task, and between it and its robot where that can be read."""
    task, parts = Raw(document), parts_of(robot)
    stages = list(task["stages"].entries())
    for listed in (task["stages"], task["monitors"]):
        yield from _repeated_names(listed)
    for stage in stages:
        yield from _end(stage, last=stage is stages[-1])
        yield from _rising_times(stage["target"]["times"])
    for monitor in task["monitors"].entries():
        yield from _monitor(monitor)
    for check in (_instants, _object, _combinations, _timing, _priorities, _uncertainty):
        yield from check(task)
    if robot is not None and parts:
        yield from _numbers_by_part(task, parts)
        yield from _coordinates(task, parts)
        yield from _limits(task, Raw(robot), parts)
        yield from _shares(task["uncertainty"]["payload"]["share"], [part for part in parts if part != "base"])


def _repeated_names(listed: Raw) -> Iterator[Fault]:
    """Give names of entries that an earlier entry has."""
    first: dict[str, Raw] = {}
    for entry in listed.entries():
        name = entry["name"].text
        if name in first:
            earlier = dotted(first[name].path)
            yield entry["name"].fault("a name of its own", f"{quoted(name)} again (first at {earlier})")
        elif name is not None:
            first[name] = entry


# Numbers by part, coordinates and limits.


def _numbers_by_part(task: Raw, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give missing parts, wrong lengths and angles without a unit wherever a task has numbers by part."""
    joint = target_axes(parts, "joint")
    yield from _by_part(task["initial"], joint, joint, angles=True)
    yield from _by_part(task["initial_velocity"], joint)
    for _, skill in task["skills"].items():
        space, weights = _space(skill), skill["weights"]
        if space is not None:
            yield from _by_part(weights, error_axes(parts, space), REQUIRED.get(space, joint))
        control = target_axes(parts, "task" if skill["input"].text == "task" else "joint")
        yield from _by_part(weights["control"], control, control)
    for stage in task["stages"].entries():
        space = _space(task["skills"][stage["skill"].text or ""])
        if space is not None:
            yield from _by_part(stage["target"], target_axes(parts, space), REQUIRED.get(space, joint), angles=True)
            yield from _by_part(stage["ends_when"]["tolerance"], error_axes(parts, space), one=True)
    uncertainty = task["uncertainty"]
    for place in (uncertainty["force_limits"], uncertainty["friction"]["viscous"], uncertainty["friction"]["coulomb"]):
        yield from _by_part(place, joint, one=True)
    yield from _within_a_turn(task["object"]["pose"][2])


def _space(skill: Raw) -> Space | None:
    """Return the space of a skill, None if it has no valid one."""
    return next((space for space in SPACES if space == skill["space"].text), None)


def _by_part(
    place: Raw, axes: Axes, required: Collection[str] = (), one: bool = False, angles: bool = False
) -> Iterator[Fault]:
    """Give what is wrong with one mapping by part.

    Args:
        place: The mapping; its values are lists of numbers, or lists of such rows where it has the key `times`.
        axes: The names of the numbers of every part.
        required: The parts that must be there.
        one: Whether one number may stand for all of a part.
        angles: Whether some of the numbers are angles, so that they need a unit beyond one turn.
    """
    given = {key: part for key, part in place.items() if key in (*axes, "arms")}
    missing = [part for part in required if not any(stands_for(key, part) for key in given)]
    if missing and isinstance(place.value, dict):
        yield place.fault(f"also {', '.join(missing)}", ", ".join(given) or "no part", at_key=True)
    times = place["times"].length
    for key, part in given.items():
        rows = [row for row in part.entries() if row.length is not None]
        if times is not None and part.length not in (None, times):
            yield part.fault(f"{counted(times, 'row', 'rows')}, one for every entry of times")
        for row in rows or [part]:
            yield from _length(row, key, axes, given, one)
            if angles:
                yield from _angles(row, key, axes)


def _length(place: Raw, key: str, axes: Axes, given: Collection[str], one: bool = False) -> Iterator[Fault]:
    """Give a list that is not as long as each part it stands for; parts of `given` have lists of their own."""
    for part in axes:
        applies = stands_for(key, part) and (key == part or part not in given)
        if applies and place.length not in (None, len(axes[part]), 1 if one else None):
            named = "" if axes[part][0].isdigit() else f" ({', '.join(axes[part])})"
            length = counted(len(axes[part]), "entry", "entries")
            yield place.fault(f"{length} for {part}{named}{', or one' if one else ''}")
            return


def _angles(place: Raw, key: str, axes: Axes) -> Iterator[Fault]:
    """Give the angles without a unit in a list of numbers, or of pairs, for the parts that a key means."""
    own = next((axes[part] for part in axes if stands_for(key, part)), ())
    for axis, item in zip(own, place.entries(), strict=False):
        if axis == "theta" or axis.isdigit():
            for value in list(item.entries()) or [item]:
                yield from _within_a_turn(value)


def _within_a_turn(place: Raw) -> Iterator[Fault]:
    """Give an angle of more than a turn without a unit: degrees, most likely."""
    value, written = place.number, place.document.entry(place.path).written
    if value is not None and place.text is None and abs(value) > TURN:
        wanted = f"an angle within one turn, or one with its unit: {written} deg, {written} rad"
        yield place.fault(wanted, f'{written} rad (did you mean "{written} deg"?)')


def _coordinates(task: Raw, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give coordinates of end conditions that the robot does not have, and those without a tolerance."""
    for stage in task["stages"].entries():
        space, condition = _space(task["skills"][stage["skill"].text or ""]), stage["ends_when"]
        valid = list(dict.fromkeys(name for each in SPACES if space in (each, None) for name in names(parts, each)))
        chosen = list(condition["coordinates"].entries())
        for name in chosen:
            if name.text is not None and name.text not in valid:
                yield Fault(name.path, f"found {name.document.found(name.path)}{choice(name.text, valid)}")
        given = [key for key, _ in condition["tolerance"].items() if key in (*parts, "arms")]
        texts = [name.text.partition(".")[0] for name in chosen if name.text in valid and name.text]
        needed = [part for part in parts if any(key == "all" or stands_for(key, part) for key in texts)]
        missing = [part for part in needed if not any(stands_for(key, part) for key in given)]
        if given and missing:
            wanted = f"also {', '.join(missing)}"
            yield condition["tolerance"].fault(wanted, ", ".join(sorted(given)), at_key=True)


def _limits(task: Raw, robot: Raw, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give limits of a task and its skills with wrong lengths, and those that are wider than the limits before them."""
    outer = {"the robot's": _valid_limits(robot["limits"])}
    yield from _narrower(task["limits"], outer, parts)
    outer["the task's"] = _valid_limits(task["limits"])
    for _, skill in task["skills"].items():
        yield from _narrower(skill["limits"], outer, parts)


def _narrower(limits: Raw, outer: Mapping[str, Mapping[str, PartLimits]], parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give limits with wrong lengths, and those that are wider than the outer ones."""
    yield from _limit_lengths(limits, target_axes(parts, "joint"))
    inner = _valid_limits(limits)
    for part, quantity, (whose, layer) in product(parts, QUANTITIES, outer.items()):
        given, allowed = limits_of_part(inner, part, quantity) or (), limits_of_part(layer, part, quantity) or ()
        for index, ((low, high), (least, most)) in enumerate(zip(given, allowed, strict=False)):
            if low < least or high > most:
                key = part if limits[part][quantity].exists else "arms"
                yield limits[key][quantity][index].fault(f"within {whose} [{least:.6g}, {most:.6g}]")


def _limit_lengths(limits: Raw, axes: Axes) -> Iterator[Fault]:
    """Give lists of limits with wrong lengths, and bounds of angles without a unit."""
    for quantity in QUANTITIES:
        given = {key: part[quantity] for key, part in limits.items() if part[quantity].exists}
        for key, bounds in given.items():
            yield from _length(bounds, key, axes, given)
            if quantity == "position":
                yield from _angles(bounds, key, axes)


def _valid_limits(limits: Raw) -> dict[str, PartLimits]:
    """Return the limits of the parts that are valid."""
    return {key: valid for key, part in limits.items() if (valid := part.valid(PartLimits)) is not None}


# Stages, their order in time, and the object.


def _end(stage: Raw, last: bool) -> Iterator[Fault]:
    """Give a stage without an end, or with two."""
    ends = [key for key in ("ends_when", "at") if stage[key].exists]
    if isinstance(stage.value, dict) and (ends != ["ends_when"] if last else len(ends) != 1):
        wanted = '"ends_when" in the last stage: it ends the run' if last else 'either "ends_when" or "at"'
        place = stage["at"] if "at" in ends else stage
        yield place.fault(wanted, " and ".join(map(quoted, ends)) or "no end", at_key=True)


def _rising_times(listed: Raw) -> Iterator[Fault]:
    """Give times of a trajectory that do not rise from 0."""
    times = list(listed.entries())
    numbers = [time.number for time in times]
    if numbers and numbers[0]:
        yield times[0].fault("0: times count from where the stage begins", f"{numbers[0]:g} s")
    for time, before, after in zip(times[1:], numbers[:-1], numbers[1:], strict=True):
        if before is not None and after is not None and after <= before:
            yield time.fault(f"later than the time before it, {before:g} s", f"{after:g} s")


def _time_limit(task: Raw) -> float | None:
    """Return the time after which the run is stopped [s], None if it is not valid."""
    given = task["time_limit"]
    return given.number if given.exists else float(TaskSpec.model_fields["time_limit"].default)


def _instants(task: Raw) -> Iterator[Fault]:
    """Give fixed switch times that no order of events can keep."""
    limit, earliest = _time_limit(task), 0.0
    for stage in task["stages"].entries():
        times = [time.number or 0.0 for time in stage["target"]["times"].entries()]
        lasts, at = max([0.0, stage["dwell"].number or 0.0, *times[-1:]]), stage["at"].number
        if at is not None and (at <= earliest or at < earliest + lasts):
            wanted = f"a time after {earliest + lasts:g} s (fixed times, dwells and trajectories take until then)"
            yield stage["at"].fault(wanted, f"{at:g} s")
        elif at is not None and limit is not None and at >= limit:
            yield stage["at"].fault(f"a time before the time_limit of {limit:g} s", f"{at:g} s")
        earliest = max(at or 0.0, earliest + lasts)


def _object(task: Raw) -> Iterator[Fault]:
    """Give an object that is let go before it is taken, and a payload that no stage holds."""
    thing, payload = task["object"], task["uncertainty"]["payload"]
    if payload.exists and not thing.exists:
        wanted = "one: it says which stages take the payload and let it go"
        yield payload.fault(wanted, 'no "object"', at_key=True)
    order = {name: index for index, name in enumerate(task["stages"].texts("name"))}
    taken, let_go = (order.get(thing[key].text or "") for key in ("taken_by", "let_go_by"))
    if taken is not None and let_go is not None and let_go <= taken:
        yield thing["let_go_by"].fault(f"a stage after {thing['taken_by'].text}, which takes the object")
    elif taken is not None and let_go is not None and let_go == taken + 1 and payload.exists:
        wanted = "at least one that holds the payload"
        yield payload.fault(wanted, "no stage between object.taken_by and object.let_go_by", at_key=True)


def _monitor(monitor: Raw) -> Iterator[Fault]:
    """Give a monitor that bounds nothing, contradicts itself or is about the wrong number of frames."""
    if isinstance(monitor.value, dict) and not any(monitor[bound].exists for bound in BOUNDS):
        yield monitor.fault(f"one of {', '.join(BOUNDS)}", "no bound", at_key=True)
    least, most = monitor["at_least"].number, monitor["at_most"].number
    if least is not None and most is not None and least > most:
        yield monitor["at_least"].fault(f"no more than at_most, {most:g}", f"{least:g}")
    frames = [frame.text for frame in monitor["of"].entries()]
    number = {"distance": 2, "speed": 1}.get(monitor["quantity"].text or "")
    if number is not None and frames and not len(frames) == len(set(frames)) == number:
        yield monitor["of"].fault("two different frames for a distance, one for a speed")


# Controller, solver and plant.


def _combinations(task: Raw) -> Iterator[Fault]:
    """Give what the controller or the solver of a task cannot do."""
    controller, solver = _kind(task["controller"], ControllerSpec), _kind(task["solver"], SolverSpec)
    nodes, deadline, htmpc = task["controller"]["nodes"], task["solver"]["deadline"], controller == "htmpc"
    inputs = [skill["input"] for _, skill in task["skills"].items() if skill["input"].text == "task"]
    joint = '"joint" (task needs solver ipopt, and another controller than htmpc)'
    rules = (
        (nodes, htmpc and nodes.text == "auto", "a number with controller htmpc, which compares levels node by node"),
        (deadline, deadline.exists and solver == "fatrop", "none with solver fatrop, which cannot stop early"),
        (deadline, deadline.exists and solver == "sqp" and htmpc, "none, or solver ipopt, with controller htmpc"),
        *((place, htmpc or solver in ("sqp", "fatrop"), joint) for place in inputs),
    )
    for place, conflicts, wanted in rules:
        if conflicts:
            yield place.fault(wanted)


def _kind(section: Raw, model: type[BaseModel]) -> str:
    """Return the kind of a section that also can be its kind alone."""
    return section.text or section["kind"].text or str(model.model_fields["kind"].default)


def _timing(task: Raw) -> Iterator[Fault]:
    """Give times of controller and plant that do not divide each other as they must, or into too many parts."""
    controller, plant = task["controller"].valid(ControllerSpec), task["plant"].valid(PlantSpec)
    if controller is None:
        return
    horizon, sample = controller.horizon, controller.sample_time
    if sample > horizon:
        yield task["controller"]["sample_time"].fault(f"at most the horizon of {horizon:g} s", f"{sample:g} s")
    if horizon > MOST_SAMPLES * sample * (1 + ROUNDING):
        yield task["controller"]["horizon"].fault(f"at most {MOST_SAMPLES} samples of {sample:g} s", f"{horizon:g} s")
    if plant is None:
        return
    tick, rate, hertz = 1 / plant.low_level_rate, task["plant"]["low_level_rate"], f"{plant.low_level_rate:g} Hz"
    step, place = plant.step or tick, rate if plant.step is None else task["plant"]["step"]
    if sample / step > MOST_STEPS * (1 + ROUNDING):
        yield place.fault(f"at most {MOST_STEPS}", f"{sample / step:.6g} steps in a sample of {sample:g} s")
        return
    if not _divides(tick, sample):
        yield rate.fault(f"a whole number of ticks in a sample_time of {sample:g} s", hertz)
    if not _divides(step, tick):
        yield place.fault(f"a whole number of steps in a tick of {tick:g} s (low_level_rate {hertz})", f"{step:g} s")


def _divides(part: float, whole: float) -> bool:
    """Tell whether a time is a whole number of parts."""
    ratio = whole / part
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= ROUNDING * ratio


# Priorities from paired comparisons.


def _priorities(task: Raw) -> Iterator[Fault]:
    """Give comparisons beside priorities, those that are no pair or repeat one, and those that disagree."""
    if not task["priorities"].exists:
        return
    for stage in task["stages"].entries():
        if stage["priority"].exists:
            found = '"priority" at a stage and "priorities" in the task'
            yield stage["priority"].fault("one or the other", found, at_key=True)
    stages, comparisons = task["stages"].texts("name"), task["priorities"]["compare"]
    first: dict[frozenset[str], Raw] = {}
    sound = len(stages) == len(set(stages)) == task["stages"].length
    for comparison in comparisons.entries():
        a, b = comparison[0].text, comparison[1].text
        if a is None or b is None:
            continue
        earlier = first.setdefault(frozenset((a, b)), comparison)
        sound = sound and a in stages and b in stages and a != b and earlier is comparison
        if a == b:
            yield comparison.fault("two different stages", f"{quoted(a)} compared with itself")
        elif earlier is not comparison:
            found = f"{quoted(a)} and {quoted(b)} compared again (first at {dotted(earlier.path)})"
            yield comparison.fault("every pair once", found)
    valid = task["priorities"].valid(PrioritiesSpec)
    if sound and valid is not None:
        yield from check_agreement(comparisons, valid, stages)


# Uncertainty.


def _uncertainty(task: Raw) -> Iterator[Fault]:
    """Give what the plant cannot do, and times outside the run."""
    place, controller = task["uncertainty"], task["controller"].valid(ControllerSpec)
    spec = place.valid(UncertaintySpec)
    if spec is None:
        return
    if controller is not None and controller.known_delay > spec.delay:
        wanted = f"at most uncertainty.delay, which is {counted(spec.delay, 'sample', 'samples')}"
        yield task["controller"]["known_delay"].fault(wanted)
    if controller is not None and spec.delay * controller.sample_time >= controller.horizon:
        found = f"{spec.delay} samples of {controller.sample_time:g} s"
        yield place["delay"].fault(f"less than the horizon of {controller.horizon:g} s", found)
    if _kind(task["plant"], PlantSpec) == "ideal" and spec.changes_the_plant:
        yield place.fault("only noise and delay with plant ideal, which has neither bodies nor forces")
    limit, impulse = _time_limit(task), spec.impulse
    if impulse is not None and not any((*impulse.linear, impulse.angular)):
        yield place["impulse"].fault("linear: [x, y] in N s, or angular in N m s", "no impulse", at_key=True)
    if impulse is not None and limit is not None and impulse.at >= limit:
        yield place["impulse"]["at"].fault(f"a time before the time_limit of {limit:g} s", f"{impulse.at:g} s")


def _shares(place: Raw, arms: list[str]) -> Iterator[Fault]:
    """Give missing shares of a payload, and shares whose sum is not 1."""
    yield from _by_part(place, dict.fromkeys(arms, ("1",)))
    given = dict(place.items())
    own = {arm: given.get(arm, given.get("arms", place)).number for arm in arms}
    numbers = [share for share in own.values() if share is not None]
    if len(numbers) == len(arms) and abs(sum(numbers) - 1) > ROUNDING:
        found = f"shares whose sum is {sum(numbers):g}"
        yield place.fault(f"1 over the {len(arms)} arms", found, at_key=True)
