"""Functions on arrays: rows here are columns there."""

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.native.functions import ArrayFunction, BatchFunction


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
