"""CasADi functions evaluated on arrays in NumPy's own memory, one column of theirs a row here.

CasADi's conversions take 60 to 600 us a call, several times what the functions of a window themselves do. None of this
is to be called by several threads at once.
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike


class ArrayFunction:
    """A function whose arguments and results are dense; a column vector is an array of one row."""

    def __init__(self, function: ca.Function) -> None:
        patterns = [function.sparsity_in(i) for i in range(function.n_in())]
        patterns += [function.sparsity_out(i) for i in range(function.n_out())]
        if not all(pattern.is_dense() for pattern in patterns):
            raise ValueError(f"{function}: arrays stand for dense arguments and results only")
        buffer: tuple[Any, Any] = function.buffer()
        self._buffer, self._evaluate = buffer
        self._inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._sizes = [function.size_out(i)[::-1] for i in range(function.n_out())]
        for i, values in enumerate(self._inputs):
            self._buffer.set_arg(i, values.data)

    def __call__(self, *arguments: ArrayLike, rows: int | None = None) -> list[np.ndarray]:
        """Return the results, (columns, rows) each, at arguments of that layout or that broadcast to it.

        With `rows`, the arguments are for the first columns only; what the results have in the others is left over.
        """
        for values, argument in zip(self._inputs, arguments, strict=True):
            values[:rows] = argument
        results = [np.empty(size) for size in self._sizes]
        for i, values in enumerate(results):
            self._buffer.set_res(i, values.data)
        self._evaluate()
        return results


class RowFunction:
    """A function of dense columns, evaluated at each row of arrays."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._mapped: dict[int, ArrayFunction] = {}

    def __call__(self, *arguments: ArrayLike, rows: int = 1) -> list[np.ndarray]:
        """Return each result, (rows, size).

        Args:
            arguments: (rows, size) each, or what broadcasts to it: (size,) is the same at every row.
            rows: How many.
        """
        step = 1 << max(rows.bit_length() - 4, 0)  # few sizes, none much larger than what is asked for
        room = -(-rows // step) * step
        if room not in self._mapped:
            self._mapped[room] = ArrayFunction(self._function.map(room) if room > 1 else self._function)
        return [values[:rows] for values in self._mapped[room](*arguments, rows=rows)]
