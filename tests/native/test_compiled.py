"""Compiled functions equal interpreted ones."""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.native.compiled import compiled
from psmpc_cli.plant.tick_functions import TickKind, tick_function
from psmpc_cli.robot.model import RobotModel


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of these tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PSMPC_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.mark.parametrize(
    "build",
    [
        lambda model: model.f_2,
        lambda model: tick_function(model, TickKind(1e-3, 1, False, False)),
        lambda model: tick_function(model, TickKind(1e-3, 1, False, False, in_task_space=True)),
        lambda model: tick_function(model, TickKind(1e-3, 2, True, True)),
    ],
    ids=["pose acceleration", "a tick", "a tick in task space", "two substeps, disturbed, limited"],
)
def test_a_compiled_function_equals_the_interpreted_one(
    model: RobotModel, build: Callable[[RobotModel], ca.Function]
) -> None:
    function = build(model)
    fast = compiled(function)
    assert "External" in fast.class_name()
    random = np.random.default_rng(0)
    for _ in range(5):
        arguments = [random.uniform(0.5, 1.5, function.size_in(i)) for i in range(function.n_in())]
        for found, expected in zip(fast.call(arguments), function.call(arguments), strict=True):
            np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=1e-10, atol=0)


def test_without_a_compiler_a_function_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/no/such/compiler")
    x = ca.SX.sym("x")
    function = ca.Function("square", [x], [x**2])
    assert compiled(function) is function
