"""C structures that Python declares again: whether both declarations have every member at the same place."""

import ctypes


def layout_source(structure: type[ctypes.Structure], symbol: str) -> str:
    """Return C that defines an array with the layout of a structure: its size, then the offset of each member [bytes].

    It has to follow the definition of the C structure, which has the name of the class and members of the same names.

    Args:
        structure: The declaration in Python.
        symbol: Name of the array, for `require_layout`.
    """
    name = structure.__name__
    offsets = [f"offsetof({name}, {member[0]})" for member in structure._fields_]
    values = ", ".join([f"sizeof({name})", *offsets])
    return f"#include <stddef.h>\n#include <stdint.h>\nconst int64_t {symbol}[] = {{{values}}};\n"


def require_layout(library: ctypes.CDLL, structure: type[ctypes.Structure], symbol: str) -> None:
    """Make sure that C code and ctypes agree where each member of a structure stands in memory.

    The structure is declared twice, in C and in Python. If the two drifted apart, the C code would read other numbers
    than Python has written, without an error.

    Args:
        library: A loaded library with the source of `layout_source` in it: an array of the structure's size, then the
            offset of each member [bytes].
        structure: The declaration in Python.
        symbol: Name of that array.

    Raises:
        RuntimeError: A member has another offset in C than in Python, or the sizes differ.
    """
    members = [member[0] for member in structure._fields_]
    # the array in the library's memory, read as a ctypes array
    size, *offsets = (ctypes.c_int64 * (len(members) + 1)).in_dll(library, symbol)
    name = structure.__name__
    for member, offset in zip(members, offsets, strict=True):
        expected = getattr(structure, member).offset
        if offset != expected:
            raise RuntimeError(f"{name}.{member} is at byte {offset} in C, expected {expected} as declared in Python")
    if size != ctypes.sizeof(structure):
        raise RuntimeError(f"{name} has {size} bytes in C, expected {ctypes.sizeof(structure)} as declared in Python")
