"""How a robot drifts in stages in which nothing pushes it, as far as a task tells before anything is solved.

Its common centre of mass moves at p / M, with the linear momentum p that the last stage leaves in which thrusters push
it. What that stage ends with is in its end condition: `moving`, and how near to it the rates must be.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.feasibility.forecast import (
    StageForecast,
    coordinate_of_row,
    forecast_configurations,
    initial_state,
    tolerances_of,
)
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import furthest_centre
from psmpc_cli.specs.load import Task


@dataclass(frozen=True, eq=False)
class Drift:
    """The drift of a robot in a stage in which nothing pushes it.

    Attributes:
        stage: The stage.
        before: The last stage before it that decides the momentum; None where that is the start.
        velocity: Of the common centre of mass (d,) [m/s], in a stage with a target on the object relative to that.
        spread: By how much it may be another after the end condition of `before` [m/s]; infinite if that does not say.
        displacement: From where the centre of mass is when the drift begins to where it is at the stage's target, (d,)
            [m]; 0 along axes that the stage does not ask for, empty where it does not want the base at a place.
        allowance: How far from there the end condition, or arms that are free, let it be [m].
        lasts: For how long the stage lasts at least [s].
        time_limit: When the run is stopped [s].
    """

    stage: Stage
    before: Stage | None
    velocity: np.ndarray
    spread: float
    displacement: np.ndarray
    allowance: float
    lasts: float
    time_limit: float

    @property
    def speed(self) -> float:
        """How fast the centre of mass moves [m/s]."""
        return float(np.linalg.norm(self.velocity))

    @property
    def nearest_after(self) -> float:
        """When the centre of mass is nearest to where the stage wants it, since the drift began [s]."""
        along = self.velocity[: len(self.displacement)] * (self.displacement != 0)
        square = float(along @ along)
        return float(np.clip(self.displacement @ along / square, 0.0, self.time_limit)) if square else 0.0

    @property
    def miss(self) -> float:
        """By how much it misses that place at least [m]; 0 where it may reach it, or is not wanted at one."""
        if not len(self.displacement):
            return 0.0
        after = self.nearest_after
        left = float(np.linalg.norm(self.displacement - after * self.velocity * (self.displacement != 0)))
        return max(left - self.allowance - self.spread * self.time_limit, 0.0)


def drifts(task: Task, forecasts: Sequence[StageForecast]) -> Iterator[Drift]:
    """Yield how the robot drifts in each stage in which nothing pushes it: how fast, and whether to its target.

    A stage whose base is pushed, or held by a mount, decides the momentum by its end condition; stages without
    thrusters go on with that of the last such stage, or of the start. It ends before the first stage that holds an
    object with a mass, which brings momentum of its own.

    Args:
        task: The task.
        forecasts: What is known of each stage before a run: the stage, and how far its targets are for the arms.
    """
    model = forecasts[0].model
    stops = forecast_configurations(task, forecasts)  # coordinates at the start and at every stage's target
    held = task.spec.carrying_stages
    d = model.dimension
    before: Stage | None = None
    Q, v = initial_state(task)
    velocity = _centre_velocity(model, Q, v)
    spread = 0.0
    for number, forecast in enumerate(forecasts):
        stage = forecast.stage
        if held and number >= held.start:
            return
        if stage.moved_by.is_pushed or not stage.moved_by.moves:  # it decides the momentum of those after it
            before = stage
            Q = stops[number + 1]
            velocity = _centre_velocity(model, Q, _rates_at_end(model, stage))
            if stage.on_object:  # the rates of such an end are relative to the object
                velocity = velocity + np.array(task.spec.body.motion.linear)[:d]
            spread = _spread_of_velocity(model, stage)
            continue
        displacement = np.zeros(0)
        relative = velocity
        allowance = 0.0
        is_asked = stage.relevant_rows[:d]
        if is_asked.any():
            displacement = np.where(is_asked, model.centre_of_mass(stops[number + 1]) - model.centre_of_mass(Q), 0.0)
            within = tolerances_of(model.space, stage)
            allowance = float(np.linalg.norm([within.get(row, 0.0) for row in range(d)]))
            # If the stage does not ask for the arms, they may be anywhere and move the base about the centre of mass.
            if not stage.relevant_rows[model.space.n_twist :].any():
                allowance += furthest_centre(task.robot, stage.limits)
            if stage.on_object:
                relative = velocity - np.array(task.spec.body.motion.linear)[:d]
        yield Drift(
            stage=stage,
            before=before,
            velocity=relative,
            spread=spread,
            displacement=displacement,
            allowance=allowance,
            lasts=stage.end.dwell,
            time_limit=task.spec.time_limit,
        )


def _centre_velocity(model: RobotModel, Q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the velocity of the common centre of mass (d,) [m/s]."""
    mass = sum(body.mass for body in model.spec.bodies)
    return np.asarray(model.momentum(Q, v)[: model.dimension] / mass)


def _rates_at_end(model: RobotModel, stage: Stage) -> np.ndarray:
    """Return the rates (n,) with which a stage is to end; 0 of what its end condition does not name, and on a mount."""
    rates = np.zeros(model.n)
    coordinates = coordinate_of_row(stage)
    if len(stage.end.own_rates):
        for row in coordinates.keys() & set(stage.end.rows):
            rates[coordinates[row]] = stage.end.own_rates[row]
    return rates


def _spread_of_velocity(model: RobotModel, stage: Stage) -> float:
    """Return by how much the velocity of the centre of mass may differ after a stage from what its end asks for [m/s].

    The end condition bounds it if it bounds the linear momentum, or the velocity of the base along all axes, where the
    arms are taken to be at rest; the smaller bound counts. It is infinite where the end condition bounds neither, and 0
    where a mount holds the base.
    """
    if not stage.moved_by.moves:
        return 0.0
    mass = sum(body.mass for body in model.spec.bodies)
    spreads = [bound.most / mass for bound in stage.end.norms if bound.measure == "linear_momentum"]
    rates = dict[int, float]()
    if stage.end.rate_tolerance is not None:
        rates = dict(zip(stage.end.rows, stage.end.rate_tolerance.tolist(), strict=True))
    of_base = [rates.get(row, np.inf) for row in range(model.dimension)]  # rows of the error begin with the position
    return min([*spreads, float(np.linalg.norm(of_base))])
