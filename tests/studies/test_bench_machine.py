from pathlib import Path

import pytest

from psmpc_cli.studies.bench_machine import compiler, describe_machine, processor


def test_the_processor_has_the_name_the_system_gives_it(tmp_path: Path) -> None:
    (tmp_path / "cpuinfo").write_text(
        "processor : 0\nmodel name\t: A fast one\nprocessor : 1\nmodel name\t: A fast one\n"
    )
    assert processor(tmp_path / "cpuinfo") == "A fast one"


def test_a_system_that_does_not_say_is_no_error(tmp_path: Path) -> None:
    assert processor(tmp_path / "missing") is None or isinstance(processor(tmp_path / "missing"), str)


def test_no_compiler_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert compiler() is None
    assert describe_machine()["compiler"] is None
