"""Conditions of datasets: which hold of which task."""

import pytest

from psmpc_cli.logs import conditions
from psmpc_cli.logs.conditions import Condition, Recorded
from psmpc_cli.logs.schema import SCHEMA, condition_of, conditions_of
from psmpc_cli.specs.load import load_task

USUAL = {conditions.ALWAYS, conditions.PLANS, conditions.DELAY}

TICKS = "log.ticks=true"


def recorded(task: str, *changes: str, knows_ticks: bool = True, is_simulated: bool = True) -> Recorded:
    return Recorded(load_task(task, changes), knows_ticks, is_simulated)


@pytest.mark.parametrize(
    ("task", "changes", "more"),
    [
        ("transport", (), set()),
        ("transport", (TICKS,), {conditions.TICKS}),
        ("transport", ("controller.kind=htmpc",), {conditions.LEVELS}),
        ("transport", ("controller.kind=hard", "controller.one_stage=free_end"), {conditions.FREE_END}),
        ("transport", ("controller.offset_free=true",), {conditions.DISTURBANCE}),
        ("transport", ("controller.speed_reserve=3",), {conditions.SPEED_RESERVE}),
        ("transport", ("uncertainty.mass=0.1",), {conditions.UNCERTAIN}),
        ("transport", ("uncertainty.noise.position=1e-3",), {conditions.UNCERTAIN, conditions.TRUE_STATE}),
        (
            "transport",
            ("uncertainty.payload={mass: 1, inertia: 1}",),
            {conditions.UNCERTAIN, conditions.PAYLOAD},
        ),
        (
            "transport_grasp",
            (TICKS,),
            {
                conditions.OBJECT,
                conditions.OBJECT_AT_TICKS,
                conditions.FORCE_LIMITS,
                conditions.COMMANDED_AT_TICKS,
                conditions.TICKS,
            },
        ),
        ("fly_and_point", (), {conditions.SPATIAL, conditions.FORCE_LIMITS}),
        ("turn_and_look", (), {conditions.SPATIAL, conditions.FORCE_LIMITS, conditions.WHEELS}),
        (
            "turn_and_look",
            (TICKS,),
            {
                conditions.SPATIAL,
                conditions.FORCE_LIMITS,
                conditions.COMMANDED_AT_TICKS,
                conditions.TICKS,
                conditions.WHEELS,
                conditions.WHEELS_AT_TICKS,
            },
        ),
        ("thrust_and_reach", (), {conditions.THRUSTERS, conditions.FORCE_LIMITS}),
        (
            "thrust_and_reach",
            (TICKS,),
            {
                conditions.THRUSTERS,
                conditions.THRUSTERS_AT_TICKS,
                conditions.FORCE_LIMITS,
                conditions.COMMANDED_AT_TICKS,
                conditions.TICKS,
            },
        ),
    ],
)
def test_a_task_has_its_conditions(task: str, changes: tuple[str, ...], more: set[Condition]) -> None:
    assert conditions_of(recorded(task, *changes)) == USUAL | more


def test_what_only_the_simulation_knows_is_not_recorded_of_a_loop_of_ones_own() -> None:
    """Nobody knows there what is drawn, or what becomes of the object."""
    loop = recorded("transport_grasp", "uncertainty.mass=0.1", TICKS, is_simulated=False)
    assert not conditions_of(loop) & {conditions.UNCERTAIN, conditions.OBJECT, conditions.OBJECT_AT_TICKS}


def test_what_is_known_at_ticks_alone_is_not_recorded_without_them() -> None:
    loop = recorded("transport", "uncertainty.noise.position=1e-3", TICKS, knows_ticks=False)
    assert not conditions_of(loop) & {conditions.TICKS, conditions.TRUE_STATE}


def test_every_condition_is_that_of_a_dataset_and_has_a_description_of_its_own() -> None:
    defined = {value for value in vars(conditions).values() if isinstance(value, Condition)}
    assert {column.only for column in SCHEMA} == defined
    assert len({condition.description for condition in defined}) == len(defined)


def test_lengths_of_rows_have_the_condition_of_their_dataset() -> None:
    assert condition_of("plan/guess_length") is conditions.PLANS
    assert condition_of("plan/nothing") is None
