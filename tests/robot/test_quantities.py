import numpy as np

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.quantities import Quantities


def test_they_are_those_of_the_model(model: RobotModel) -> None:
    x = np.random.default_rng(1).standard_normal(2 * model.n)
    Q, Qdot = x[: model.n], x[model.n :]
    quantities = Quantities(model)
    momentum, energy = quantities.momentum_and_energy(x)
    np.testing.assert_allclose(quantities.poses(x), np.asarray(model.g(Q)).ravel(), rtol=1e-12)
    np.testing.assert_allclose(momentum, np.asarray(model.momentum(Q, Qdot)).ravel(), rtol=1e-12)
    np.testing.assert_allclose(energy, float(model.kinetic_energy(Q, Qdot)), rtol=1e-12)
