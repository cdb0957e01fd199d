"""Times that must fit each other: horizon, samples, ticks of the low-level loop, steps of the integrator."""

from collections.abc import Iterator

from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.task import ControllerSpec, PlantSpec

WHOLE = 1e-6
"""By how much a ratio of times may miss a whole number."""

MOST_SAMPLES = 1000
"""Samples of a horizon."""

MOST_STEPS = 20_000
"""Steps of the integrator in a sample: more take seconds."""


def check_timing(task: Cursor) -> Iterator[Fault]:
    """Give times that do not divide each other as they must, or into too many parts."""
    controller, plant = task["controller"].valid(ControllerSpec), task["plant"].valid(PlantSpec)
    if controller is not None and controller.sample_time > controller.horizon:
        yield task["controller"]["sample_time"].problem(
            f"found {controller.sample_time:g} s, expected at most the horizon of {controller.horizon:g} s"
        )
    if controller is not None and controller.horizon > MOST_SAMPLES * controller.sample_time * (1 + WHOLE):
        yield task["controller"]["horizon"].problem(
            f"found {controller.horizon:g} s, expected at most {MOST_SAMPLES} samples of {controller.sample_time:g} s"
        )
    if plant is None:
        return
    tick = 1 / plant.low_level_rate
    if controller is not None and controller.sample_time / (plant.step or tick) > MOST_STEPS * (1 + WHOLE):
        key = "low_level_rate" if plant.step is None else "step"
        yield task["plant"][key].problem(
            f"found {controller.sample_time / (plant.step or tick):.6g} steps in a sample of "
            f"{controller.sample_time:g} s, expected at most {MOST_STEPS}"
        )
        return
    if controller is not None and not _divides(tick, controller.sample_time):
        ticks = controller.sample_time / tick
        yield task["plant"]["low_level_rate"].problem(
            f"found {plant.low_level_rate:g} Hz, which makes {ticks:.6g} ticks of a sample_time of "
            f"{controller.sample_time:g} s, expected a whole number of ticks"
        )
    if plant.step is not None and not _divides(plant.step, tick):
        yield task["plant"]["step"].problem(
            f"found {plant.step:g} s, which makes {tick / plant.step:.6g} steps of a tick of {tick:g} s "
            f"(low_level_rate {plant.low_level_rate:g} Hz), expected a whole number of steps"
        )


def _divides(part: float, whole: float) -> bool:
    """Tell whether a time is a whole number of parts."""
    ratio = whole / part
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= WHOLE * ratio
