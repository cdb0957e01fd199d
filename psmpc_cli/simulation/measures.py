"""What is measured of a run: margins to limits, efforts, the physics' own balance, starts and ends of stages."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.controller import Command
from psmpc_cli.control.sequence import Switch
from psmpc_cli.logs.schema import Metrics, Sample
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.ocp.window import SHORTEST
from psmpc_cli.plant import Ticks
from psmpc_cli.plant.uncertainty import Contact
from psmpc_cli.simulation.setup import Experiment


@dataclass(frozen=True, eq=False)
class Balance:
    """Momentum less the impulse of the external wrench, energy less the work: constant if the physics is right.

    Attributes:
        momentum: At the start of the run (3,) [N s], [N m s].
        energy: At the start of the run [J].
        impulse: Of the external wrench since then (3,) [N s], [N m s].
        work: Of the generalized force since then [J].
    """

    momentum: np.ndarray
    energy: float
    impulse: np.ndarray
    work: float

    @classmethod
    def at(cls, momentum: np.ndarray, energy: float) -> "Balance":
        """Return the balance of a run that starts with this momentum (3,) and energy."""
        return cls(momentum, energy, np.zeros(3), 0.0)

    def after(self, happened: Ticks | Contact) -> "Balance":
        """Return the balance after a sample, or after an object was taken up or let go."""
        return replace(self, impulse=self.impulse + happened.impulse, work=self.work + happened.work)

    def drift(self, momentum: np.ndarray, energy: float) -> tuple[np.ndarray, float]:
        """Return the drift of momentum (3,) [N s, N m s] and of energy [J] where they are now this."""
        return momentum - self.momentum - self.impulse, energy - self.energy - self.work


@dataclass(frozen=True, eq=False)
class Observed:
    """What the closed loop knows of a sample around its command.

    Attributes:
        number: Of the sample.
        x: True state (2n,), before anything is taken up or let go.
        u: Accelerations that reached the robot over the ticks (M, n).
        presence, shares: By stage index, from counterfactual solves.
        balance: The balance after the ticks.
        payload_energy: What taking up or letting go added at the sample [J].
    """

    number: int
    x: np.ndarray
    u: np.ndarray
    presence: Mapping[int, float]
    shares: Mapping[int, float]
    balance: Balance
    payload_energy: float


def measure(experiment: Experiment, command: Command, ticks: Ticks, observed: Observed) -> Sample:
    """Measure a sample; how the motion went is of the true state where that is not the measured one."""
    uncertainty, u = experiment.uncertainty, observed.u
    x = command.x if experiment.task.sees_the_state else observed.x
    stage = experiment.stages[command.sequence.first]
    tick, since = np.diff(ticks.time), ticks.time[:1] - command.sequence.entered
    base = ticks.F[:, experiment.model.parts["base"]]
    position, velocity = _margins(stage, ticks, experiment.model.n)
    momentum_error, energy_error = observed.balance.drift(*uncertainty.kept(stage.index, ticks.X[-1]))
    deviation = ticks.X[-1] - command.plan.states_at(ticks.time[-1:])[0]
    metrics = Metrics(
        u=u,
        xi=experiment.model.poses(x[: experiment.model.n]).ravel(),
        stage_cost=float(experiment.costs.at(stage, x[None], u[:1], since)[0]),
        presence=observed.presence,
        shares=observed.shares,
        position_margin=position,
        velocity_margin=velocity,
        control_effort=float(tick @ (u * u).sum(axis=1)),
        base_force=float(tick @ np.linalg.norm(base[:, :-1], axis=1)),
        base_torque=float(tick @ np.abs(base[:, -1])),
        position_deviation=deviation[: experiment.model.n],
        velocity_deviation=deviation[experiment.model.n :],
        end_errors=_end_errors(experiment, command, ticks),
        momentum_error=momentum_error,
        energy_error=energy_error,
        true=x,
        held=uncertainty.holds(stage.index),
        payload_energy=observed.payload_energy,
    )
    return Sample(command, ticks, metrics, observed.number, len(experiment.stages))


def _margins(stage: Stage, ticks: Ticks, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest distance to a position and to a velocity limit over all ticks after the sample, (n,) each."""
    limits, Q, Qdot = stage.limits, ticks.X[1:, :n], ticks.X[1:, n:]
    position = np.minimum(Q.min(axis=0) - limits.position_low, limits.position_high - Q.max(axis=0))
    velocity = np.minimum(Qdot.min(axis=0) - limits.velocity_low, limits.velocity_high - Qdot.max(axis=0))
    return position, velocity


def state_at(times: np.ndarray, X: np.ndarray, time: float) -> np.ndarray:
    """Interpolate the state (2n,) at a time [s] among or soon after the times (M,) of states X (M, 2n).

    Between two of them the acceleration is taken for constant, and after the last it stays what it was.
    """
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    n, since = X.shape[1] // 2, time - times[k]
    acceleration = (X[k + 1, n:] - X[k, n:]) / (times[k + 1] - times[k])
    Qdot = X[k, n:] + since * acceleration
    return np.concatenate([X[k, :n] + since / 2 * (X[k, n:] + Qdot), Qdot])


def _end_errors(experiment: Experiment, command: Command, ticks: Ticks) -> dict[int, float]:
    """Return the end errors of stages that end by the plan before the next sample, by stage index.

    At their planned switch times, which may lie up to `SHORTEST` after it: so far the motion is carried on as it is.
    """
    found = {}
    for index, instant in enumerate(command.instants, start=command.sequence.first):
        if instant <= ticks.time[-1] + SHORTEST:
            x = state_at(ticks.time, ticks.X, float(instant))
            found[index] = experiment.costs.end_error(experiment.stages[index], x)
    return found


class StageClock:
    """Follows switch times and actual starts. Section "what is measured" of docs/formulation.md.

    The actual start of a stage is the first sample at which its presence in the control reaches a threshold; a stage
    that never does so before its time starts at the switch time that ends the stage before it.
    """

    def __init__(self, stages: int, epsilon: float, series: tuple[float, ...]) -> None:
        self.thresholds = np.array([*series, epsilon])
        self.switch_time = np.full(stages, np.nan)
        self._early = np.full((stages, len(self.thresholds)), np.nan)

    def update(self, sample: Sample) -> bool:
        """Take in a sample; return whether anything changed."""
        return self.note(sample.command.time, sample.command.switches, sample.metrics.presence)

    def note(self, time: float, switches: tuple[Switch, ...], presence: Mapping[int, float]) -> bool:
        """Take in the stages that ended and the presences at a sample [s]; return whether anything changed."""
        self.end(switches)
        changed = bool(switches)
        for stage, found in presence.items():
            starts = (found >= self.thresholds) & np.isnan(self._early[stage])
            self._early[stage, starts] = time
            changed |= bool(starts.any())
        return changed

    def end(self, switches: tuple[Switch, ...]) -> None:
        """Take in the switch times of stages that ended."""
        for switch in switches:
            self.switch_time[switch.stage] = switch.time

    @property
    def tables(self) -> dict[str, np.ndarray]:
        """The times as known so far, by their paths in the log."""
        regular = np.r_[0.0, self.switch_time[:-1]]
        starts = np.where(np.isnan(self._early), regular[:, None], self._early)
        return {
            "stages/switch_time": self.switch_time.copy(),
            "stages/actual_start": starts[:, -1],
            "stages/early": ~np.isnan(self._early[:, -1]),
            "stages/actual_start_by_epsilon": starts[:, :-1],
        }
