"""The tests mirror the source: tests/X/test_y.py, or test_y_<aspect>.py, tests psmpc_cli/X/y.py or the folder X/y."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SOURCE = TESTS.parent / "psmpc_cli"

APART = ("acceptance", "documentation")
"""Folders of tests that are about no single module."""

REACHED_THROUGH = {
    "cli/common.py": "cli/test_run.py",
    "cli/descriptions.py": "cli/test_inspect.py",
    "cli/options.py": "cli/test_run.py",
    "control/control_law.py": "control/test_controller.py",
    "control/memory.py": "control/test_controller.py",
    "ocp/constraints/base.py": "ocp/test_constraints.py",
    "ocp/constraints/end.py": "ocp/test_constraints.py",
    "ocp/constraints/jerk.py": "solvers/test_base_rates.py",
    "ocp/constraints/kept.py": "ocp/test_constraints.py",
    "ocp/skills/base.py": "ocp/test_objective.py",
    "ocp/skills/joint.py": "ocp/test_objective.py",
    "ocp/skills/point.py": "ocp/test_skills.py",
    "ocp/skills/task.py": "ocp/test_objective.py",
    "plant/ideal.py": "plant/test_base.py",
    "plant/rk4.py": "plant/test_base.py",
    "plant/tick_functions.py": "plant/test_base.py",
    "report/pages.py": "cli/test_run_pages.py",
    "report/texts.py": "cli/test_run.py",
    "robot/model.py": "robot/test_kinematics.py",
    "solvers/sqp_window.py": "solvers/test_quadratic.py",
    "specs/robots/actuators.py": "specs/robots/test_robot.py",
    "specs/arguments.py": "test_public_api.py",
    "specs/library.py": "cli/test_inspect.py",
    "studies/measures.py": "studies/test_monte_carlo.py",
}
"""Modules without a test file of their own: a kind is tested alike as a whole, or where users meet it."""


def modules() -> Iterator[str]:
    """Every module by its path, but the packages' own."""
    for path in sorted(SOURCE.rglob("*.py")):
        if path.name != "__init__.py":
            yield path.relative_to(SOURCE).as_posix()


def named_for(path: Path) -> Path | None:
    """The module or folder that a test file is named for: that of the longest name."""
    folder = SOURCE / path.relative_to(TESTS).parent
    words = path.stem.removeprefix("test_").split("_")
    for count in range(len(words), 0, -1):
        name = "_".join(words[:count])
        for found in (folder / f"{name}.py", folder / name / "__init__.py"):
            if found.exists():
                return found
    return None


@pytest.mark.parametrize("module", list(modules()))
def test_every_module_has_tests_in_its_place(module: str) -> None:
    path = Path(module)
    own = TESTS / path.parent / f"test_{path.name}"
    elsewhere = REACHED_THROUGH.get(module)
    assert own.exists() == (elsewhere is None), f"expected {own}, or where else {module} is tested"
    assert elsewhere is None or (TESTS / elsewhere).exists()


def test_every_test_file_is_named_for_what_it_tests() -> None:
    mirrored = [
        path
        for path in TESTS.rglob("test_*.py")
        if path.parent != TESTS and path.relative_to(TESTS).parts[0] not in APART
    ]
    assert len(mirrored) > 80
    assert [path for path in mirrored if named_for(path) is None] == []


@pytest.mark.parametrize("path", sorted(TESTS.rglob("*.py")), ids=lambda path: str(path.relative_to(TESTS)))
def test_no_test_imports_from_a_test_module(path: Path) -> None:
    """What several share stands in a module of its own, which runs no tests when it is imported."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    imported = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    assert not [module for module in imported if module.rpartition(".")[2].startswith("test_")]
