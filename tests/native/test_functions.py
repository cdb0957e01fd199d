"""Compiled functions give what interpreted ones give, and stand in for them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.native.functions import compiled
from psmpc_cli.ocp.layout import StageShape
from psmpc_cli.ocp.stage_terms import stage_terms
from psmpc_cli.plant.rk4 import tick_function
from psmpc_cli.robot.model import RobotModel

Build = Callable[[RobotModel], ca.Function]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of these tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PSMPC_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield Path()


def terms(name: str, space: str) -> Build:
    def build(model: RobotModel) -> ca.Function:
        found: ca.Function = getattr(stage_terms(model, StageShape(space, "joint", (), False, False, False)), name)
        return found

    return build


@pytest.mark.parametrize(
    "build",
    [
        terms("cost", "joint"),
        terms("cost", "task"),
        terms("error", "joint"),
        terms("error", "task"),
        lambda model: tick_function(model, 1e-3, 1),
        lambda model: tick_function(model, 1e-3, 2),
    ],
    ids=["cost, joint", "cost, task", "error, joint", "error, task", "tick", "two substeps"],
)
def test_a_compiled_function_gives_what_the_interpreter_gives(model: RobotModel, build: Build) -> None:
    function = build(model)
    fast = compiled(function)
    assert "External" in fast.class_name()
    random = np.random.default_rng(0)
    for _ in range(5):
        arguments = [random.standard_normal(function.size_in(i)) for i in range(function.n_in())]
        for found, expected in zip(fast.call(arguments), function.call(arguments), strict=True):
            np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=1e-10, atol=0)


def test_without_a_compiler_a_function_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/no/such/compiler")
    x = ca.SX.sym("x")
    function = ca.Function("square", [x], [x**2])
    assert compiled(function) is function


def test_names_and_shapes_are_kept() -> None:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2, 2)
    function = ca.Function("pieces", [x, y], [y @ x[:2], ca.diag(x)], ["x", "y"], ["product", "diagonal"])
    fast = compiled(function)
    assert (fast.name_in(), fast.name_out()) == (["x", "y"], ["product", "diagonal"])
    assert fast.sparsity_out(1) == function.sparsity_out(1)
