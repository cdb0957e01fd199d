"""CasADi functions as compiled C."""

import casadi as ca

from psmpc_cli.native.library import library

FLAGS = ("-O1", "-ffp-contract=off")
"""Straight code gains little from more, and without contraction it gives what the interpreter gives, bit by bit."""


def source_of(function: ca.Function) -> str:
    """Return a function's C source; equal functions of equal names give equal text."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    return str(generator.dump())


def compiled(function: ca.Function) -> ca.Function:
    """Return the function as compiled C, the same in all it takes and gives; itself where that cannot be had."""
    path = library(source_of(function), function.name(), FLAGS)
    if path is None:
        return function
    found = ca.external(function.name(), str(path))
    return found if _signature(found) == _signature(function) else function


def _signature(function: ca.Function) -> list[tuple[str, ca.Sparsity]]:
    """Return names and sparsities of what a function takes, then of what it gives."""
    inputs = [(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    return inputs + [(function.name_out(i), function.sparsity_out(i)) for i in range(function.n_out())]
