"""Controllers stepped by hand on a plant that follows their plans exactly."""

from typing import NamedTuple

import numpy as np

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robots.robot import stack


class Mission(NamedTuple):
    """What a controller decided from the start of its task to the end.

    Attributes:
        commands: One a sample.
        switches: The switch times [s].
        state: The final state.
    """

    commands: list[Command]
    switches: list[float]
    state: State


def stepped(task: Task, longest: float = 60.0) -> Mission:
    """Step the controller of a task until it is done.

    Args:
        task: The task, of a robot in the plane or in space.
        longest: Time at which the mission has to be done at the latest [s].
    """
    controller = Controller(task)
    Q = stack(task.spec.initial, task.robot, "joint")
    state = State(Q, np.zeros(controller.problem.model.n))
    time = 0.0
    commands = list[Command]()
    while not controller.done and time < longest:
        command = controller.step(time, state)
        commands.append(command)
        time = round(time + task.spec.controller.sample_time, 6)
        positions, velocities = command.plan.chart.from_chart(command.plan.states_at(np.array([time])))
        state = State(positions[0], velocities[0])
    assert controller.done
    switches = [switch.time for command in commands for switch in command.switches]
    return Mission(commands, switches, state)
