"""The one loop over ticks: a physics of one's own has noise, pushes, limits and laws like the plants of psmpc."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.plant import Disturbance, ForceLimits, JointFriction
from psmpc_cli.plant.adaptive import AdaptiveDynamics
from psmpc_cli.plant.base import Setpoints, TickedPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel

TICK, M = 1e-3, 20
LIMITS = ForceLimits(np.full(9, -2.0), np.full(9, 2.0))

INTEGRATION = 1e-9
"""Difference of the states by both integrators: their tolerances are 1e-12 a tick, and rk4's error is 1e-13."""


class Adaptive(TickedPlant):
    """The rigid-body dynamics by the integrator of a library; it says of impulse and work that there are none."""

    def __init__(self, model: RobotModel, force_limits: ForceLimits | None = None) -> None:
        super().__init__(LowLevelLaw(model), TICK, force_limits)
        self._dynamics = AdaptiveDynamics(model)

    def step(self, x: np.ndarray, F: np.ndarray, robot: InertialParameters) -> tuple[np.ndarray, np.ndarray]:
        after = self._dynamics.integrate("force", x, np.array([0.0, TICK]), F[None]).states[-1]
        return after, np.zeros(self.model.space.n_twist + 1)


@pytest.fixture
def u() -> np.ndarray:
    return np.tile(np.linspace(-0.3, 0.3, 9), (M, 1))


@pytest.fixture
def disturbance(model: RobotModel) -> Disturbance:
    """Noise at every tick, a law that takes the bodies for lighter, and a push."""
    random = np.random.default_rng(9)
    external_force = np.zeros((M, 9))
    external_force[7, :3] = [300.0, -200.0, 40.0]
    none = Disturbance.none(model.nominal, M, 9)
    law = replace(model.nominal, mass=0.9 * model.nominal.mass)
    return replace(none, law=law, noise=1e-3 * random.standard_normal((M, 18)), external_force=external_force)


@pytest.mark.parametrize("limits", [None, LIMITS], ids=["free", "limited"])
def test_the_loop_is_that_which_rk4_has_compiled(
    model: RobotModel, x: np.ndarray, u: np.ndarray, disturbance: Disturbance, limits: ForceLimits | None
) -> None:
    rk4 = Rk4Plant(model, TICK, friction=JointFriction.none(9), force_limits=limits)
    expected = rk4.advance(1.5, x, Setpoints(u), disturbance)
    ticks = Adaptive(model, limits).advance(1.5, x, Setpoints(u), disturbance)
    np.testing.assert_array_equal(ticks.time, expected.time)
    np.testing.assert_allclose(ticks.states, expected.states, rtol=0, atol=INTEGRATION)
    np.testing.assert_allclose(ticks.F, expected.F, rtol=0, atol=1e-6)  # N, N m: forces of states that differ so
    if limits is None:
        assert ticks.commanded is expected.commanded is None
    else:
        assert np.abs(ticks.F).max() <= 2.0 * np.sqrt(2) < np.abs(ticks.commanded).max()
        np.testing.assert_allclose(ticks.commanded, expected.commanded, rtol=0, atol=1e-6)


class Resting(LowLevelLaw):
    """A law whose actuators rest while hands hold an object."""

    def force(
        self,
        Q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        twist_rates: np.ndarray | None = None,
        grasps: np.ndarray | None = None,
        parameters: InertialParameters | None = None,
        driven: tuple[float, ...] | None = None,
    ) -> np.ndarray:
        return super().force(Q, v, u, twist_rates, None, parameters) if grasps is None else np.zeros(9)


def test_the_law_knows_at_each_tick_what_hands_hold(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    class Holding(Adaptive):
        def begin_tick(self, time: float, x: np.ndarray, closed: bool) -> np.ndarray | None:
            return np.zeros((2, 5)) if closed else None

    closed = np.arange(M) >= 12
    plant = Holding(model)
    plant.law = Resting(model)
    ticks = plant.advance(0.0, x, Setpoints(u, closed=closed))
    assert (ticks.F[closed] == 0).all()
    np.testing.assert_array_equal(ticks.F[~closed], Adaptive(model).advance(0.0, x, Setpoints(u)).F[~closed])
