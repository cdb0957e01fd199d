"""Every command line in README.md and docs/ is one that the real commands accept; the cheap ones are run."""

import re
import shlex
from collections.abc import Iterator

import pytest
from pages import PAGES, ROOT, blocks
from typer.main import get_command

from psmpc_cli.cli.app import app

from .command import Psmpc

CODE = re.compile(r"^```\w*\n(.*?)^```|^((?: {4}.*\n)+)|`(psmpc [^`]+)`", re.MULTILINE | re.DOTALL)

GROUP = get_command(app)

COMMAND = re.compile(rf"^ *(?:\S+ )*?(psmpc (?:{'|'.join(GROUP.commands)})\b.*)", re.MULTILINE)


def command_lines() -> Iterator[tuple[str, str]]:
    """Give page and command of every command line in code, without the explanation that follows two spaces."""
    for page in PAGES:
        text = re.sub("<!--.*?-->", "", page.read_text(encoding="utf-8"))
        for found in CODE.findall(text):
            for line in COMMAND.findall("".join(found).replace("\\\n", " ")):
                yield page.name, re.split(r"(?<=\S) {2,}(?!-|\")", line)[0].replace("\n", " ")
    for page, command, _ in blocks():
        yield from ((page.name, line) for line in command.split(" && ") if line.startswith("psmpc "))


LINES = sorted(set(command_lines()))

CHEAP = re.compile(r"psmpc (check|schema|init) (?!.*(--gradients|\.yaml|\.urdf|\[|FILE))")
"""Commands that take a second and read nothing that is not there."""


def test_there_are_command_lines() -> None:
    assert len(LINES) > 60
    assert {"README.md", "sweeps.md", "tasks.md"} <= {page for page, _ in LINES}


@pytest.mark.parametrize(("page", "line"), LINES, ids=[line for _, line in LINES])
def test_a_documented_command_is_accepted(page: str, line: str) -> None:
    _, name, *arguments = shlex.split(line)
    command = GROUP.commands[name]
    if not arguments or "[" in line.partition("{")[0]:  # the name alone, or a synopsis
        options = {option for parameter in command.params for option in parameter.opts}
        assert set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", " ".join(arguments))) <= options
    else:
        command.make_context(name, arguments)


@pytest.mark.parametrize("line", sorted({line for _, line in LINES if CHEAP.match(line)}))
def test_a_cheap_command_runs(line: str, psmpc: Psmpc) -> None:
    assert psmpc(*shlex.split(line)[1:]).code == 0


def test_every_target_of_make_is_there() -> None:
    rules = set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(r"(?:^|`| {4})make ([a-z-]+)(?=`| {2}| ONLY|$)", text, re.MULTILINE))
    assert len(named) > 5
    assert named <= rules
