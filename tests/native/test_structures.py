"""C structures declared in Python too: every member has to stand at the same place."""

import ctypes
from pathlib import Path

import pytest

from psmpc_cli.native.library import library
from psmpc_cli.native.structures import layout_source, require_layout

POINT = "typedef struct { double x; double y; long long label; } Point;\n"


def structure(*names: str) -> type[ctypes.Structure]:
    """A declaration in Python of the C structure `Point`, with its members in some order."""
    kinds = {"x": ctypes.c_double, "y": ctypes.c_double, "label": ctypes.c_int64}
    return type("Point", (ctypes.Structure,), {"_fields_": [(name, kinds[name]) for name in names]})


def load(declared: type[ctypes.Structure], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ctypes.CDLL:
    """The library of `Point` with the layout that C gives to the members declared in Python."""
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path))
    path = library(POINT + layout_source(declared, "point_layout"), "point")
    assert path is not None
    return ctypes.CDLL(str(path))


def test_equal_declarations_are_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    declared = structure("x", "y", "label")
    require_layout(load(declared, tmp_path, monkeypatch), declared, "point_layout")


@pytest.mark.parametrize(
    ("members", "message"),
    [
        (("y", "x", "label"), "Point.y is at byte 8 in C, expected 0 as declared in Python"),  # of equal size
        (("x", "label", "y"), "Point.label is at byte 16 in C, expected 8 as declared in Python"),
        (("x", "y"), "Point has 24 bytes in C, expected 16 as declared in Python"),
    ],
)
def test_a_member_elsewhere_is_named(
    members: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    declared = structure(*members)
    loaded = load(declared, tmp_path, monkeypatch)
    with pytest.raises(RuntimeError, match=message):
        require_layout(loaded, declared, "point_layout")
