"""Tapes equal the functions they are of, to the last bit, at any number of rows."""

from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.native.functions import BLOCK, BatchFunction, tape_library, tape_of
from psmpc_cli.native.library import compile_all

UNARY = {
    "-a": lambda a: -a,
    "2a": lambda a: 2 * a,
    "a^2": lambda a: a**2,
    "1/a": lambda a: 1 / a,
    "|a|": ca.fabs,
    "not a": lambda a: ca.logic_not(a > 0.3),
    "sign": ca.sign,
    "sqrt": lambda a: ca.sqrt(ca.fabs(a)),
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": lambda a: ca.asin(a / 3),
    "acos": lambda a: ca.acos(a / 3),
    "atan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "asinh": ca.asinh,
    "acosh": lambda a: ca.acosh(1 + ca.fabs(a)),
    "atanh": lambda a: ca.atanh(a / 3),
    "exp": ca.exp,
    "expm1": ca.expm1,
    "log": lambda a: ca.log(ca.fabs(a)),
    "log1p": lambda a: ca.log1p(ca.fabs(a)),
    "a^2.5": lambda a: ca.fabs(a) ** 2.5,
    "erf": ca.erf,
    "floor": ca.floor,
    "ceil": ca.ceil,
}
BINARY = {
    "a+b": lambda a, b: a + b,
    "a-b": lambda a, b: a - b,
    "a b": lambda a, b: a * b,
    "a/b": lambda a, b: a / b,
    "max": ca.fmax,
    "min": ca.fmin,
    "a<b": lambda a, b: a < b,
    "a<=b": lambda a, b: a <= b,
    "a=b": lambda a, b: ca.eq(a, b),
    "a!=b": lambda a, b: ca.ne(a, b),
    "and": lambda a, b: ca.logic_and(a > 0, b > 0),
    "or": lambda a, b: ca.logic_or(a > 0, b > 0),
    "if": lambda a, b: ca.if_else(a > 0, b, -a),
    "atan2": ca.atan2,
    "hypot": ca.hypot,
    "pow": lambda a, b: ca.fabs(a) ** b,
    "fmod": ca.fmod,
    "copysign": ca.copysign,
}
SPECIAL = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e-310]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of these tests' own, in which the program of tapes is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PSMPC_CACHE", str(tmp_path_factory.mktemp("cache")))
        assert compile_all([tape_library()])
        yield


def assert_is_its_function(function: ca.Function, *arguments: np.ndarray) -> None:
    """Compare a tape with CasADi's evaluation, NaN for NaN."""
    rows = len(arguments[0])
    tape = tape_of(function)
    assert tape is not None
    expected = BatchFunction(function)(*arguments, rows=rows)
    for found, result in zip(tape(arguments, rows), expected, strict=True):
        np.testing.assert_array_equal(found, result)


@pytest.mark.parametrize("name", UNARY)
def test_operations_of_one_number(name: str) -> None:
    a = ca.SX.sym("a")
    values = np.concatenate([np.random.default_rng(0).normal(size=30), SPECIAL])
    assert_is_its_function(ca.Function("f", [a], [UNARY[name](a)]), values[:, None])


@pytest.mark.parametrize("name", BINARY)
def test_operations_of_two_numbers(name: str) -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    pairs = np.vstack([np.random.default_rng(0).normal(size=(30, 2)), [(x, y) for x in SPECIAL for y in SPECIAL]])
    if name == "hypot":  # of 0 and infinity CasADi has NaN
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
    assert_is_its_function(ca.Function("f", [a, b], [BINARY[name](a, b)]), pairs[:, :1], pairs[:, 1:])


def random_function(random: np.random.Generator, operations: int) -> ca.Function:
    """Return a function of three arguments whose results are constants, arguments and values, some of them twice."""
    arguments = [ca.SX.sym(name, size) for name, size in (("x", 4), ("y", 1), ("z", 3))]
    values = [*ca.vertsplit(ca.vertcat(*arguments)), ca.SX(0.3), ca.SX(-2.0)]
    binary = [BINARY[name] for name in ("a+b", "a-b", "a b", "max", "if", "atan2")]
    for _ in range(operations):
        a, b = (values[max(len(values) - 1 - int(random.exponential(20)), 0)] for _ in range(2))
        values.append(ca.sin(a) if random.random() < 0.1 else binary[random.integers(len(binary))](a, b))
    chosen = [values[i] for i in random.integers(len(values), size=12)]
    return ca.Function("f", arguments, [ca.vertcat(*chosen, arguments[0][1], 7), ca.vertcat(chosen[0], chosen[0])])


@pytest.mark.parametrize("rows", [0, 1, BLOCK // 2, BLOCK // 2 + 1, BLOCK, 3 * BLOCK + 5])
@pytest.mark.parametrize("operations", [0, 30, 12_000])
def test_random_functions(operations: int, rows: int) -> None:
    random = np.random.default_rng(operations + rows)
    arguments = [random.normal(size=(rows, size)) for size in (4, 1, 3)]
    assert_is_its_function(random_function(random, operations), *arguments)


def test_arguments_of_any_layout_and_those_that_all_rows_share() -> None:
    random = np.random.default_rng(0)
    function = random_function(random, 50)
    X, y, z = random.normal(size=(20, 4)), random.normal(), random.normal(size=3)
    tape = tape_of(function)
    assert tape is not None
    (expected, _) = tape([X, np.full((20, 1), y), np.tile(z, (20, 1))], 20)
    backwards = np.asfortranarray(X[::-1])[::-1]
    read_only = X.copy()
    read_only.setflags(write=False)
    for x in (X.tolist(), backwards, np.repeat(X, 2, axis=1)[:, ::2], np.repeat(X, 2, axis=0)[::2], read_only):
        (found, _) = tape([x, y, z], 20)
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(ValueError, match="broadcast"):
        tape([X, y, np.ones(2)], 20)


def test_later_calls_leave_earlier_results_alone() -> None:
    x = ca.SX.sym("x", 2)
    tape = tape_of(ca.Function("f", [x], [2 * x]))
    assert tape is not None
    (before,) = tape([np.ones((3, 2))], 3)
    tape([np.zeros((3, 2))], 3)
    np.testing.assert_array_equal(before, np.full((3, 2), 2.0))


def test_what_tapes_do_not_have_stays_casadis() -> None:
    x, X = ca.SX.sym("x"), ca.MX.sym("x")
    assert tape_of(ca.Function("f", [x], [ca.erfinv(x)])) is None
    assert tape_of(ca.Function("f", [X], [X + 1])) is None
    (found,) = BatchFunction(ca.Function("f", [x], [ca.erfinv(x)]), native=True)([[0.5], [0.1]], rows=2)
    np.testing.assert_allclose(found, [[0.4769362762044699], [0.08885599049425769]])


@pytest.mark.parametrize("variable", ["CC", "PSMPC_CACHE"])
def test_without_its_program_no_tape_is_made_and_nothing_compiled(
    variable: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(variable, str(tmp_path))
    x = ca.SX.sym("x")
    assert tape_of(ca.Function("f", [x], [x + 1])) is None
    assert not [*tmp_path.iterdir()]
