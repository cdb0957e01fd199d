"""A task's uncertainty in words."""

from collections.abc import Iterator, Mapping

from psmpc_cli.specs.messages import counted
from psmpc_cli.specs.task import FrictionSpec, ObjectSpec, PayloadSpec, TaskSpec, UncertaintySpec

NOISE_UNITS = {"position": "m", "angle": "rad", "velocity": "m/s", "angular_velocity": "rad/s"}


def uncertainty_in_words(task: TaskSpec) -> list[str]:
    """Return a line for all the controller of a task does not know, and for delays; none where there is nothing."""
    spec = task.uncertainty
    found = [*_robot(spec), *_measurement(spec), *_delay(spec.delay, task.controller.known_delay), *_forces(spec)]
    if spec.payload is not None and task.object is not None:
        found.append(_payload(spec.payload, task.object))
    return [f"uncertain (seed {task.seed}): {found[0]}", *found[1:]] if found else []


def _robot(spec: UncertaintySpec) -> Iterator[str]:
    for value, what, factor, unit in (
        (spec.mass, "masses", 100, " %"),
        (spec.inertia, "inertias", 100, " %"),
        (spec.centre_of_mass, "centres of mass", 1, " m"),
    ):
        if _any(value):
            yield f"{what} within {_amounts(value, factor, unit)} of the described ones"
    if friction := _friction(spec.friction):
        yield f"friction in the joints, {friction}"


def _friction(spec: FrictionSpec) -> str:
    viscous = f"viscous {_amounts(spec.viscous, 1, ' N m s/rad')}" if _any(spec.viscous) else ""
    dry = f"Coulomb {_amounts(spec.coulomb, 1, ' N m')} beyond {spec.width:g} rad/s" if _any(spec.coulomb) else ""
    return ", ".join(part for part in (viscous, dry) if part)


def _measurement(spec: UncertaintySpec) -> Iterator[str]:
    noise = {name: getattr(spec.noise, name) for name in NOISE_UNITS}
    if spec.measures_with_noise:
        said = [f"{name.replace('_', ' ')} {noise[name]:g} {unit}" for name, unit in NOISE_UNITS.items() if noise[name]]
        yield f"noise of the measurement, standard deviation of {', '.join(said)}"


def _delay(delay: int, known: int) -> Iterator[str]:
    if delay:
        foreseen = {0: "unknown to the controller", delay: "as the controller foresees"}
        some = f"{known} of which the controller foresees"
        yield f"controls reach the robot {counted(delay, 'sample', 'samples')} late, {foreseen.get(known, some)}"


def _forces(spec: UncertaintySpec) -> Iterator[str]:
    if spec.force_limits:
        yield f"forces limited to {_amounts(spec.force_limits, 1, '')} N, N m"
    if (blow := spec.impulse) is not None:
        linear = ", ".join(f"{part:g}" for part in blow.linear)
        yield f"a blow to the base at {blow.at:g} s: {linear} N s and {blow.angular:g} N m s"


def _payload(payload: PayloadSpec, target: ObjectSpec) -> str:
    share = "in equal shares" if payload.share is None else f"in shares of {_amounts(payload.share, 1, '')}"
    known = "which the low-level law counts in" if payload.known else "which the low-level law does not know"
    return (
        f"a payload of {payload.mass:g} kg and {payload.inertia:g} kg m^2 {share} from the end of {target.taken_by} to "
        f"the beginning of {target.let_go_by}, {known}"
    )


def _any(value: float | Mapping[str, float] | Mapping[str, tuple[float, ...]]) -> bool:
    """Tell whether any of the numbers is not 0."""
    entries = value.values() if isinstance(value, Mapping) else (value,)
    return any(any(entry) if isinstance(entry, tuple) else entry for entry in entries)


def _amounts(value: float | Mapping[str, float] | Mapping[str, tuple[float, ...]], factor: float, unit: str) -> str:
    """Write one number, or numbers by part."""
    if not isinstance(value, Mapping):
        return f"{factor * value:g}{unit}"
    said = []
    for part, entry in value.items():
        numbers = entry if isinstance(entry, tuple) else (entry,)
        said.append(f"{part} {', '.join(f'{factor * number:g}' for number in numbers)}{unit}")
    return "; ".join(said)
