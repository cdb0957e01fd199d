"""What reaction wheels store, where it is not measured, and what of it rows of stages that come later start from.

While wheels turn the base and nothing thrusts, what they store follows from the state, because the angular momentum of
everything about the inertial origin stays: `ocp/loads.py`. So nothing drifts that is followed by it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.ocp.loads import FOLLOWS, Load, known_load
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.robot.actuators.wheels import Wheels, clip_numbers


@dataclass(frozen=True, eq=False)
class WheelEstimate:
    """What wheels store at a sample.

    Attributes:
        momentum: Of each (W,) [N m s].
        time: Of the sample [s].
        Q, v: State of the robot then, (nq,) and (n,).
    """

    momentum: np.ndarray
    time: float
    Q: np.ndarray
    v: np.ndarray


class WheelEstimator:
    """Follows what the wheels of a problem's robot store."""

    def __init__(self, problem: Problem) -> None:
        self._model = problem.model
        self._loads = [known_load(problem.spec, problem.model, stage.index) for stage in problem.stages]
        self._coasts = [not stage.moved_by.is_pushed for stage in problem.stages]
        self.wheels = Wheels.of(problem.model.spec)

    def after_measurement(
        self,
        before: WheelEstimate | None,
        stage: int,
        time: float,
        Q: np.ndarray,
        v: np.ndarray,
        momentum: np.ndarray | None,
    ) -> WheelEstimate:
        """Return the momenta that reaction wheels store at a sample: measured, or else computed from the sample before.

        Args:
            before: That of the sample before; None at the first sample, which has the initial momenta.
            stage: Index of the stage in force since then.
            time: Of the sample [s].
            Q: Position of the robot (nq,).
            v: Its velocity (n,).
            momentum: Measured momenta (W,) [N m s]; NaN of a wheel that is not measured, None without any measurement.
        """
        expected = self.wheels.initial if before is None else self._momenta_after_motion(before, stage, time, Q, v)
        if momentum is not None:
            expected = np.where(np.isfinite(momentum), momentum, expected)
        return WheelEstimate(expected, time, Q, v)

    def stored_in_stages(
        self, estimate: WheelEstimate, stages: Iterable[tuple[int, np.ndarray, np.ndarray]]
    ) -> dict[int, np.ndarray]:
        """Return what limits on reaction wheels start from in each stage, by index of the stage.

        If nothing but wheels turns the base and nothing pushes it, angular momentum stays, and the momenta of wheels
        follow from the state: `stores` of the stage's load is then `FOLLOWS`, and this angular momentum about the
        inertial origin is returned (k,) [N m s]. In other stages it is what all wheels store together, along the base's
        axes (k,) [N m s]. k is 1 in the plane, 3 in space.

        Args:
            estimate: What the wheels store now.
            stages: The current stage and those after it, in order: index, Q (nq,) and v (n,) with which the stage
                begins; for the current stage those of now.
        """
        stored = dict[int, np.ndarray]()
        h = estimate.momentum
        before = None
        for stage, Q, v in stages:
            if before is not None and self._loads[before].stores == FOLLOWS:
                h = self._momenta_conserving(self._loads[before], stored[before], h, Q, v)
            if self._loads[stage].stores == FOLLOWS:
                stored[stage] = self._angular_momentum(self._loads[stage], h, Q, v)
            else:
                stored[stage] = self.wheels.axes @ h
            before = stage
        return stored

    def unseen(self, estimate: WheelEstimate) -> np.ndarray:
        """Return the part of momenta that adds up to nothing, which motors leave (W,) [N m s]."""
        return np.asarray(self.wheels.unseen @ estimate.momentum)

    def _momenta_after_motion(
        self, before: WheelEstimate, stage: int, time: float, Q: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """Return what wheels store after the motion since a sample (W,) [N m s]: by its end, or by known torques."""
        h = before.momentum
        load = self._loads[stage]
        if load.stores == FOLLOWS:
            momentum = self._angular_momentum(load, h, before.Q, before.v)
            return self._momenta_conserving(load, momentum, h, Q, v)
        if self._coasts[stage] or time <= before.time:
            return h
        duration = time - before.time
        torques = self.wheels.unloading_torques(h.tolist(), duration, clip_numbers)
        return h + duration * np.array(torques)

    def _momenta_conserving(
        self, load: Load, angular_momentum: np.ndarray, h: np.ndarray, Q: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """Return what wheels store in a state (W,) whose angular momentum about the inertial origin is (k,)."""
        numbers = np.concatenate([load.numbers[: -len(angular_momentum)], angular_momentum])
        stored = self._evaluate(load, "stored", Q, v, numbers)
        return np.asarray(self.wheels.allocation @ stored + self.wheels.unseen @ h)

    def _angular_momentum(self, load: Load, h: np.ndarray, Q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return that of robot, load and wheels with momenta h (W,) about the inertial origin (k,) [N m s]."""
        rotation = self._model.space.rotation
        of_bodies = self._evaluate(load, "momentum", Q, v, load.numbers)[rotation]
        return np.asarray(of_bodies + self.wheels.momentum_and_energy(Q[None], h[None])[0, rotation])

    def _evaluate(self, load: Load, name: str, Q: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return a function of the load's kind, `stored` or `momentum`, in a state."""
        kind = load.kind
        model = self._model
        function = model.cached(
            (WheelEstimator, kind, name),
            lambda: BatchFunction(kind.momentum_of_wheels(model) if name == "stored" else kind.momentum(model)),
        )
        chart = model.space.chart_at(Q)
        return np.asarray(function(chart.to_chart(Q[None], v[None])[0], chart.anchor, numbers)[0][0])
