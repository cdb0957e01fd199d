from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.run import Run, read_run

from ..synthetic_logs import Story, story_among_obstacles, write_story

Write = Callable[..., Path]


@pytest.fixture(autouse=True)
def styled() -> Iterator[None]:
    """Figures are made in their own style, as the registry and the reports make them."""
    with in_style():
        yield


@pytest.fixture(scope="session")
def write_log() -> Write:
    """Write the log of a story: (path, **story) -> path."""

    def write(path: Path, **story: Any) -> Path:
        return write_story(path, replace(Story(), **story))

    return write


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory, write_log: Write) -> Run:
    """A finished transport run in which Capture starts early."""
    return read_run(write_log(tmp_path_factory.mktemp("logs") / "transport.h5"))


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Run]:
    """Four controllers on one task: under the second the object is lost, the last was stopped in its third stage."""
    stories = {
        "psmpc": Story(),
        "smpc": Story(ends=(10.2, 14.8, 24.8, 29.0), early={1: 8.0, 3: 20.0}),
        "htmpc": Story(ends=(10.4, 19.2, 29.2, 35.6), early={}),
        "hard": Story(ends=(10.4, 19.0, 29.0, 36.0), early={}, last=24.0),
    }
    folder = tmp_path_factory.mktemp("comparison")
    return {
        name: read_run(write_story(folder / f"{name}.h5", replace(story, attributes={"controller": name})))
        for name, story in stories.items()
    }


@pytest.fixture
def load(tmp_path: Path, write_log: Write) -> Callable[..., Run]:
    """The run of a story: (**story) -> run."""
    numbers = count()
    return lambda **story: read_run(write_log(tmp_path / f"{next(numbers)}.h5", **story))


@pytest.fixture
def one_arm() -> dict[str, Any]:
    """A run of one stage by a robot with one arm, without an object."""
    robot = """
name: scout
base: {mass: 10, inertia: 1}
arms:
  arm:
    mount: {position: [0.2, 0]}
    links: [{mass: 1, inertia: 0.1, a: 0.3, b: 0.3}, {mass: 1, inertia: 0.1, a: 0.2, b: 0.2}]
limits: {base: {velocity: [0.4, 0.6, 9]}, arms: {acceleration: [0.5, 0.5]}}
"""
    task = """
robot: scout
initial: {base: [0, 0, 0], arm: [0, 0]}
skills:
  go:
    space: joint
    weights: {base: [1, 1, 1], arm: [1, 1], control: 1}
    limits: {base: {velocity: [0.3, 0.5, 8]}}
stages:
  - name: go
    skill: go
    target: {base: [1, 2, 0.1], arm: [0.5, 0.5]}
    ends_when: {coordinates: [base], tolerance: 0.01}
"""
    points = (np.zeros(5), np.array([1.0, 2.0, 0.1, 0.5, 0.5]))
    return {"task": task, "robot": robot, "ends": (6.0,), "points": points, "early": {}}


@pytest.fixture
def keeping_clear() -> dict[str, Any]:
    """A run that keeps clear of obstacles and object."""
    return story_among_obstacles()


@pytest.fixture
def many_stages() -> dict[str, Any]:
    """A run of 14 short stages with long names by a robot with four arms with long names, of seven joints each."""
    arms = [f"manipulator_with_a_long_name_{k}" for k in range(4)]
    links = ", ".join(["{mass: 2, inertia: 0.1, a: 0.1, b: 0.1}"] * 7)
    mounts = [(0.5, 0, 0), (0, 0.5, 90), (-0.5, 0, 180), (0, -0.5, 270)]
    robot = "name: octopus\nbase: {mass: 30, inertia: 1}\narms:\n" + "".join(
        f"  {arm}: {{mount: {{position: [{x}, {y}], angle: {angle} deg}}, links: [{links}]}}\n"
        for arm, (x, y, angle) in zip(arms, mounts, strict=True)
    )
    joints = ", ".join(f"{arm}: [0, 0, 0, 0, 0, 0, 0]" for arm in arms)
    task = f"robot: octopus\ninitial: {{base: [0, 0, 0], {joints}}}\nskills:\n"
    task += "  go: {space: joint, weights: {base: [1, 1, 1], arms: [1, 1, 1, 1, 1, 1, 1], control: 1}}\nstages:\n"
    task += "".join(
        f"  - {{name: inspect_the_far_side_of_panel_{k}, skill: go, target: {{base: [{k}, 1, 0], {joints}}}, "
        "ends_when: {coordinates: [base], tolerance: 0.01}}\n"
        for k in range(14)
    )
    points = tuple(np.r_[k - 1.0, k > 0, 0.0, 0.2 * np.sin(np.arange(28) + k)] for k in range(15))
    return {
        "task": task,
        "robot": robot,
        "ends": tuple(3.0 * (k + 1) for k in range(14)),
        "points": points,
        "early": {},
    }
