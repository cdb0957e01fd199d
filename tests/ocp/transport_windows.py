"""Windows of the transport task's stages, for tests of ocp and solvers."""

from dataclasses import replace
from typing import Any

import numpy as np

from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.stage import Stage, Trajectory
from psmpc_cli.ocp.window import Window, on_mesh

N = 4


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


def coasting(window: Window, *instants: float) -> Plan:
    """The plan without control from a window's state, on its mesh."""
    plan = resting_plan(window.start, window.horizon, 1, window.x0)
    return on_mesh(replace(plan, instants=np.array(instants, float)), window)


def moving(stage: Stage, seed: int = 1) -> Stage:
    """The stage with a target that moves along a line for 30 s."""
    values = np.random.default_rng(seed).standard_normal((2, len(stage.target)))
    return replace(stage, trajectory=Trajectory(np.array([0.0, 30.0]), values), target=values[-1])
