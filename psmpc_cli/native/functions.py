"""CasADi functions as compiled C, and evaluated on NumPy arrays."""

from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.native.library import Library, paths_of
from psmpc_cli.native.tape import Tape, tape_of

FLAGS = ("-O1", "-ffp-contract=off")
"""Straight code gains little from more; without contraction the results equal those of the interpreter to the bit."""


def source_of(function: ca.Function) -> str:
    """Return the C source of a function; equal functions of equal names have equal sources."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    return str(generator.dump())


def compiled(function: ca.Function) -> ca.Function:
    """Return the function as compiled C, with the same inputs and outputs; itself where that is not possible."""
    (path,) = paths_of([library_of(function)])
    return function if path is None else ca.external(function.name(), str(path))


_LIBRARIES: WeakKeyDictionary[ca.Function, Library] = WeakKeyDictionary()


def library_of(function: ca.Function) -> Library:
    """Return the library of a function; its source is written once, and here, because CasADi is not thread-safe."""
    if function not in _LIBRARIES:
        _LIBRARIES[function] = Library(source_of(function), function.name(), FLAGS, (function.name(),))
    return _LIBRARIES[function]


class ArrayFunction:
    """A CasADi function evaluated in NumPy's own memory; each column of an argument or result is a row here.

    CasADi's conversions take 60 to 600 us a call, several times what the functions of a window take. Arguments and
    results must be dense; a column vector is an array of one row. It must not be called from several threads at once.
    """

    def __init__(self, function: ca.Function) -> None:
        patterns = [function.sparsity_in(i) for i in range(function.n_in())]
        patterns += [function.sparsity_out(i) for i in range(function.n_out())]
        if not all(pattern.is_dense() for pattern in patterns):
            raise ValueError(f"{function}: found sparse arguments or results, expected dense ones")
        buffer: tuple[Any, Any] = function.buffer()
        self._buffer, self._evaluate = buffer
        self._inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._results = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        for i, values in enumerate(self._inputs):
            self._buffer.set_arg(i, values.data)
        for i, values in enumerate(self._results):
            self._buffer.set_res(i, values.data)

    def __call__(self, *arguments: ArrayLike, rows: int | None = None) -> list[np.ndarray]:
        """Evaluate the function and return its results, an array of `rows` rows each.

        Args:
            arguments: Arrays of the transposed shapes, or what broadcasts to them.
            rows: The number of rows given and returned. Default all.
        """
        for values, argument in zip(self._inputs, arguments, strict=True):
            values[:rows] = argument
        self._evaluate()
        return [values[:rows].copy() for values in self._results]


class BatchFunction:
    """A CasADi function of dense columns, evaluated at a batch of points, one a row.

    Attributes:
        function: The function itself, for expressions.
        native: It is evaluated as a tape, which is made at the first call, where the machine has a compiler.
    """

    def __init__(self, function: ca.Function, native: bool = False) -> None:
        self.function = function
        self.native = native
        self._mapped: dict[int, ArrayFunction] = {}  # by number of rows, and by capacity

    def prepare(self) -> None:
        """Make what is evaluated, so that the first call takes no longer than others."""
        _ = self._tape

    @cached_property
    def _tape(self) -> Tape | None:
        return tape_of(self.function) if self.native else None

    def __call__(self, *arguments: ArrayLike, rows: int = 1) -> list[np.ndarray]:
        """Evaluate the function at each row and return its results, (rows, size) each.

        Args:
            arguments: (rows, size) each, or what broadcasts to it: (size,) is the same at every row.
            rows: The number of rows.
        """
        if self._tape is not None:
            return self._tape(arguments, rows)
        if rows not in self._mapped:
            step = 1 << max(rows.bit_length() - 4, 0)  # few sizes, none much larger than the number of rows
            capacity = -(-rows // step) * step
            if capacity not in self._mapped:
                mapped = self.function.map(capacity) if capacity > 1 else self.function
                self._mapped[capacity] = ArrayFunction(mapped)
            self._mapped[rows] = self._mapped[capacity]
        return self._mapped[rows](*arguments, rows=rows)
