"""Whatever is done to the text of a description, it loads or is refused in words that fit a terminal."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import MOST_VALUES
from psmpc_cli.specs.library import LARGEST_FILE as LARGEST
from psmpc_cli.specs.load import load_robot, load_task, parse_task
from psmpc_cli.specs.overrides import LONGEST

from ..fuzzing import fuzzing
from ..mutated_text import mutated_description

TRANSPORT = load_task("transport")

AT_THE_BOUNDS = {
    "unknown keys": "".join(f"keys{i}: 1\n" for i in range(MOST_VALUES // 2 - 100)),
    "bad stages": "stages:\n" + "- {a: b}\n" * (MOST_VALUES // 3 - 100),
    "one text": "a" * LARGEST,
    "comments": "# x\n" * (LARGEST // 4),
    "open quote": '"' + "a\n" * (LARGEST // 2 - 1),
    "anchors": "".join(f"keys{i}: &a{i} x\n" for i in range(MOST_VALUES // 2 - 100)),
    "digits": "seed: " + "9" * (LARGEST - 6),
    "colons": ":" * LARGEST,
    "escapes": '"' + "\\x41" * (LARGEST // 4 - 1) + '"',
}
"""Texts as large as they may be, each the worst of its kind."""


def is_clear(error: SpecError) -> bool:
    """Return whether a message is not too long, and cannot command a terminal."""
    return len(str(error)) < 30_000 and all(line.replace("\t", " ").isprintable() for line in str(error).split("\n"))


@fuzzing(600)
@given(seed=st.integers(0, 2**32), of_robot=st.booleans())
def test_mutated_file_is_loaded_or_refused(tmp_path_factory: pytest.TempPathFactory, seed: int, of_robot: bool) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.yaml"
    path.write_bytes(mutated_description(TRANSPORT.robot_yaml if of_robot else TRANSPORT.task_yaml, Random(seed)))
    before = path.read_bytes()
    try:
        load_robot(path) if of_robot else load_task(path)
    except SpecError as error:
        assert is_clear(error)
    assert path.read_bytes() == before


@pytest.mark.parametrize("text", AT_THE_BOUNDS.values(), ids=AT_THE_BOUNDS)
def test_the_worst_text_that_is_not_too_large_is_refused_in_clear_words(text: str) -> None:
    with pytest.raises(SpecError) as refused:
        parse_task(text, TRANSPORT.robot_yaml, "worst")
    assert is_clear(refused.value)


def test_control_characters_in_a_key_are_written_out() -> None:
    with pytest.raises(SpecError) as refused:
        parse_task(TRANSPORT.task_yaml + '"a\\e[31m\\nb": 1\n', TRANSPORT.robot_yaml, "task")
    assert "a\\x1b[31m\\nb: found an unknown key" in str(refused.value)


def test_overrides_are_refused_unread_when_they_are_too_long() -> None:
    with pytest.raises(SpecError, match=rf"--set: found {LONGEST + 1} characters, expected at most {LONGEST}"):
        load_task("transport", ["a=" + "x" * (LONGEST - 1)])
