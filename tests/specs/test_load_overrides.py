from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import SECTIONS_WITH_A_KIND
from psmpc_cli.specs.fields import Choice
from psmpc_cli.specs.load import load_task, parse_task, read_documents
from psmpc_cli.specs.task import TaskSpec

TRANSPORT = load_task("transport")


def specified(*overrides: str) -> TaskSpec:
    return load_task("transport", overrides).spec


def error_of(*overrides: str) -> str:
    with pytest.raises(SpecError) as raised:
        load_task("transport", overrides)
    return str(raised.value)


@pytest.mark.parametrize(
    ("override", "old", "new"),
    [
        ("controller.nodes=25", "nodes: 100", "nodes: 25"),
        ("controller=smpc", "kind: psmpc", "kind: smpc"),
        ("plant=mujoco", "kind: rk4", "kind: mujoco"),
        ("stages[1].priority=10", "priority: 100", "priority: 10"),
        ("stages.capture.priority=10", "priority: 100", "priority: 10"),
        ("stages.approach.target.base=[-2, 1, 0.5 rad]", "base: [-2, 2, 30 deg]", "base: [-2, 1, 0.5 rad]"),
        ("plant.step=1e-4", "{kind: rk4, low_level_rate: 1000}", "{kind: rk4, low_level_rate: 1000, step: 1e-4}"),
        ("log.ticks=true", "object:", "log: {ticks: true}\nobject:"),
        ("clearance.except=[[arm_1, arm_2]]", "object:", "clearance: {except: [[arm_1, arm_2]]}\nobject:"),
        ("stages.capture.clearance.margin=0.1", "priority: 100", "priority: 100\n    clearance: {margin: 0.1}"),
        ("monitors.object held.above_start_at_most=0.1", "above_start_at_most: 0.05", "above_start_at_most: 0.1"),
    ],
)
def test_override_equals_editing_the_file(override: str, old: str, new: str, tmp_path: Path) -> None:
    assert old in TRANSPORT.task_yaml
    edited = tmp_path / "transport.yaml"
    edited.write_text(TRANSPORT.task_yaml.replace(old, new, 1), encoding="utf-8")
    assert specified(override) == load_task(edited).spec != TRANSPORT.spec


def test_kind_alone_becomes_a_mapping() -> None:
    edited = TRANSPORT.task_yaml.replace("solver: {kind: sqp", "solver: sqp #")
    task = parse_task(edited, TRANSPORT.robot_yaml, "transport", ["solver=fatrop", "solver.tolerance=1e-6"])
    assert (task.spec.solver.kind, task.spec.solver.tolerance) == ("fatrop", 1e-6)
    assert "solver: {kind: fatrop, tolerance: 1.0e-06}" in task.task_yaml


def test_a_text_in_place_of_a_section_changes_its_kind_alone() -> None:
    changed = {"controller.nodes": 25, "solver.iterations": 2, "plant.low_level_rate": 500, "onset.epsilon": 0.2}
    kinds = {"controller": "hard", "solver": "ipopt", "plant": "ideal", "onset": "control"}
    assert load_task("transport", {**changed, **kinds}).digest == (
        load_task("transport", {**changed, **{f"{section}.kind": kind for section, kind in kinds.items()}}).digest
    )
    own = {"by_controller": {"hard": {"solver": "ipopt"}}}
    waiting = load_task("transport", {**changed, **own, "controller": "hard"})
    assert (waiting.spec.solver.kind, waiting.spec.solver.iterations) == ("ipopt", 2)
    with pytest.raises(SpecError, match=r'controller\.kind: found the text "lqr", expected one of'):
        load_task("transport", {"controller": "lqr"})


def test_the_sections_with_a_kind_are_those_of_a_task() -> None:
    choices = (name for name, key in TaskSpec.model_fields.items() if isinstance(key.default, Choice))
    assert set(choices) == set(SECTIONS_WITH_A_KIND)


def test_an_option_short_for_a_key_sets_it_and_is_named_where_it_is_wrong() -> None:
    assert load_task("transport", [("--plant ideal", "plant.kind=ideal")]).spec == specified("plant.kind=ideal")
    with pytest.raises(SpecError, match=r"^--plant mars: plant\.kind: found the text \"mars\", expected one of"):
        load_task("transport", [("--plant mars", "plant.kind=mars")])
    with pytest.raises(SpecError, match=r"^--plant \{: found "):
        load_task("transport", [("--plant {", "plant.kind={")])


def test_a_mapping_sets_values_of_python() -> None:
    task = load_task("transport", set={"controller.nodes": "auto", "stages[0].target.base": (-2.0, 1, "30 deg")})
    texts = ["controller.nodes=auto", "stages.approach.target.base=[-2, 1, 30 deg]"]
    assert task.spec == specified(*texts)
    assert parse_task(task.task_yaml, task.robot_yaml, "transport").digest == task.digest
    assert load_task("transport", {"uncertainty": {"noise": {"angle": 1e-3}}}).spec.uncertainty.noise.angle == 1e-3
    with pytest.raises(SpecError, match=r'^set controller.kind="mars": controller.kind: found the text "mars", exp'):
        load_task("transport", {"controller.kind": "mars"})


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("stages[1].priority=-3", "stages[1].priority: found -3, expected a number greater than 0"),
        ("nodes", 'found no "=", expected path=value, such as controller.nodes=25'),
        ("=3", 'found the path "", expected one such as stages[1].priority or stages.capture.priority'),
        (
            "stages[x]=3",
            'found the path "stages[x]", expected one such as stages[1].priority or stages.capture.priority',
        ),
        (
            "stages[7].priority=1",
            "stages: found no entry 7, expected one of approach, capture, transport, release, an index from 0 to 3",
        ),
        (
            "controller.kind.x=1",
            'controller.kind: found the text "psmpc", expected a mapping or list to set x in',
        ),
        ("controller[0]=1", "controller: found a mapping of 6 keys, expected a mapping or list to set [0] in"),
        ("controller.nodes=", "controller.nodes: found nothing, expected a whole number from 2 to 1000, or auto"),
        (
            "controller.nodes=[1",
            "found no plain YAML, while parsing a flow sequence that begins in line 1: "
            "expected ',' or ']', but got '<stream end>'",
        ),
        (
            "solver.kindd=ipopt",
            'solver.kindd: found an unknown key (did you mean "kind"?), '
            "expected one of kind, tolerance, max_iterations, iterations, entry_iterations, deadline, gradient, "
            "compiled",
        ),
        (
            "solver.gradient=printed",
            'solver.gradient: found the text "printed", '
            'expected "exact", or solver adjoint: sqp differentiates J itself',
        ),
        ("controller.sample_time=5", "controller.sample_time: found 5 s, expected at most the horizon of 4 s"),
    ],
)
def test_wrong_override_is_reported_as_it_was_given(override: str, message: str) -> None:
    assert error_of(override) == f"--set {override}: {message}"


def test_all_wrong_overrides_are_reported_together() -> None:
    text = error_of("stages[1].priority=-3", "seed=x", "nonsense", "controller.nodes=0")
    assert [line.partition(":")[0] for line in text.splitlines()] == [
        "--set stages[1].priority=-3",
        "--set seed=x",
        "--set controller.nodes=0",
        "--set nonsense",
    ]


OWN = {"htmpc": {"skills.move.weights.control": 0.1, "stages.approach.ends_when.tolerance": 0.05}}
AS_HTMPC = {"controller.kind": "htmpc"}


def test_keys_of_one_controller_hold_for_it_alone() -> None:
    waiting, chosen = (load_task("transport", {"by_controller": OWN, **kind}) for kind in ({}, AS_HTMPC))
    assert waiting.digest == TRANSPORT.digest
    assert chosen.digest == load_task("transport", {"by_controller": {}, **AS_HTMPC, **OWN["htmpc"]}).digest
    for task, kind, same in ((waiting, {}, waiting), (chosen, {}, chosen), (waiting, AS_HTMPC, chosen)):
        assert parse_task(task.task_yaml, task.robot_yaml, "transport", kind).digest == same.digest
    other = parse_task(chosen.task_yaml, chosen.robot_yaml, "transport", {"controller.kind": "psmpc"})
    assert other.digest == TRANSPORT.digest


GO = {"name": "go", "skill": "move", "target": {"base": [1, 0, 0], "arms": [0, 0, 0]}}
ONE_STAGE = {
    "stages": [{**GO, "ends_when": {"coordinates": "base", "tolerance": 0.01}}],
    "object": None,
    "monitors": [],
    "published": {},
}


@pytest.mark.parametrize(
    ("override", "control", "tolerance"),
    [
        ({"skills.move.weights.control": 0.2}, 0.2, 0.05),
        ({"skills.reach.weights.control": 0.2}, 0.1, 0.05),
        ({"stages[0].ends_when": {"coordinates": "base", "tolerance": 0.02}}, 0.1, 0.02),
        ({"controller": "htmpc"}, 0.1, 0.05),
        ({**ONE_STAGE, "skills.move.weights.control": 0.3}, 0.3, 0.01),
    ],
)
def test_overrides_win_over_keys_of_a_controller(override: dict[str, Any], control: float, tolerance: float) -> None:
    task = load_task("transport", {"by_controller": OWN, **AS_HTMPC, **override})
    for each in (task, parse_task(task.task_yaml, task.robot_yaml, "stored")):
        assert each.spec.skills["move"].weights.control == control
        assert each.spec.stages[0].ends_when is not None
        assert each.spec.stages[0].ends_when.tolerance == tolerance


def test_variants_of_a_task_that_was_read_once_are_those_of_its_texts() -> None:
    task = load_task("transport", {"by_controller": OWN})
    texts = task.task_yaml, task.robot_yaml, "transport"
    documents = read_documents(*texts)
    for changes in (["controller=htmpc"], ["seed=7", "stages.capture.priority=3"], [], ["controller.nodes=auto"]):
        variant = documents.changed(changes)
        stored = parse_task(*texts, changes)
        assert (variant.digest, variant.task_yaml) == (stored.digest, stored.task_yaml)
    with pytest.raises(SpecError) as found:
        documents.changed(["controller.nodes=none"])
    with pytest.raises(SpecError) as expected:
        parse_task(*texts, ["controller.nodes=none"])
    assert str(found.value) == str(expected.value)


def test_keys_of_a_controller_need_to_be_valid_with_it_alone() -> None:
    free_end = {"controller.one_stage": "free_end"}
    task = load_task("transport", {"by_controller": {"hard": free_end}, "controller.nodes": "auto"})
    assert task.spec.controller.one_stage == "as_published"
    chosen = parse_task(task.task_yaml, task.robot_yaml, "transport", {"controller": "hard"})
    assert chosen.spec.controller.one_stage == "free_end"
    with pytest.raises(SpecError, match="or controller hard or htmpc: windows of smpc are over several stages"):
        load_task("transport", {"by_controller": {"smpc": free_end}})


def test_keys_of_every_controller_are_validated(tmp_path: Path) -> None:
    wrong = {
        "  mpc: {}": (3, "by_controller.mpc: found no such controller"),
        "  hard: {skills.move.spac: joint}": (10, "skills.move.spac: found an unknown key"),
        "  htmpc: {stages.aproach.at: 1}": (11, "by_controller.htmpc.stages.aproach.at: stages: found no entry"),
        "  smpc: {controler.nodes: 10}": (10, "controler: found an unknown key"),
        "  psmpc: {controller.kind: smpc}": (11, "by_controller.psmpc.controller.kind: found the key"),
    }
    path = tmp_path / "own.yaml"
    before, _, _ = TRANSPORT.task_yaml.partition("by_controller:")
    path.write_text("\n".join((before + "by_controller:", *wrong)) + "\n", encoding="utf-8")
    with pytest.raises(SpecError) as raised:
        load_task(path)
    first = before.count("\n") + 2
    for line, (column, message) in enumerate(wrong.values(), start=first):
        assert f"{path}:{line}:{column}: {message}" in str(raised.value)
