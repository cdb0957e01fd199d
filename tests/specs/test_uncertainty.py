"""What of the robot and its measurements is uncertain."""

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.uncertainty import UncertaintySpec


def uncertainty(*changes: str) -> UncertaintySpec:
    return load_task("transport", [f"uncertainty.{change}" for change in changes]).spec.uncertainty


@pytest.mark.parametrize(
    ("change", "plant", "measurement"),
    [
        ("noise.position=1e-3", False, True),
        ("noise.angle=1e-3", False, True),
        ("noise.velocity=1e-3", False, True),
        ("noise.angular_velocity=1e-3", False, True),
        ("mass=0.1", True, False),
        ("inertia={arm_2: 0.1}", True, False),
        ("centre_of_mass=0.01", True, False),
        ("friction.coulomb={arm_1: [0, 0, 0.1]}", True, False),
        ("force_limits={base: 10}", True, False),
        ("impulse={at: 3, linear: [1, 0]}", True, False),
        ("payload={mass: 5, inertia: 0.7}", True, False),
        ("delay=2", False, False),
    ],
)
def test_uncertainty_is_of_the_plant_or_of_the_measurement(change: str, plant: bool, measurement: bool) -> None:
    spec = uncertainty(change)
    assert spec.in_force
    assert (spec.changes_the_plant, spec.measures_with_noise) == (plant, measurement)
    if plant:
        with pytest.raises(SpecError, match=r"with plant ideal, expected .*rk4 or mujoco: ideal has neither"):
            load_task("transport", ["plant=ideal", f"uncertainty.{change}"])
