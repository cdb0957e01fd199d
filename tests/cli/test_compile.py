from pathlib import Path

import pytest
from typer.testing import CliRunner

from psmpc_cli.cli.main import app
from psmpc_cli.errors import InputError, SpecError

IDEAL = "plant.kind=ideal"


def compile_task(*arguments: str) -> str:
    return CliRunner().invoke(app, ["compile", *arguments], catch_exceptions=False).output


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_it_says_what_it_compiled_and_where_it_is(cache: Path) -> None:
    output = compile_task("transport", "--set", "solver.kind=fatrop")
    (library,) = (path for path in cache.iterdir() if path.suffix != ".sha256")
    assert "a tick of the plant" in output
    assert library.name in output
    assert output.splitlines()[-1] == f"in {cache}"


def test_it_says_that_there_is_nothing_to_compile(cache: Path) -> None:
    output = compile_task("transport", "--set", "solver.kind=fatrop", "--set", IDEAL)
    assert output == "nothing to compile: solver fatrop and plant ideal run as they are\n"
    assert not cache.exists()


def test_it_says_that_the_task_will_not_use_it() -> None:
    output = compile_task("transport", "--set", "solver.kind=fatrop", "--set", "solver.compiled=false")
    assert output.splitlines()[-1].startswith("note: the task says solver.compiled: false")


def test_a_missing_compiler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/no/such/compiler")
    with pytest.raises(InputError, match="could not compile a tick of the plant; expected a C compiler"):
        compile_task("transport", "--set", "solver.kind=fatrop")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere.yaml",), "nowhere.yaml"),
        (("transport", "--set", "solver.compiled=perhaps"), "expected true or false"),
    ],
)
def test_bad_input_is_refused(arguments: tuple[str, ...], message: str) -> None:
    with pytest.raises((InputError, SpecError), match=message):
        compile_task(*arguments)
