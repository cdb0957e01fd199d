"""Whatever is done to a description, it loads or is refused with every problem located; never anything else."""

import copy
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import Data, read, write
from psmpc_cli.specs.load import load_task, parse_task

from ..fuzzing import fuzzing

TASK, ROBOT = (read("original", text) for text in (load_task("transport").task_yaml, load_task("transport").robot_yaml))
TWO_ROWS = "times: [0, 16], base: [[0, 0, 0], [0.8, 0, 0]], arms: [[0, 1, 0], [1, 1, 0]]"
MOVING = read("original", load_task("tracking", [f"stages.trace.target={{{TWO_ROWS}}}"]).task_yaml)

NAMES: list[Data] = ["", "x", "base", "all", "30 deg", "1e999"]
NUMBERS: list[Data] = [None, True, -1, 0, 1.5, 1e300]
COLLECTIONS: list[Data] = [[], [[]], [None], [1, 2], {}, {"base": 3}, {"x": {}}]

junk = st.sampled_from([*NAMES, *NUMBERS, *COLLECTIONS])


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
@fuzzing(200)
@given(data=st.data())
def test_mutated_description_is_loaded_or_refused(document: Any, data: st.DataObject) -> None:
    changed = document.data
    for _ in range(data.draw(st.integers(1, 3))):
        paths = [path for path in read("changed", write(changed)).entries if path]
        path = data.draw(st.sampled_from(paths)) if paths else None
        if path is not None:
            changed = mutate(
                changed, path, data.draw(st.sampled_from(["remove", "rename", "replace"])), data.draw(junk)
            )
    text = write(changed)
    texts = (TASK.text, text) if document is ROBOT else (text, ROBOT.text)
    try:
        parse_task(*texts, "mutated")
    except SpecError as error:
        heads = [line for line in str(error).splitlines() if not re.match(r" +\d* \| ", line)]
        assert heads
        for head in heads:
            assert re.match(r"mutated( \(robot\))?:\d+:\d+: .*(found|more problems)", head), head


steps = st.sampled_from(
    [*"x.=[] ", "[0]", "[9]", "stages", ".capture", ".name", "controller", "target", ".base", "1e999"]
)


@fuzzing(600)
@given(st.lists(st.lists(steps, min_size=1, max_size=6).map("".join), min_size=1, max_size=3))
def test_any_override_is_applied_or_refused_as_it_was_given(overrides: list[str]) -> None:
    try:
        load_task("transport", overrides)
    except SpecError as error:
        assert re.match(r"--set |tasks/transport\.yaml:\d+:\d+: ", str(error))
