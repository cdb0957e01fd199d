"""What one sample measures: margins to limits, efforts, the physics' own balance."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.decision import Decision
from psmpc_cli.control.offset_free import Offset
from psmpc_cli.control.sequence import Switch
from psmpc_cli.logs.record import LevelsRecord, Record, SolveRecord, TickRecord
from psmpc_cli.ocp.window import SHORTEST
from psmpc_cli.plant import Ticks
from psmpc_cli.plant.uncertainty import Contact
from psmpc_cli.simulation.end_error import end_error
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
class Sample:
    """What happened at a sample around its decision.

    Attributes:
        x: True state (2n,), before anything is taken up or let go.
        switches: Hand-overs since the last sample.
        contact: What taking up or letting go did.
        presence, shares: What was found aside, by stage index.
        u: Accelerations applied over the ticks (M, n).
        ticks: What the physics did.
        balance: The balance after them.
        offset: What is known of the disturbance, under offset-free control.
    """

    x: np.ndarray
    switches: tuple[Switch, ...]
    contact: Contact
    presence: dict[int, float]
    shares: dict[int, float]
    u: np.ndarray
    ticks: Ticks
    balance: Balance
    offset: Offset | None


def measure(experiment: Experiment, decision: Decision, sample: Sample) -> Record:
    """Return the record of a sample; how the motion went is of the true state where that is not the measured one."""
    n, uncertainty, seen = experiment.model.n, experiment.uncertainty, decision.x
    exact, ticks, u = experiment.task.sees_the_state, sample.ticks, sample.u
    x = seen if exact else sample.x
    stage = experiment.stages[decision.sequence.first]
    tick, since = np.diff(ticks.time), ticks.time[:1] - decision.sequence.entered
    base = experiment.model.parts["base"]
    position, velocity = _margins(experiment, decision, ticks)
    momentum_error, energy_error = sample.balance.drift(*uncertainty.kept(stage.index, ticks.X[-1]))
    return Record(
        time=float(ticks.time[0]),
        Q=seen[:n],
        Qdot=seen[n:],
        u=u[0],
        F=ticks.F[0],
        xi=experiment.model.poses(x[:n]).ravel(),
        window_first=decision.sequence.first,
        instants=decision.sequence.instants,
        nadir=decision.solved.window.scale[: decision.sequence.count],
        nodes=np.array(decision.solved.window.nodes[: decision.sequence.count], float),
        flags=_flags(decision),
        switches=tuple((switch.stage, switch.time) for switch in sample.switches),
        presence=sample.presence,
        solve=_solve_record(decision),
        stage_cost=float(experiment.costs.at(stage, x[None], u[:1], since)[0]),
        position_margin=position,
        velocity_margin=velocity,
        control_effort=float(tick @ np.sum(u**2, axis=1)),
        thruster_effort=np.array(
            [
                tick @ np.linalg.norm(ticks.F[:, base][:, :-1], axis=1),
                tick @ np.abs(ticks.F[:, base][:, -1]),
            ]
        ),
        momentum_error=momentum_error,
        energy_error=energy_error,
        ticks=TickRecord(ticks.time[:-1], ticks.X[:-1, :n], ticks.X[:-1, n:], ticks.F)
        if experiment.task.log.ticks
        else None,
        window_cost=np.zeros(0) if decision.fallback else decision.solved.costs,
        shares=sample.shares,
        levels=_levels_record(experiment, decision),
        basin=decision.solved.basin,
        plan_deviation=ticks.X[-1] - decision.plan.states_at(ticks.time[-1:])[0],
        end_errors=_end_errors(experiment, decision, ticks),
        true=None if exact else sample.x,
        disturbance=None if sample.offset is None else sample.offset.d,
        payload=(uncertainty.holds(stage.index), sample.contact.work) if uncertainty.spec.payload else None,
    )


def _margins(experiment: Experiment, decision: Decision, ticks: Ticks) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest distance to a position and to a velocity limit over all ticks after the sample, (n,) each."""
    limits, n = experiment.stages[decision.sequence.first].limits, experiment.model.n
    Q, Qdot = ticks.X[1:, :n], ticks.X[1:, n:]
    position = np.minimum(Q - limits.position_low, limits.position_high - Q).min(axis=0)
    velocity = np.minimum(Qdot - limits.velocity_low, limits.velocity_high - Qdot).min(axis=0)
    return position, velocity


def state_at(times: np.ndarray, X: np.ndarray, time: float) -> np.ndarray:
    """Return the state (2n,) at a time [s] among or soon after the times (M,) of states X (M, 2n).

    Between two of them the acceleration is taken for constant, and after the last it stays what it was.
    """
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    n, since = X.shape[1] // 2, time - times[k]
    acceleration = (X[k + 1, n:] - X[k, n:]) / (times[k + 1] - times[k])
    Qdot = X[k, n:] + since * acceleration
    return np.concatenate([X[k, :n] + since / 2 * (X[k, n:] + Qdot), Qdot])


def _end_errors(experiment: Experiment, decision: Decision, ticks: Ticks) -> dict[int, float]:
    """Return the end errors of stages that hand over by the plan before the next sample, by stage index.

    At their instants, which may lie up to `SHORTEST` after it: so far the motion is carried on as it is.
    """
    found = {}
    for index, instant in enumerate(decision.sequence.instants, start=decision.sequence.first):
        if instant <= ticks.time[-1] + SHORTEST:
            x = state_at(ticks.time, ticks.X, float(instant))
            found[index] = end_error(experiment.costs, experiment.stages[index], x)
    return found


def _flags(decision: Decision) -> frozenset[str]:
    happened = {
        "appended": decision.appended,
        "postponed": decision.postponed,
        "fallback": decision.fallback,
        "braking": decision.exhausted,
        "unmeasured": decision.unmeasured,
    }
    return frozenset(name for name, yes in happened.items() if yes)


def _levels_record(experiment: Experiment, decision: Decision) -> LevelsRecord | None:
    """Return the record of the levels of a lexicographic controller; None under any other."""
    if not decision.levels:
        return None
    stages = len(experiment.stages)
    objective, cost, wall_time = (np.full(stages, np.nan) for _ in range(3))
    solved = np.full(stages, -1)
    for stage, level in enumerate(decision.levels, start=decision.sequence.first):
        wall_time[stage], solved[stage] = level.wall_time, level.outcome.usable
        if level.outcome.usable:
            objective[stage] = level.costs[-1]
            cost[stage + 1 - len(level.costs) : stage + 1] = level.costs
    return LevelsRecord(objective, cost, wall_time, solved)


def _solve_record(decision: Decision) -> SolveRecord:
    """Return the record of a solve; the objective is in the task's own priorities.

    Under lexicographic control time, iterations and status are those of all levels together; the last one is the one
    that may have failed. The rest is the first level's.
    """
    solved = decision.solved
    levels = decision.levels or (solved,)
    return SolveRecord(
        status=levels[-1].outcome.name.lower(),
        iterations=sum(level.iterations for level in levels),
        wall_time=sum(level.wall_time for level in levels),
        objective=solved.J,
        guess=solved.guess.flat,
        warm=solved.warm,
        guess_multipliers=solved.guess_duals,
        parameters=solved.window.numbers,
        solution=solved.plan.flat,
    )
