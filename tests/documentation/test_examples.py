"""The examples of tasks and robots in the documentation load, and docs/schema is the models'."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from psmpc_cli.specs.document import Data, read, write
from psmpc_cli.specs.library import Kind, json_schema
from psmpc_cli.specs.load import load_robot, load_task, parse_task
from psmpc_cli.specs.stages import StageSpec
from psmpc_cli.specs.task import TaskSpec

TRANSPORT = load_task("transport")
DOCS = Path(__file__).parents[2] / "docs"
PAGES = {
    name: (DOCS / name).read_text(encoding="utf-8") for name in ("tasks.md", "own_task.md", "robots.md", "../README.md")
}


def examples(page: str) -> Iterator[dict[str, Data]]:
    for text in re.findall(r"^```yaml(?: title=\S+)?\n(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE):
        data = read(page, text).data
        assert isinstance(data, dict)
        yield data


@pytest.mark.parametrize(
    ("page", "number"), [(page, k) for page in ("tasks.md", "own_task.md") for k in range(len(list(examples(page))))]
)
def test_examples_of_tasks_load(page: str, number: int) -> None:
    example = list(examples(page))[number]
    task = read("transport", TRANSPORT.task_yaml).data
    assert isinstance(task, dict) and isinstance(task["stages"], list)
    stages = [{key: value for key, value in stage.items() if key != "priority"} for stage in task["stages"]]
    if example.keys() <= StageSpec.model_fields.keys() - TaskSpec.model_fields.keys():
        example = {"stages": [{**stages[0], **example}, *stages[1:]]}
    dropped = ("object", "monitors", "published", "by_controller") if "stages" in example else ()
    kept = {key: value for key, value in task.items() if key not in dropped}
    parse_task(write({**kept, "stages": stages, **example}), TRANSPORT.robot_yaml, "example")


def test_the_task_of_the_readme_loads_and_its_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([\w./-]+)", PAGES["../README.md"])
    assert links and [link for link in links if not (DOCS.parent / link).exists()] == []
    (example,) = examples("../README.md")
    assert [stage.name for stage in parse_task(write(example), TRANSPORT.robot_yaml, "example").spec.stages]


@pytest.mark.parametrize("number", range(len(list(examples("robots.md")))))
def test_examples_of_robots_load(number: int, tmp_path: Path) -> None:
    example = list(examples("robots.md"))[number]
    robot = {} if "urdf" in example or "space" in example else read("robot", load_task("transport").robot_yaml).data
    assert isinstance(robot, dict)
    for path in (DOCS.parent / "robots").glob("*.urdf"):
        shutil.copy(path, tmp_path)
    (tmp_path / "robot.yaml").write_text(write({**robot, **example}))
    assert load_robot(tmp_path / "robot.yaml").bodies


@pytest.mark.parametrize("kind", ["robot", "task"])
def test_committed_schema_is_the_generated_one(kind: Kind) -> None:
    committed = (DOCS / "schema" / f"{kind}.json").read_text(encoding="utf-8")
    assert json.loads(committed) == json_schema(kind), f"psmpc schema {kind} > docs/schema/{kind}.json writes it anew"
