"""Shapes as numbers, and shapes of the bodies of planar robots; those in space are in test_robot.py."""

from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.geometry import DEEP, Shape, ShapeSpec
from psmpc_cli.specs.load import load_robot

PLANAR = """name: r
base: {mass: 30, inertia: 1}
arms:
  arm:
    mount: {position: [0.3, 0]}
    links:
      - {mass: 4, inertia: 0.3, a: 0.2, b: 0.2}
"""


@pytest.mark.parametrize(
    ("given", "shape"),
    [
        ({"sphere": 0.2}, Shape("capsule", (0.2, 0.0))),
        ({"capsule": (0.1, 0.5)}, Shape("capsule", (0.1, 0.5))),
        ({"box": (1.0, 2.0, 3.0)}, Shape("box", (1.0, 2.0, 3.0))),
        ({"box": (1.0, 2.0)}, Shape("box", (1.0, 2.0, DEEP))),
        ({"half_space": (0.0, 3.0, 4.0)}, Shape("half_space", (0.0, 0.6, 0.8))),
        ({"half_space": (3.0, 4.0)}, Shape("half_space", (0.6, 0.8, 0.0))),
    ],
)
def test_a_shape_is_numbers_in_space(given: dict[str, object], shape: Shape) -> None:
    assert ShapeSpec.model_validate(given).shape == shape


def test_bodies_of_a_planar_robot_have_shapes_of_the_plane(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(
        PLANAR + "geometry: {arm.1: [{shape: {box: [0.4, 0.1]}, pose: [0.2, 0, 30 deg]}]}\n"
    )
    (placed,) = load_robot(tmp_path / "r.yaml").geometry["arm.1"]
    assert placed.shape.box == (0.4, 0.1)
    assert placed.pose == pytest.approx((0.2, 0, 0.5235987755982988))


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ("{shape: {box: [1, 1, 1]}}", ("geometry.base[0].shape.box:", "2 entries")),
        ("{shape: {sphere: 1}, pose: [0, 0, 0, 1, 0, 0, 0]}", ("geometry.base[0].pose:", "3 entries")),
        ("{shape: {sphere: 1}, pose: [0, 0, 30]}", ("geometry.base[0].pose[2]:", "30 deg")),
        ("{shape: {half_space: [1, 0]}}", ("shape.half_space:", "sphere, capsule or box")),
        ("{shape: {capsule: [1]}}", ("shape.capsule:", "2 entries")),
        ("{shape: {cone: 1}}", ("shape.cone:", "unknown key", "capsule")),
        ("{pose: [0, 0, 0]}", ("geometry.base[0]:", 'no key "shape"')),
    ],
)
def test_bad_shapes_of_bodies_are_named(tmp_path: Path, shapes: str, words: tuple[str, ...]) -> None:
    (tmp_path / "r.yaml").write_text(f"{PLANAR}geometry: {{base: [{shapes}]}}\n")
    with pytest.raises(SpecError) as caught:
        load_robot(tmp_path / "r.yaml")
    assert "r.yaml:8:" in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)
