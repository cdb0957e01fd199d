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
        ("impulse={at: 3, linear: [1, 0]}", True, False),
        ("payload={mass: 5, inertia: 0.7}", True, False),
        ("delay=0.2 s", False, False),
        ("jitter=0.02", False, False),
    ],
)
def test_uncertainty_is_of_the_plant_or_of_the_measurement(change: str, plant: bool, measurement: bool) -> None:
    spec = uncertainty(change)
    assert spec.in_force
    assert (spec.changes_the_plant, spec.measures_with_noise) == (plant, measurement)
    if plant:
        with pytest.raises(SpecError, match=r"with plant ideal, expected .*rk4 or mujoco: ideal has neither"):
            load_task("transport", ["plant=ideal", f"uncertainty.{change}"])


def test_a_share_of_the_force_limits_changes_the_plant_unless_it_is_1() -> None:
    limits = "limits={base: {force: [10, 10, 3]}}"
    less = load_task("transport", [limits, "uncertainty.force_share={base: 0.9}"])
    assert less.spec.uncertainty.in_force
    assert less.spec.uncertainty.changes_the_plant and not less.spec.uncertainty.measures_with_noise
    whole = load_task("transport", [limits])
    assert less.digest != whole.digest
    for share in ("1", "{base: 1, arms: 1.0}"):
        same = load_task("transport", [limits, f"uncertainty.force_share={share}"])
        assert not same.spec.uncertainty.in_force and not same.spec.uncertainty.changes_the_plant
        assert same.digest == whole.digest


ESTIMATED_PAYLOAD = "uncertainty.payload={mass: 5, inertia: 0.7, known: estimated}"


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        (["uncertainty.payload={mass: 5, inertia: 0.7, known: maybe}"], "uncertainty.payload.known", "or estimated"),
        ([ESTIMATED_PAYLOAD, "controller.masses=estimated"], "uncertainty.payload.known", "true or false"),
        (["controller.load_prior={mass: 3}"], "object", "uncertainty.payload.known: estimated"),
        ([ESTIMATED_PAYLOAD, "controller.load_prior={mass: -3}"], "controller.load_prior.mass", "greater than 0"),
    ],
)
def test_payloads_that_cannot_be_found_out(changes: list[str], path: str, words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_task("transport", changes)
    assert f"{path}: " in str(error.value) and words in str(error.value)


def test_a_payload_that_is_found_out_may_have_a_prior() -> None:
    task = load_task("transport", [ESTIMATED_PAYLOAD, "controller.load_prior={mass: 3}"])
    assert task.spec.finds_load
    assert not load_task("transport", [ESTIMATED_PAYLOAD.replace("estimated", "true")]).spec.finds_load
