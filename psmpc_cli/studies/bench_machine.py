"""What a bench ran on: how fast it was means little without."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

from psmpc_cli import __version__
from psmpc_cli.native.library import CompilationError, compiler_macros, find_compiler

PROCESSORS = Path("/proc/cpuinfo")
"""Where Linux says what its processors are."""


def describe_machine() -> dict[str, object]:
    """Return cores, processor, system, versions and C compiler, each None where it is not known."""
    return {
        "cores": os.cpu_count(),
        "processor": processor(),
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "compiler": compiler(),
        "versions": {
            "psmpc": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("casadi", "numpy", "piqp")},
        },
    }


def processor(listed: Path = PROCESSORS) -> str | None:
    """Return the processor's name."""
    try:
        lines = listed.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next((name for name in names if name), platform.processor() or None)


def compiler() -> str | None:
    """Return the C compiler that makes the compiled code, by name and version."""
    try:
        macros = compiler_macros(find_compiler())
    except CompilationError:
        return None
    found = dict(line.split(maxsplit=2)[1:] for line in macros.splitlines() if len(line.split(maxsplit=2)) == 3)
    name = "clang" if "__clang__" in found else "gcc" if "__GNUC__" in found else "cc"
    return f"{name} {found.get('__VERSION__', '').strip(chr(34))}".strip()
