"""Which runs have which datasets: a condition is a function of the recorded task, with the words that describe it."""

from collections.abc import Callable
from dataclasses import dataclass

from psmpc_cli.plant.uncertainty import force_limits_of
from psmpc_cli.robot.configuration import configuration_space
from psmpc_cli.specs.load import Task


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a log is recorded of, which says what datasets it has.

    Attributes:
        task: The task that is run.
        knows_ticks: Whether the true state is known at every tick.
        is_simulated: Whether psmpc simulates the plant, and knows what disturbs it and what becomes of the object.
        changes_targets: Whether targets of stages may change while it runs.
    """

    task: Task
    knows_ticks: bool
    is_simulated: bool
    changes_targets: bool = False


@dataclass(frozen=True, eq=False)
class Condition:
    """A condition under which logs have a dataset.

    Attributes:
        description: When it holds, as the end of the sentence "logs have this dataset ...".
        holds: Tells whether it holds of what is recorded.
    """

    description: str
    holds: Callable[[Recorded], bool]

    def __repr__(self) -> str:
        return f"<Condition: {self.description}>"


def _has_ticks(recorded: Recorded) -> bool:
    return recorded.task.spec.log.ticks and recorded.knows_ticks


def _has_force_limits(recorded: Recorded) -> bool:
    return force_limits_of(recorded.task.spec, recorded.task.robot) is not None


def _has_thrusters(recorded: Recorded) -> bool:
    spec = recorded.task.spec
    return recorded.is_simulated and spec.plant.traits.has_forces and spec.fires(recorded.task.robot)


def _avoids_plumes(recorded: Recorded) -> bool:
    spec = recorded.task.spec
    stages = range(len(spec.stages))
    return _has_thrusters(recorded) and any(spec.avoids_plumes(stage, recorded.task.robot) for stage in stages)


def _has_wheels(recorded: Recorded) -> bool:
    turns = recorded.task.spec.plant.traits.has_forces or not recorded.is_simulated
    return turns and bool(recorded.task.robot.wheels)


def _has_free_end(recorded: Recorded) -> bool:
    controller = recorded.task.spec.controller
    return controller.traits.one_stage and controller.plans_ends


def _is_spatial(recorded: Recorded) -> bool:
    space = configuration_space(recorded.task.robot)
    return space.nq > space.n


def _has_object(recorded: Recorded) -> bool:
    return recorded.is_simulated and recorded.task.spec.body.mass > 0.0


def _is_uncertain(recorded: Recorded) -> bool:
    return recorded.is_simulated and recorded.task.spec.is_uncertain


ALWAYS = Condition("in any case", lambda recorded: True)
TICKS = Condition("with log: {ticks: true}", _has_ticks)
PLANS = Condition("with log: {plans: true}", lambda recorded: recorded.task.spec.log.plans)
FORCE_LIMITS = Condition("where the robot or the task limits forces", _has_force_limits)
COMMANDED_AT_TICKS = Condition(
    "with log: {ticks: true} where the robot or the task limits forces",
    lambda recorded: _has_ticks(recorded) and _has_force_limits(recorded),
)
THRUSTERS = Condition("where the robot has thrusters", _has_thrusters)
THRUSTERS_AT_TICKS = Condition(
    "with log: {ticks: true} where the robot has thrusters",
    lambda recorded: _has_ticks(recorded) and _has_thrusters(recorded),
)
PLUMES = Condition("where a stage avoids plumes", _avoids_plumes)
WHEELS = Condition("where the robot has reaction wheels", _has_wheels)
WHEELS_AT_TICKS = Condition(
    "with log: {ticks: true} where the robot has reaction wheels",
    lambda recorded: _has_ticks(recorded) and _has_wheels(recorded),
)
CLEARANCE = Condition(
    "where the task keeps clear", lambda recorded: recorded.task.spec.keeps_clear and recorded.knows_ticks
)
TRIES = Condition("where a stage has if_missed", lambda recorded: recorded.task.spec.tries_again)
TARGETS_CHANGE = Condition("where targets may change while it runs", lambda recorded: recorded.changes_targets)
ROUTES = Condition("where the task has routes", lambda recorded: recorded.task.spec.routes is not None)
TASK_INPUT = Condition("where a skill has input: task", lambda recorded: recorded.task.spec.acts_in_task_space)
FREE_END = Condition("with one_stage: free_end", _has_free_end)
LEVELS = Condition("with controller htmpc", lambda recorded: recorded.task.spec.controller.traits.has_levels)
TRUE_STATE = Condition(
    "where the controller does not see the true state",
    lambda recorded: recorded.knows_ticks and not recorded.task.spec.sees_the_state,
)
UNCERTAIN = Condition("where the task has an uncertainty", _is_uncertain)
PAYLOAD = Condition(
    "where the task's uncertainty has a payload",
    lambda recorded: recorded.is_simulated and recorded.task.spec.uncertainty.carried.mass > 0.0,
)
SPEED_RESERVE = Condition(
    "with controller.speed_reserve", lambda recorded: recorded.task.spec.controller.speed_reserve > 0.0
)
DISTURBANCE = Condition("with controller.offset_free", lambda recorded: recorded.task.spec.controller.offset_free)
DELAY = Condition("unless controller.delay is 0", lambda recorded: recorded.task.spec.controller.delay != 0.0)
MASSES = Condition("with controller.masses: estimated", lambda recorded: recorded.task.spec.finds_masses)
LOAD = Condition(
    "with object.grasp.known or uncertainty.payload.known: estimated", lambda recorded: recorded.task.spec.finds_load
)
SPATIAL = Condition("of spatial robots", _is_spatial)
SLIDING_JOINTS = Condition("of robots with joints that slide", lambda recorded: bool(recorded.task.robot.sliding))
OBJECT = Condition("where the object has a mass", _has_object)
OBJECT_AT_TICKS = Condition(
    "with log: {ticks: true} where the object has a mass",
    lambda recorded: _has_object(recorded) and recorded.task.spec.log.ticks,
)
