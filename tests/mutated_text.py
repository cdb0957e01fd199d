"""Valid descriptions and command lines made wrong at random, for tests and for `benchmarks/fuzz.py`."""

import re
from collections.abc import Callable, Sequence
from random import Random

VALUES = (
    *(
        "",
        "~",
        "1e999",
        "-1e999",
        "1" + "0" * 400,
        "-" + "9" * 4000,
        "0x" + "f" * 400,
        ".inf",
        "-.inf",
        ".nan",
        "1:30:00",
    ),
    *("1", "2", "0.5", "1e-3", "12", "100", "-1", "1.5", "5", "90 deg"),
    *("1e300", "-1e300", "1e-320", "0", "-0.0", "1e400 deg", "nan", "inf", "0o777", "1_000", "+", "-", "yes", "true"),
    *(
        "30 deg",
        "1e5 rad",
        "\u00b0",
        "[]",
        "{}",
        "[[]]",
        "[null]",
        "{a: b}",
        "[1, 2, 3]",
        "'",
        '"',
        "|",
        ">",
        "*a",
        "&a x",
    ),
    *(
        "!!python/object/apply:os.system [exit]",
        "!!binary aGk=",
        "!<x> y",
        "<<: *a",
        "? x",
        "%",
        "@",
        "`",
        "# x",
        "a: b: c",
    ),
    *("\x00", "\x1b[31m", "\x85", "\u2028", "\ufeff", "\ud7ff", "\U0001f680", "\u0661", "x" * 100_000),
    *("[" * 40, "{a: " * 40, "- " * 40, "*a, " * 400, "../../task.yaml", "/dev/zero", "all", "base", "auto"),
)
"""What stands in the place of a value, or anywhere."""

BYTES = (
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\x00",
    b"\xc3",
    b"\xed\xa0\x80",
    b"\r",
    b"\t",
    b"\x7f",
    b"---\n",
    b"...\n",
    b"%YAML 9\n",
)

TOWER = "z0: &z0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"z{i}: &z{i} [{', '.join([f'*z{i - 1}'] * 9)}]\n" for i in range(1, 9)
)
"""Aliases that expand to nine to the power of nine values."""

KEYS = (
    *("controller.horizon", "controller.sample_time", "controller.nodes", "controller.pending_cost", "controller.zeta"),
    *("controller.terminal_cost", "controller.detection_margin", "controller.offset_gain", "controller.multistart"),
    *("solver.tolerance", "solver.max_iterations", "solver.iterations", "solver.deadline"),
    *("plant.low_level_rate", "plant.step", "seed", "time_limit", "onset.epsilon", "stages.go.dwell", "stages.go.at"),
    *("stages.go.priority", "stages.back.priority", "stages.go.target.base[0]", "stages.go.target.arm_1[0]"),
    *("stages.go.ends_when.tolerance", "stages.go.ends_when.velocity", "skills.move.weights.base[1]"),
    *("skills.move.weights.control", "initial.base[0]", "initial.arm_1[1]", "initial_velocity.base[0]"),
    *("uncertainty.mass", "uncertainty.inertia", "uncertainty.centre_of_mass", "uncertainty.friction.viscous"),
    *("uncertainty.friction.coulomb", "uncertainty.friction.width", "uncertainty.noise.position"),
    *("uncertainty.noise.angle", "uncertainty.noise.velocity", "uncertainty.noise.angular_velocity"),
    *("uncertainty.delay", "controller.known_delay", "uncertainty.force_limits.base", "uncertainty.force_limits.arms"),
    *("uncertainty.impulse.at", "uncertainty.impulse.angular", "uncertainty.payload.mass"),
    *("uncertainty.payload.inertia", "limits.base.velocity[0]", "limits.base.acceleration[0]"),
)
"""Numbers of the small task that a setting can change."""

ARGUMENTS = (
    *(
        "",
        "-",
        "--",
        "-x",
        "--x",
        "--help",
        "--version",
        "nan",
        "-1",
        "0",
        "1e999",
        "9" * 30,
        "1e400",
        ".",
        "..",
        "none.h5",
    ),
    *(
        "folder",
        "pipe",
        "zero",
        "loop",
        "nowhere",
        "task.yaml",
        "robot.yaml",
        "empty.h5",
        "text.h5",
        "noise.h5",
        "\udcff",
    ),
    *(
        "ended.h5",
        "part.h5",
        "compared.h5",
        "sweep.h5",
        "fronts.h5",
        "a\nb",
        "\u00e9",
        "a" * 5000,
        "folder/x/y",
        "text.h5/x",
    ),
    *(
        "--force",
        "--quiet",
        "--strict",
        "--set",
        "-o",
        "--only",
        "--format",
        "--run",
        "--step",
        "--csv",
        "--every",
        "--jobs",
    ),
    *("robot=nowhere", "=", "a=b", "x=[", "stages[9].name=1", "stages[0]=", "controller.nodes=1e9", "time_limit=.nan"),
    *(
        "stages.go.priority=1e999",
        "initial.base=[1e300, 0, 0]",
        "solver.kind=*a",
        "seed=" + "9" * 50,
        "1,2",
        "9,9",
        "1:0",
    ),
    *("random:0", "random:x", "0x0", "25", "png", "exe", "states", "transport", "approach_capture", "planar_dual_arm"),
)
"""What stands in the place of an argument, or anywhere."""


def mutated_description(text: str, random: Random) -> bytes:
    """Return a YAML text with one to three things wrong."""
    content = text
    for _ in range(random.choice([1, 1, 2, 3])):
        content = random.choice(_OF_TEXT)(content, random)
    encoded = content.encode("utf-8", "surrogatepass")
    if random.random() < 0.1:
        at = random.randint(0, len(encoded))
        encoded = encoded[:at] + random.choice(BYTES) + encoded[at:]
    return encoded


def mutated_line(arguments: Sequence[str], random: Random) -> list[str]:
    """Return a command line with one to three things wrong."""
    changed = list(arguments)
    for _ in range(random.randint(1, 3)):
        at, kind = random.randint(1, max(1, len(changed) - 1)), random.randrange(5)
        if kind == 0:
            changed[at:at] = [random.choice(ARGUMENTS)]
        elif kind == 1:
            del changed[at : at + 1]
        elif kind == 2 and at < len(changed):
            changed[at:at] = [changed[random.randrange(1, len(changed))]]
        else:
            changed[at : at + 1] = [random.choice(ARGUMENTS)]
    return changed


def mutated_settings(random: Random) -> list[str]:
    """Return settings of one or two numbers of a task, each of any magnitude."""
    return [f"{key}={_magnitude(random)}" for key in random.sample(KEYS, random.randint(1, 2))]


def _magnitude(random: Random) -> str:
    number = 10.0 ** (random.uniform(-13, 13) if random.random() < 0.4 else random.uniform(-3, 3))
    return f"{random.choice([1, 1, 1, 1, 1, -1]) * (number if random.random() < 0.7 else round(number)):.3g}"


def _new_value(text: str, random: Random) -> str:
    """Put something else in the place of a value."""
    values = list(re.finditer(r"(?<=[:,\[] )[^\s,\[\]{}]+|(?<=\[)[^\s,\[\]{}]+", text))
    if not values:
        return text + random.choice(VALUES)
    value = random.choice(values)
    return text[: value.start()] + random.choice(VALUES) + text[value.end() :]


def _insertion(text: str, random: Random) -> str:
    at = random.randint(0, len(text))
    return text[:at] + random.choice(VALUES) + text[at:]


def _deletion(text: str, random: Random) -> str:
    at = random.randint(0, len(text))
    return text[:at] + text[at + random.choice([1, 1, 5, 50, 500]) :]


def _other_lines(text: str, random: Random) -> str:
    """Leave a line out, repeat it, indent it or put it elsewhere."""
    lines = text.splitlines(keepends=True) or [""]
    line = lines.pop(random.randrange(len(lines)))
    kind, at = random.randrange(4), random.randint(0, len(lines))
    if kind == 1:
        lines[at:at] = [line]
    elif kind == 2:
        lines[at:at] = [line, line]
    elif kind == 3:
        lines[at:at] = [" " * random.randint(1, 9) + line]
    return "".join(lines)


def _other_character(text: str, random: Random) -> str:
    at = random.randrange(len(text)) if text else 0
    return text[:at] + random.choice("ab:-[]{}&*!|>'\"%@`#,? \n\t~0e.\x07") + text[at + 1 :]


def _tower(text: str, random: Random) -> str:
    return TOWER + text if random.random() < 0.2 else text + TOWER


_OF_TEXT: tuple[Callable[[str, Random], str], ...] = (
    *(_new_value, _new_value, _new_value, _insertion, _deletion, _other_lines, _other_lines, _other_character),
    _tower,
)
