import pytest

from psmpc_cli.cli.uncertainty import uncertainty_in_words
from psmpc_cli.specs.load import load_task


def words(*changes: str) -> list[str]:
    return uncertainty_in_words(load_task("transport", [f"uncertainty.{change}" for change in changes]).spec)


def test_nothing_is_said_where_there_is_nothing() -> None:
    assert words() == []
    assert words("mass={arms: 0}", "friction.coulomb={arms: [0, 0, 0]}", "noise.angle=0") == []


def test_everything_is_said_in_its_unit() -> None:
    found = words(
        "mass=0.1",
        "inertia={base: 0.05, arms: 0.2}",
        "centre_of_mass=0.01",
        "friction={viscous: 0.1, coulomb: {arms: [0.1, 0.1, 0.05]}}",
        "noise={position: 1e-3, angular_velocity: 2e-3}",
        "delay=2",
        "force_limits={base: [20, 20, 5]}",
        "impulse={at: 5, linear: [1, 0]}",
        "payload={mass: 5, inertia: 0.67, known: true}",
    )
    for line, parts in zip(
        found,
        (
            ("uncertain (seed 0): masses within 10 %",),
            ("inertias within base 5 %; arms 20 %",),
            ("centres of mass within 0.01 m",),
            ("viscous 0.1 N m s/rad", "Coulomb arms 0.1, 0.1, 0.05 N m beyond 0.02 rad/s"),
            ("position 0.001 m, angular velocity 0.002 rad/s",),
            ("2 samples late, unknown to the controller",),
            ("base 20, 20, 5 N, N m",),
            ("a blow to the base at 5 s: 1, 0 N s and 0 N m s",),
            ("5 kg and 0.67 kg m^2 in equal shares from the end of capture to the beginning of release", "counts in"),
        ),
        strict=True,
    ):
        assert all(part in line for part in parts), line


def test_a_payload_the_law_does_not_know_is_said_to_be_so() -> None:
    (line,) = words("payload={mass: 5, inertia: 0.67, share: {arm_1: 0.25, arm_2: 0.75}}")
    assert "in shares of arm_1 0.25; arm_2 0.75" in line
    assert line.endswith("which the low-level law does not know")


@pytest.mark.parametrize(
    ("known", "said"),
    [(0, "unknown to the controller"), (1, "1 of which the controller foresees"), (2, "as the controller foresees")],
)
def test_how_much_of_a_delay_is_foreseen_is_said(known: int, said: str) -> None:
    task = load_task("transport", ["uncertainty.delay=2", f"controller.known_delay={known}"]).spec
    assert uncertainty_in_words(task) == [f"uncertain (seed 0): controls reach the robot 2 samples late, {said}"]
