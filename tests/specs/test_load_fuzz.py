"""Whatever is done to a description, it loads or every fault is located, in words that fit a terminal."""

import copy
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.specs.document import MOST_VALUES, Data, read, write
from psmpc_cli.specs.files import LARGEST_FILE
from psmpc_cli.specs.load import load_task, parse_task

from ..fuzz_settings import fuzzing

TRANSPORT = load_task("transport")
TASK = read("task", TRANSPORT.task_yaml.replace("planar_dual_arm", "robot.yaml"))
ROBOT = read("robot", TRANSPORT.robot_yaml)
TWO_ROWS = "times: [0, 16], base: [[0, 0, 0], [0.8, 0, 0]], arms: [[0, 1, 0], [1, 1, 0]]"
TRACKING = load_task("tracking", [f"stages.trace.target={{{TWO_ROWS}}}"]).task_yaml
MOVING = read("moving", TRACKING.replace("planar_dual_arm", "robot.yaml"))

AT_THE_BOUNDS = {
    "unknown keys": "".join(f"keys{i}: 1\n" for i in range(MOST_VALUES // 2 - 100)),
    "bad stages": "stages:\n" + "- {a: b}\n" * (MOST_VALUES // 3 - 100),
    "one text": "a" * LARGEST_FILE,
    "open quote": '"' + "a\n" * (LARGEST_FILE // 2 - 1),
    "digits": "seed: " + "9" * (LARGEST_FILE - 6),
    "brackets": "[" * LARGEST_FILE,
}
"""Texts as large as they may be, each the worst of its kind."""

NAMES: list[Data] = ["", "x", "base", "all", "30 deg", "1e999"]
NUMBERS: list[Data] = [None, True, -1, 0, 1.5, 1e300]
COLLECTIONS: list[Data] = [[], [[]], [None], [1, 2], {}, {"base": 3}, {"x": {}}]

junk = st.sampled_from([*NAMES, *NUMBERS, *COLLECTIONS])
steps = st.sampled_from(
    [*"x.=[] ", "[0]", "[9]", "stages", ".capture", ".name", "controller", "target", ".base", "1e999"]
)


def is_clear(error: SpecError) -> bool:
    """Return whether a message is not too long, and cannot control a terminal."""
    return len(str(error)) < 30_000 and all(line.replace("\t", " ").isprintable() for line in str(error).split("\n"))


def mutate(data: Any, path: tuple[str | int, ...], action: str, value: Any) -> Any:
    changed = copy.deepcopy(data)
    inside = changed
    for step in path[:-1]:
        inside = inside[step]
    if action == "remove":
        del inside[path[-1]]
    elif action == "rename" and isinstance(inside, dict):
        inside["renamed"] = inside.pop(path[-1])
    else:
        inside[path[-1]] = value
    return changed


@pytest.mark.parametrize("document", [TASK, MOVING, ROBOT], ids=["task", "moving", "robot"])
@fuzzing(15)
@given(data=st.data())
def test_mutated_description_is_loaded_or_rejected(
    tmp_path_factory: pytest.TempPathFactory, document: Any, data: st.DataObject
) -> None:
    changed, folder = document.data, tmp_path_factory.getbasetemp()
    for _ in range(data.draw(st.integers(1, 3))):
        paths = [path for path in read("changed", write(changed)).origins if path]
        if paths:
            action = data.draw(st.sampled_from(["remove", "rename", "replace"]))
            changed = mutate(changed, data.draw(st.sampled_from(paths)), action, data.draw(junk))
    texts = {"task.yaml": TASK.text, "robot.yaml": ROBOT.text}
    for name, text in {**texts, "robot.yaml" if document is ROBOT else "task.yaml": write(changed)}.items():
        (folder / name).write_text(text, encoding="utf-8")
    try:
        build_problem(load_task(folder / "task.yaml"))
    except SpecError as error:
        found = [line for line in str(error).splitlines() if not re.match(r" +\d* \| ", line)]
        assert found
        assert all(re.match(r".*(task|robot)\.yaml:\d+:\d+: .*(found|more problems)", line) for line in found)


@pytest.mark.slow
@fuzzing(150)
@given(st.lists(st.lists(steps, min_size=1, max_size=6).map("".join), min_size=1, max_size=3))
def test_any_override_is_applied_or_reported_as_it_was_given(overrides: list[str]) -> None:
    try:
        load_task("transport", overrides)
    except SpecError as error:
        assert re.match(r"--set |tasks/transport\.yaml:\d+:\d+: ", str(error))


@pytest.mark.slow
@pytest.mark.parametrize("text", AT_THE_BOUNDS.values(), ids=AT_THE_BOUNDS)
def test_the_worst_text_that_is_not_too_large_is_rejected_in_clear_words(text: str) -> None:
    with pytest.raises(SpecError) as rejected:
        parse_task(text, TRANSPORT.robot_yaml, "worst")
    assert is_clear(rejected.value)
