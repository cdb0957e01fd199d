"""What a task says of its uncertainty fits the rest of it: the plant, the object, times, and the parts of the robot."""

from collections.abc import Iterator, Mapping

from psmpc_cli.specs.checks.names import stage_names
from psmpc_cli.specs.checks.parts import check_keys, joints, wanted_length
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, counted, quoted
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import ControllerSpec, PlantSpec, TaskSpec, UncertaintySpec

PHYSICAL = ("mass", "inertia", "centre_of_mass", "friction", "force_limits", "impulse", "payload")
"""Keys that mean nothing to a plant without bodies and forces."""

WHOLE = 1e-6
"""By how much shares may miss the whole."""


def check_uncertainty(task: Cursor) -> Iterator[Fault]:
    """Give what the plant cannot do, a payload that nothing holds, and times outside the run."""
    place = task["uncertainty"]
    spec = place.valid(UncertaintySpec)
    if spec is None or not place.exists:
        return
    plant = task["plant"].valid(PlantSpec)
    if plant is not None and plant.kind == "ideal" and spec.changes_the_plant:
        found = ", ".join(key for key in PHYSICAL if place[key].exists)
        yield place.problem(
            f"found {found} with plant ideal, which has neither bodies nor forces; expected none but noise and delay, "
            "or plant: rk4 or mujoco"
        )
    if spec.payload is not None:
        yield from _payload(task)
    yield from _times(task, spec)


def check_known_delay(task: Cursor) -> Iterator[Fault]:
    """Give a delay that the controller knows of and that is not there."""
    controller, place = task["controller"].valid(ControllerSpec), task["uncertainty"]
    spec = place.valid(UncertaintySpec) if place.exists else UncertaintySpec()
    if controller is not None and spec is not None and controller.known_delay > spec.delay:
        known, most = controller.known_delay, counted(spec.delay, "sample", "samples")
        there = f"at most the {most} of uncertainty.delay" if spec.delay else "an uncertainty.delay as long at least"
        yield task["controller"]["known_delay"].problem(f"found {known}, expected {there}")


def check_uncertain_parts(task: Cursor, robot: RobotSpec) -> Iterator[Fault]:
    """Give unknown parts and wrong lengths, and shares of a payload that do not make the whole."""
    place = task["uncertainty"]
    arms = {name: size for name, size in robot.parts.items() if name != "base"}
    for key in ("mass", "inertia", "centre_of_mass"):
        yield from check_keys(place[key], robot.parts, complete=False)
    for by_part, parts in (
        (place["force_limits"], robot.parts),
        (place["friction"]["viscous"], arms),
        (place["friction"]["coulomb"], arms),
    ):
        yield from check_keys(by_part, parts, complete=False)
        yield from _lengths(by_part, parts)
    yield from _shares(place["payload"]["share"], arms)


def _payload(task: Cursor) -> Iterator[Fault]:
    """Give a payload without an object, or one that no stage holds."""
    place, names = task["uncertainty"]["payload"], stage_names(task)
    if not task["object"].exists:
        yield place.problem(
            'found no "object", expected one: it says which stages take the payload and let it go', True
        )
        return
    taken, let_go = task["object"]["taken_by"].text, task["object"]["let_go_by"].text
    if taken in names and let_go in names and names.index(let_go) == names.index(taken) + 1:
        yield place.problem(
            f"found no stage between {quoted(taken)}, which takes the object, and {quoted(let_go)}, which lets it go; "
            "expected at least one that holds the payload",
            True,
        )


def _times(task: Cursor, spec: UncertaintySpec) -> Iterator[Fault]:
    """Give a delay as long as the horizon, and an impulse after the run."""
    place, controller = task["uncertainty"], task["controller"].valid(ControllerSpec)
    if controller is not None and spec.delay * controller.sample_time >= controller.horizon:
        yield place["delay"].problem(
            f"found {spec.delay} samples of {controller.sample_time:g} s, expected less than the horizon of "
            f"{controller.horizon:g} s"
        )
    limit = task["time_limit"].number if task["time_limit"].exists else TaskSpec.model_fields["time_limit"].default
    if spec.impulse is not None and not any((*spec.impulse.linear, spec.impulse.angular)):
        yield place["impulse"].problem("found no impulse, expected linear: [x, y] in N s, or angular in N m s", True)
    if spec.impulse is not None and limit is not None and spec.impulse.at >= limit:
        yield place["impulse"]["at"].problem(
            f"found {spec.impulse.at:g} s, expected a time before the time_limit of {limit:g} s"
        )


def _lengths(place: Cursor, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give lists that are neither one number long nor as long as their part."""
    keys = [key for key, _ in place.items()]
    for key in keys:
        length = place[key].length
        for part in joints(key, parts):
            if length not in (None, 1, parts[part]) and not (key == "arms" and part in keys):
                yield place[key].problem(
                    f"found {place[key].found}, expected {wanted_length(part, parts[part])}, or one"
                )
                break


def _shares(place: Cursor, arms: Mapping[str, int]) -> Iterator[Fault]:
    """Give shares whose sum is not 1."""
    yield from check_keys(place, arms)
    by_arm = {arm: cursor.number for key, cursor in place.items() for arm in joints(key, arms)}
    by_arm |= {key: cursor.number for key, cursor in place.items() if key in arms}
    shares = [place.number] * len(arms) if place.number is not None else list(by_arm.values())
    numbers = [share for share in shares if share is not None]
    if len(numbers) == len(arms) and abs(sum(numbers) - 1) > WHOLE:
        yield place.problem(f"found shares whose sum is {sum(numbers):g}, expected 1 over the {len(arms)} arms", True)
