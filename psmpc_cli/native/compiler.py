"""The system's C compiler: which one, what it makes of given flags, and a shared library from C."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

CANDIDATES = ("cc", "gcc", "clang")
"""Names looked up on PATH where CC is not set."""

LONGEST = 300.0
"""Time after which a compiler is given up [s]."""


class CompilationError(Exception):
    """There is no compiler, or it did not make a library; no one outside this room sees it."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler that takes the options of cc.

    Attributes:
        command: The program and what of CC comes after it.
    """

    command: tuple[str, ...]

    def identity(self, flags: Sequence[str]) -> str:
        """Return what a library depends on besides its source: compiler, version, target machine, instruction set.

        Raises:
            CompilationError: It does not run, or knows one of the flags not.
        """
        return _identity(self.command, tuple(flags))

    def build(self, source: Path, target: Path, flags: Sequence[str]) -> None:
        """Make a shared library from a C file.

        Raises:
            CompilationError: It failed.
        """
        _run([*self.command, *flags, "-fPIC", "-shared", source.name, "-o", target.name, "-lm"], source.parent)


def find_compiler() -> Compiler:
    """Return the compiler the environment variable CC names, else the first of cc, gcc, clang on PATH.

    Raises:
        CompilationError: There is none.
    """
    wanted = os.environ.get("CC", "").strip()
    commands = [shlex.split(wanted)] if wanted else [[name] for name in CANDIDATES]
    for command in commands:
        if program := shutil.which(command[0]):
            return Compiler((program, *command[1:]))
    sought = f"CC is {wanted!r}, which is no program" if wanted else f"none of {', '.join(CANDIDATES)} on PATH"
    raise CompilationError(f"no C compiler: {sought}")


@cache
def _identity(command: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Return the macros the compiler defines of itself: they tell version, system, machine and instruction set."""
    return _run([*command, *flags, "-dM", "-E", "-x", "c", os.devnull], None)


def _run(command: Sequence[str], folder: Path | None) -> str:
    """Run a compiler and return what it wrote."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LONGEST, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CompilationError(f"{command[0]} did not run: {error}") from None
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
        raise CompilationError(f"{command[0]} failed: {said.strip()}")
    return done.stdout
