"""Compiled functions equal interpreted ones; functions on arrays: rows here are columns there."""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.native.functions import ArrayFunction, BatchFunction, compiled
from psmpc_cli.plant.rk4 import tick_function
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
        lambda model: tick_function(model, 1e-3, 1, False, False),
        lambda model: tick_function(model, 1e-3, 1, False, False, in_task_space=True),
        lambda model: tick_function(model, 1e-3, 2, True, True),
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


@pytest.fixture
def function() -> ca.Function:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    return ca.Function("pieces", [x, y], [ca.vertcat(x[0] * y, x[2]), ca.dot(x, x)])


@pytest.mark.parametrize("rows", [0, 1, 2, 17, 100])
def test_each_row_is_evaluated(function: ca.Function, rows: int) -> None:
    random = np.random.default_rng(rows)
    X, Y = random.standard_normal((rows, 3)), random.standard_normal((rows, 2))
    first, second = BatchFunction(function)(X, Y, rows=rows)
    assert (first.shape, second.shape) == ((rows, 3), (rows, 1))
    np.testing.assert_array_equal(first, np.column_stack([X[:, :1] * Y, X[:, 2]]))
    np.testing.assert_allclose(second[:, 0], (X**2).sum(axis=1), rtol=1e-14)


def test_fewer_rows_after_more_leave_earlier_results_alone(function: ca.Function) -> None:
    evaluate, X, y = BatchFunction(function), np.arange(30.0).reshape(10, 3), np.ones(2)
    before, _ = evaluate(X, y, rows=10)
    kept = before.copy()
    after, _ = evaluate(X[5:8], y, rows=3)
    np.testing.assert_array_equal(after, kept[5:8])
    np.testing.assert_array_equal(before, kept)


def test_matrices_are_transposed_on_the_way_in_and_out() -> None:
    A, b = ca.SX.sym("A", 2, 3), ca.SX.sym("b", 3)
    (found,) = ArrayFunction(ca.Function("stacked", [A, b], [ca.vertcat(A, b.T)]))(np.ones((3, 2)), [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(found, [[1, 1, 1], [1, 1, 2], [1, 1, 3]])


def test_sparse_results_are_rejected() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match="dense"):
        ArrayFunction(ca.Function("diagonal", [x], [ca.diag(x)]))
