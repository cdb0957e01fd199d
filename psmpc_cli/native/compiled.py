"""CasADi functions as compiled C."""

from weakref import WeakKeyDictionary

import casadi as ca

from psmpc_cli.native.library import Library, find_or_compile

FLAGS = ("-O1", "-ffp-contract=off")
"""Straight code gains little from more; without contraction the results equal those of the interpreter to the bit."""


def source_of(function: ca.Function) -> str:
    """Return the C source of a function; equal functions of equal names have equal sources."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    return str(generator.dump())


def compiled(function: ca.Function) -> ca.Function:
    """Return a function as compiled C, with the same inputs and outputs; itself if it cannot be compiled."""
    (path,) = find_or_compile([library_of(function)])
    return function if path is None else ca.external(function.name(), str(path))


_LIBRARIES: WeakKeyDictionary[ca.Function, Library] = WeakKeyDictionary()


def library_of(function: ca.Function) -> Library:
    """Return the library that a function is compiled into; its source is written once.

    It is written in the calling thread and not in those that compile, because CasADi is not thread-safe.
    """
    if function not in _LIBRARIES:
        _LIBRARIES[function] = Library(source_of(function), function.name(), FLAGS, (function.name(),))
    return _LIBRARIES[function]
