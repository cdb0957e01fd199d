import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.task import UncertaintySpec


def uncertainty(*changes: str) -> UncertaintySpec:
    return load_task("transport", [f"uncertainty.{change}" for change in changes]).spec.uncertainty


def test_a_task_has_none_unless_it_says_so() -> None:
    assert not load_task("transport").spec.uncertainty.in_force
    assert not uncertainty("mass=0", "noise.position=0", "friction.viscous={arms: 0}", "delay=0").in_force


@pytest.mark.parametrize("noise", ["position", "angle", "velocity", "angular_velocity"])
def test_any_noise_is_noise(noise: str) -> None:
    spec = uncertainty(f"noise.{noise}=1e-3")
    assert spec.measures_with_noise
    assert spec.in_force
    assert not spec.changes_the_plant


@pytest.mark.parametrize(
    "change",
    [
        "mass=0.1",
        "inertia={arm_2: 0.1}",
        "centre_of_mass=0.01",
        "friction.coulomb={arm_1: [0, 0, 0.1]}",
        "force_limits={base: 10}",
        "impulse={at: 3, linear: [1, 0]}",
        "payload={mass: 5, inertia: 0.7}",
    ],
)
def test_bodies_and_forces_change_the_plant_and_not_the_measurement(change: str) -> None:
    spec = uncertainty(change)
    assert spec.changes_the_plant
    assert not spec.measures_with_noise


def test_a_delay_changes_neither_plant_nor_measurement() -> None:
    spec = uncertainty("delay=2")
    assert spec.in_force
    assert not (spec.changes_the_plant or spec.measures_with_noise)


@pytest.mark.parametrize("change", ["mass=0.1", "force_limits={base: 10}", "payload={mass: 5, inertia: 0.7}"])
def test_the_ideal_plant_has_no_bodies_to_be_uncertain_of(change: str) -> None:
    changes = ["plant=ideal", f"uncertainty.{change}"]
    with pytest.raises(SpecError, match="with plant ideal, which has neither bodies nor forces"):
        load_task("transport", changes)
    assert load_task("transport", ["plant=ideal", "uncertainty={delay: 1, noise: {angle: 0.1 deg}}"])
