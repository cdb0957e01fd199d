"""Windows of the transport task's stages, for tests of ocp and solvers."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.end import StageProgress
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.reference import Trajectory
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window, on_mesh

N = 4

AnyStage = TypeVar("AnyStage", bound=Stage)


def window_over(stages: tuple[Stage, ...], **changes: Any) -> Window:
    """A window over some stages from a state between them, a second after the start of the run."""
    numbers: dict[str, Any] = {
        "stages": stages,
        "start": 1.0,
        "elapsed": 0.5,
        "x0": np.r_[np.linspace(-0.4, 0.4, 9), np.linspace(0.1, -0.1, 9)],
        "omega": np.array([stage.priority for stage in stages]),
        "offset": np.zeros(len(stages)),
        "scale": np.full(len(stages), 50.0),
        "horizon": 4.0,
        "pending_cost": 1.0,
        "terminal_cost": 0.0,
        "nodes": (N,) * len(stages),
    }
    return Window(**{**numbers, **changes})


def coasting(window: Window, *switch_times: float) -> Plan:
    """The plan without control from a window's state, on its mesh."""
    plan = resting_plan(window.start, window.horizon, 1, window.x0)
    return on_mesh(replace(plan, switch_times=np.array(switch_times, float)), window)


def moving(stage: Stage, seed: int = 1) -> Stage:
    """The stage with a target that moves along a line for 30 s."""
    values = np.random.default_rng(seed).standard_normal((2, len(stage.target)))
    return replace(stage, reference=Trajectory(np.array([0.0, 30.0]), values), target=values[-1])


def ending(stage: AnyStage, **changes: Any) -> AnyStage:
    """Return a stage with other fields of its end; bounds on rates may be one number for all."""
    rates = changes.get("rate_tolerance")
    if isinstance(rates, float):
        changes["rate_tolerance"] = np.full(len(changes.get("rows", stage.end.rows)), rates)
    return replace(stage, end=replace(stage.end, **changes))


def sequence_of(first: int, switch_times: Sequence[float] = (), entered: float = 0.0) -> MovingSequence:
    """Return a sequence of the current stage and one more for each planned switch time."""
    segments = tuple(range(first, first + len(switch_times) + 1))
    return MovingSequence(segments, np.array(switch_times, float), StageProgress(entered))
