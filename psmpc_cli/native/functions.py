"""CasADi functions evaluated on NumPy arrays, of many rows as tapes.

A tape is a list of instructions that one compiled program carries out for many rows at once. Nothing is compiled for a
function, and its rows share the cost of looking at an instruction. Results equal CasADi's to the last bit.
"""

import ctypes
import re
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.native.library import CompilationError, Library
from psmpc_cli.native.structures import layout_source, require_layout

FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-ffp-contract=off")

BLOCK = 16
"""Rows that are evaluated together; tape.c has the same number."""

ALIGNMENT = 64
"""Bytes to which the slots are aligned."""

DOUBLE_SIZE = 8
"""Bytes of a double."""

SOURCE = (files("psmpc_cli.native") / "tape.c").read_text(encoding="utf-8")

OPERATIONS = {name: int(getattr(ca, name)) for name in re.findall(r"\bOP_\w+", SOURCE) if hasattr(ca, name)}
"""CasADi's numbers of the operations that tape.c knows, by its names for them."""

KNOWN_OPERATIONS = frozenset(OPERATIONS.values())


class TapeProgram(ctypes.Structure):
    """A tape as tape.c takes it, which declares the same structure."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("run_count", "argument_count", "result_count")),
        *((name, ctypes.c_void_p) for name in ("runs", "operands", "argument_sizes", "result_sizes", "result_slots")),
        *((name, ctypes.c_void_p) for name in ("arguments", "results", "slots")),
    )


LAYOUT = "psmpc_tape_layout"


def tape_library() -> Library:
    """Return the shared library of the program that carries tapes out."""
    numbers = "".join(f"#define {name} {number}\n" for name, number in OPERATIONS.items())
    symbols = ("psmpc_tape_run", "psmpc_tape_arrange", LAYOUT)
    return Library(numbers + SOURCE + layout_source(TapeProgram, LAYOUT), "tape", FLAGS, symbols)


@cache
def _load_program(path: str) -> tuple[Callable[..., None], Callable[..., int]]:
    """Load the program of tape.c, and return its two functions: that which carries a tape out, that which arranges it.

    Raises:
        RuntimeError: The structure `TapeProgram` is another one in C than in Python.
    """
    loaded = ctypes.CDLL(path)
    require_layout(loaded, TapeProgram, LAYOUT)
    run = loaded.psmpc_tape_run
    arrange = loaded.psmpc_tape_arrange
    run.argtypes = [ctypes.c_void_p, ctypes.c_int64]
    run.restype = None
    arrange.argtypes = [ctypes.c_void_p, *[ctypes.c_int64] * 4, *[ctypes.c_void_p] * 5]
    arrange.restype = ctypes.c_int64
    return run, arrange


def tape_of(function: ca.Function) -> "Tape | None":
    """Return a function as a tape: a list of instructions that a compiled C program carries out at many points at once.

    The program is the same for all tapes. A run compiles it with all else that it needs; here it is only looked up.

    Args:
        function: The function.

    Returns:
        The tape. None where CasADi has to evaluate the function itself: it is not of SX, has sparse arguments or
        results, or an operation that the program does not know, or the program is not compiled.
    """
    # as many nonzeros as entries
    is_dense = function.nnz_in() + function.nnz_out() == function.numel_in() + function.numel_out()
    if not function.is_a("SXFunction") or not is_dense:
        return None
    try:
        path = tape_library().find()  # None if it is not compiled yet
    except (CompilationError, OSError):  # there is no compiler, or its folder cannot be read
        return None
    if path is None:
        return None
    count = function.n_instructions()
    # CasADi's number of the operation of each instruction
    operations = np.fromiter(map(function.instruction_id, range(count)), np.int32, count)
    if not KNOWN_OPERATIONS.issuperset(np.unique(operations).tolist()):
        return None
    return Tape(function, operations, str(path))


class Tape:
    """A function of SX with dense arguments and results, evaluated at the rows of arrays.

    It must not be called from several threads at once.

    Args:
        function: The function.
        operations: The operations of its instructions, (count,).
        path: The library.
    """

    def __init__(self, function: ca.Function, operations: np.ndarray, path: str) -> None:
        """Make the list of instructions of a CasADi function that compiled C code evaluates at a batch of points.

        The code evaluates a block of `BLOCK` points together. Its memory is divided into slots, each with one value for
        every point of a block. Its structure `TapeProgram` has addresses alone, so the arrays at these addresses are
        kept as attributes.

        Args:
            function: The function, of SX, with dense arguments and results.
            operations: CasADi's numbers of the operations of its instructions, (count,).
            path: The shared library with the C code.
        """
        self._run, arrange = _load_program(path)
        # How many numbers each argument and each result has at one point.
        self._argument_sizes = np.array([function.numel_in(i) for i in range(function.n_in())], dtype=np.int64)
        self._result_sizes = np.array([function.numel_out(i) for i in range(function.n_out())], dtype=np.int64)
        instructions, constants = self._translated_instructions(function, operations)
        slot_count = self._arrange(arrange, instructions, len(constants), function)
        # Slots of the arguments come first, then those of constants, which are written here once, then all others.
        entry_count = int(self._argument_sizes.sum())
        # Room for some more numbers, of which so many are left out that the slots begin at a multiple of ALIGNMENT.
        memory = np.zeros(slot_count * BLOCK + ALIGNMENT // DOUBLE_SIZE)
        self._slots = memory[-memory.ctypes.data % ALIGNMENT // DOUBLE_SIZE :]
        self._slots[entry_count * BLOCK : (entry_count + len(constants)) * BLOCK] = np.repeat(constants, BLOCK)
        self._input_addresses = np.zeros_like(self._argument_sizes)
        self._result_addresses = np.zeros_like(self._result_sizes)
        self._program = TapeProgram(
            run_count=len(self._runs),
            argument_count=len(self._argument_sizes),
            result_count=len(self._result_sizes),
            runs=self._runs.ctypes.data,
            operands=self._operands.ctypes.data,
            argument_sizes=self._argument_sizes.ctypes.data,
            result_sizes=self._result_sizes.ctypes.data,
            result_slots=self._result_slots.ctypes.data,
            arguments=self._input_addresses.ctypes.data,
            results=self._result_addresses.ctypes.data,
            slots=self._slots.ctypes.data,
        )
        self._address = ctypes.addressof(self._program)
        self._capacity = 0  # rows for which there is room
        self._reserve(1)

    def _arrange(
        self, arrange: Callable[..., int], instructions: np.ndarray, constant_count: int, function: ca.Function
    ) -> int:
        """Order the instructions for fast evaluation and choose where each of their values is kept.

        Instructions of the same operation are brought one after the other where they can be (a run), so that the
        program looks up the operation once for all of them. Each value gets a slot of the memory, which is used again
        after the last instruction that reads the value. Sets `_runs`, `_operands` and `_result_slots`.

        Args:
            arrange: The function of tape.c that does it; it returns 0, or -1 where it has no memory.
            instructions: The instructions as `_translated_instructions` returns them, (count, 4).
            constant_count: How many constants they have.
            function: The function that they belong to.

        Returns:
            The number of slots.

        Raises:
            MemoryError: There is no memory for it.
        """
        count = len(instructions)
        runs = np.zeros((count, 2), np.int32)  # operation, how many instructions
        operands = np.zeros((count, 3), np.int32)  # slots of result, left and right operand
        self._result_slots = np.zeros(int(self._result_sizes.sum()), np.int32)
        # arrays of one number each, into which the C function writes
        run_count = np.zeros(1, np.int64)
        slot_count = np.zeros(1, np.int64)
        filled_slots = int(self._argument_sizes.sum()) + constant_count
        register_count = function.sz_w()  # CasADi's work vector
        counts = (count, filled_slots, register_count, len(self._result_slots))
        outputs = (runs, operands, self._result_slots, run_count, slot_count)
        status = arrange(instructions.ctypes.data, *counts, *(output.ctypes.data for output in outputs))
        if status != 0:
            raise MemoryError(f"no memory for the instructions of {function}")
        self._runs = runs[: run_count[0]].copy()
        self._operands = operands[: self._runs[:, 1].sum()].copy()
        return int(slot_count[0])

    @staticmethod
    def _translated_instructions(function: ca.Function, operations: np.ndarray) -> tuple[np.ndarray, list[float]]:
        """Translate the instructions of a CasADi function into those that tape.c evaluates.

        Each is a row: operation, register of the result, registers of both operands. Where an operation has only one
        operand, its register stands twice. Instructions that read a constant or an argument have its number instead of
        the registers of operands; instructions that write a result have its number instead of a register. CasADi
        numbers the entries of each argument and each result from 0. Here entries of all arguments are numbered through,
        constants follow them, and entries of all results are numbered through.

        Args:
            function: The function, of SX.
            operations: CasADi's numbers of the operations of its instructions, (count,).

        Returns:
            The instructions (count, 4), and the constants in the order of their numbers, each once.
        """
        count = len(operations)
        # The first entry of each argument and result among the entries of all; the constants follow the arguments.
        first_input = np.cumsum([0, *(function.numel_in(i) for i in range(function.n_in()))]).tolist()
        first_output = np.cumsum([0, *(function.numel_out(i) for i in range(function.n_out()))]).tolist()
        first_constant = first_input[-1]
        instructions = np.zeros((count, 4), np.int32)
        instructions[:, 0] = operations
        written = map(function.instruction_output, range(count))
        read = map(function.instruction_input, range(count))
        instructions[:, 1:] = [
            (results[0], operands[0], operands[-1]) if results and operands else (0, 0, 0)
            for results, operands in zip(written, read, strict=True)
        ]
        # Constants, inputs and outputs have other numbers where other instructions have registers.
        index_of_constant = dict[float, int]()
        for k in np.flatnonzero(operations == OPERATIONS["OP_CONST"]).tolist():
            index = index_of_constant.setdefault(function.instruction_constant(k), len(index_of_constant))
            instructions[k, 1:] = function.instruction_output(k)[0], first_constant + index, 0
        for k in np.flatnonzero(operations == OPERATIONS["OP_INPUT"]).tolist():
            argument, entry = function.instruction_input(k)
            instructions[k, 2:] = first_input[argument] + entry, 0
        for k in np.flatnonzero(operations == OPERATIONS["OP_OUTPUT"]).tolist():
            result, entry = function.instruction_output(k)
            instructions[k, 1] = first_output[result] + entry
        return instructions, list(index_of_constant)

    def __call__(self, arguments: Sequence[ArrayLike], rows: int) -> list[np.ndarray]:
        """Evaluate the function at some points and return its results, arrays (rows, size) with a point in each row.

        Args:
            arguments: (rows, size) each, or what broadcasts to it: (size,) is the same at every point.
            rows: The number of points.
        """
        if rows > self._capacity:
            self._reserve(rows)
        for values, argument in zip(self._inputs, arguments, strict=True):
            values[:rows] = argument
        self._run(self._address, rows)
        return [values[:rows].copy() for values in self._results]

    def _reserve(self, rows: int) -> None:
        """Make room for the arguments and results of some rows."""
        self._capacity = rows
        self._inputs = [np.zeros((rows, size)) for size in self._argument_sizes.tolist()]
        self._results = [np.zeros((rows, size)) for size in self._result_sizes.tolist()]
        self._input_addresses[:] = [values.ctypes.data for values in self._inputs]
        self._result_addresses[:] = [values.ctypes.data for values in self._results]


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
            arguments: Arrays of the transposed shapes, or what broadcasts to them: a column of CasADi's is a row here.
            rows: How many rows of the arguments are given and of the results returned. Default all.
        """
        for values, argument in zip(self._inputs, arguments, strict=True):
            values[:rows] = argument
        self._evaluate()
        return [values[:rows].copy() for values in self._results]


class BatchFunction:
    """A CasADi function of dense columns, evaluated at a batch of points, one a row.

    Attributes:
        function: The function itself, for expressions.
        native: It is evaluated as a tape, which is made at the first call, see `tape_of`.
    """

    def __init__(self, function: ca.Function, native: bool = False) -> None:
        self.function = function
        self.native = native
        # maps by their capacity, and again by each number of points that has been asked for
        self._mapped: dict[int, ArrayFunction] = {}

    def prepare(self) -> None:
        """Make the tape now, so that the first call takes no longer than others."""
        _ = self._tape

    @cached_property
    def _tape(self) -> Tape | None:
        return tape_of(self.function) if self.native else None

    def __call__(self, *arguments: ArrayLike, rows: int = 1) -> list[np.ndarray]:
        """Evaluate the function at a batch of points and return its results, (rows, size) each.

        Where the function has a tape (a list of its instructions), a compiled program carries that out for all points.
        Otherwise CasADi's map of the function evaluates them. A map has a fixed number of points. So it is made for a
        few more points than are wanted, and kept: batches of similar size share one, and its results at the points
        beyond theirs are not read.

        Args:
            arguments: (rows, size) each, or what broadcasts to it: (size,) is the same at every point.
            rows: The number of points.
        """
        if self._tape is not None:
            return self._tape(arguments, rows)
        if rows not in self._mapped:
            # The rows rounded up to a number of four leading bits: few capacities, none more than an eighth too large.
            step = 1 << max(rows.bit_length() - 4, 0)
            capacity = -(-rows // step) * step  # rounded up to a multiple of the step
            if capacity not in self._mapped:
                mapped = self.function.map(capacity) if capacity > 1 else self.function
                self._mapped[capacity] = ArrayFunction(mapped)
            self._mapped[rows] = self._mapped[capacity]
        return self._mapped[rows](*arguments, rows=rows)
