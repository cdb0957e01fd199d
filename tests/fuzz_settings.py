"""How much the tests fuzz: some two minutes on one core in all, with the same cases every time."""

from hypothesis import HealthCheck, settings


def fuzzing(cases: int) -> settings:
    """Return the settings of a test with so many drawn cases, whose fixtures serve all of them."""
    return settings(
        max_examples=cases,
        deadline=None,
        derandomize=True,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )
