"""Every command line in README.md and docs/ is one that the real commands accept; the cheap ones are run."""

import re
import shlex
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from typer.main import get_command

from psmpc_cli.cli.app import app
from psmpc_cli.studies.compare import compare

from ..cli.command import Psmpc
from ..short_runs import there_and_back
from .pages import PAGES, ROOT, tables

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
    for page, command, _ in tables():
        yield from ((page.name, line) for line in command.split(" && ") if line.startswith("psmpc "))


LINES = sorted(set(command_lines()))

CHEAP = re.compile(
    r"(?!psmpc plot LOG$)psmpc (check|schema|init|show|plot|view|report|replay|rerun|verify) "
    r"(?!.*(--gradients|\[|--render|--animate|--open|monte-carlo|--run (hard|\d)"
    r"|(capture|clear|route|space|thrust|turn)\.h5))"
)
"""Commands that take a second or two."""

STANDS_FOR: Mapping[str, str] = {
    r"(my-experiments/robots/dual_arm_servicer|my_robot)\.yaml": "robots/planar_dual_arm.yaml",
    r"my_robot\.urdf": "robots/dual_arm_servicer.urdf",
    r"(task|my|my-experiments/tasks/approach_capture)\.yaml|TASK": "task.yaml",
    r"runs/(two|transport-comparison)\.h5": "compared.h5",
    r"LOG|FILE|\S+\.h5": "log.h5",
}
"""What a file that a cheap command reads is a copy of: of a built-in robot, or of a file in the folder of `read`."""

CHEAP_ONES = {
    re.sub(r"(?<= )(LOG|FILE|[a-z]\.h5)(?= |$)", "LOG", line.replace(" --force", "")): line
    for _, line in LINES
    if CHEAP.match(line)
}
"""Those that differ in the name of a log alone, or in --force where nothing is replaced, are one."""


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a task, a log of a hundred samples, a comparison and the built-in robots."""
    folder = tmp_path_factory.mktemp("read")
    shutil.copytree(ROOT / "robots", folder / "robots")
    there_and_back(folder, "controller.sample_time=0.02", "stages.back.ends_when.tolerance=1e-3")
    compare(folder / "task.yaml", ("psmpc", "hard"), folder / "compared.h5", jobs=1)
    return folder


BLOCK = re.compile(r"^```(?!text|yaml|python|json|xml)\w*\n(.*?)^```|((?:^ {4}[^\n]*\n)+)", re.MULTILINE | re.DOTALL)
"""Blocks of commands: in fences, or indented."""


def blocks_of_commands() -> Iterator[tuple[str, str]]:
    """Yield page and text of every block whose first line is a command."""
    for page in PAGES:
        for groups in BLOCK.findall(page.read_text(encoding="utf-8")):
            text = "".join(groups)
            if re.match(r"(?: {4})?(\$|psmpc|make|pip|python3?|source|timeout) ", text):
                yield page.name, text


@pytest.mark.parametrize(("page", "text"), sorted(set(blocks_of_commands())))
def test_a_block_of_commands_can_be_pasted(page: str, text: str) -> None:
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        assert words[:1] != ["$"], f"{page}: a prompt is pasted too: {line}"
        assert not re.search(r"[^ #] {2,}[^ #-]", line.partition("#")[0].strip()), f"{page}: prose behind {line}"


def test_there_are_command_lines() -> None:
    assert len(LINES) > 60
    assert {"README.md", "sweeps.md", "tasks.md"} <= {page for page, _ in LINES}


@pytest.mark.parametrize(("page", "line"), LINES, ids=[line for _, line in LINES])
def test_a_documented_command_is_accepted(page: str, line: str) -> None:
    _, name, *arguments = shlex.split(line)
    command = GROUP.commands[name]
    if not arguments or " [" in line.partition("{")[0]:  # the name alone, or a synopsis
        options = {option for parameter in command.params for option in parameter.opts}
        assert set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", " ".join(arguments))) <= options
    else:
        command.make_context(name, arguments)


@pytest.mark.slow
@pytest.mark.parametrize("line", sorted(CHEAP_ONES.values()))
def test_a_cheap_command_runs(line: str, psmpc: Psmpc, read: Path) -> None:
    for name, source in STANDS_FOR.items():
        for found in re.finditer(rf"(?<= )(?:{name})(?= |$)", line):
            place = Path(found[0])
            place.parent.mkdir(parents=True, exist_ok=True)
            if not place.exists():
                shutil.copy(read / source, place)
    assert psmpc(*shlex.split(line)[1:]).code == 0


def test_every_target_of_make_is_there() -> None:
    rules = set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(r"(?:^|`| {4})make ([a-z-]+)(?=`| {2}| ONLY|$)", text, re.MULTILINE))
    assert len(named) > 5
    assert named <= rules
