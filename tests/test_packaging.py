"""What the project ships and pins, and what must not stand in its files."""

import fnmatch
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]

PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[A-Za-z0-9.!+]+)")

REGISTRY = re.compile(r"\b(?:py(?:pi)|python(?:hosted)|ana(?:conda))\.org\b", re.IGNORECASE)
MACHINE = re.compile(r"(?<![\w.}~/])/(?:home|Users|root|tmp)/\w|\b[A-Z]:\\Users\\")
ADDRESS = re.compile(r"\w://|--(?:extra-)?index-url|--find-links|@ file:")
"""What must not stand in a file; each is written so that it does not find itself."""


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    found = {line: PIN.fullmatch(line) for line in lines if not line.startswith("#")}
    assert [line for line, match in found.items() if match is None] == []
    return {canonicalize_name(match["name"]): match["version"] for match in found.values() if match is not None}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ZipFile]:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    with ZipFile(path) as archive:
        yield archive


def sources() -> Iterator[tuple[Path, str]]:
    """Give every text file of the project, relative to its root: all but what .gitignore names."""
    ignored = [line.rstrip("/") for line in (ROOT / ".gitignore").read_text().split()] + [".git"]
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if not any(fnmatch.fnmatch(name, pattern) for pattern in ignored)]
        for path in (Path(folder, name) for name in files):
            try:
                yield path.relative_to(ROOT), path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue


def files_with(pattern: re.Pattern[str], *, among: tuple[str, ...] = ("**",)) -> list[str]:
    return [
        f"{path}: {found[0]}"
        for path, text in sources()
        if any(fnmatch.fnmatch(str(path), glob) for glob in among) and (found := pattern.search(text))
    ]


def test_the_wheel_holds_every_built_in_robot_and_task(wheel: ZipFile) -> None:
    described = {path.relative_to(ROOT) for kind in ("robots", "tasks") for path in (ROOT / kind).iterdir()}
    assert {Path("robots/planar_dual_arm.yaml"), Path("tasks/transport.yaml")} <= described
    shipped = {name for name in wheel.namelist() if name.startswith("psmpc_cli/builtin/")}
    assert shipped == {f"psmpc_cli/builtin/{path.as_posix()}" for path in described}


def test_the_wheel_holds_every_file_of_the_package_and_nothing_beside_it(wheel: ZipFile) -> None:
    files = {path.as_posix() for path, _ in sources() if path.parts[0] == "psmpc_cli"}
    shipped = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert {name for name in shipped if not name.startswith("psmpc_cli/builtin/")} == files


def test_the_wheel_holds_the_licence_and_the_command(wheel: ZipFile) -> None:
    shipped = {name.partition(".dist-info/")[2]: name for name in wheel.namelist()}
    assert "MIT License" in wheel.read(shipped["licenses/LICENSE"]).decode()
    assert "psmpc = psmpc_cli.cli.main:main" in wheel.read(shipped["entry_points.txt"]).decode()


def test_every_requirement_is_pinned_within_its_bounds(project: dict[str, Any], pins: dict[str, str]) -> None:
    extras = project["project"]["optional-dependencies"].values()
    texts = [*project["build-system"]["requires"], *project["project"]["dependencies"], *chain.from_iterable(extras)]
    for requirement in map(Requirement, texts):
        assert pins[canonicalize_name(requirement.name)] in requirement.specifier, requirement


def test_the_citation_is_of_this_version_and_licence(project: dict[str, Any]) -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["version"] == project["project"]["version"]
    assert citation["license"] == project["project"]["license"]


def test_the_citation_and_the_readme_name_the_paper_and_say_what_is_not_known_of_it() -> None:
    title = "Priority-Based Switching Model Predictive Control for Sequential Manipulation of Space Robot"
    message = yaml.safe_load((ROOT / "CITATION.cff").read_text())["message"]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for text in (message, readme):
        assert title in text
        assert "names neither its authors nor its year and venue" in text


def test_the_changelog_opens_with_this_version_or_what_is_unreleased(project: dict[str, Any]) -> None:
    first = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first is not None
    assert first[1] in {"Unreleased", project["project"]["version"]}


def test_no_file_names_a_registry() -> None:
    assert files_with(REGISTRY) == []


def test_no_file_names_a_path_of_one_machine() -> None:
    here = re.compile(rf"(?<![\w.]){re.escape(str(ROOT))}(?![\w-])")
    assert files_with(MACHINE) + files_with(here) == []


def test_the_set_up_leaves_the_package_index_to_the_machine() -> None:
    assert files_with(ADDRESS, among=("constraints.txt", "Makefile", ".ci/*")) == []
