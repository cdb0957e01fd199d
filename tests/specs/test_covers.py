"""Covers of bodies by capsules: what they hold, and how far they reach beyond."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.specs.covers import COVER_EXCESS, MOST_CAPSULES, Cover, cover_box

Array = NDArray[np.float64]


def depth_in(cover: Cover, points: Array) -> Array:
    """How deep points (K, 3) are in a cover, negative outside (K,)."""
    start, end = cover.ends[:, 0], cover.ends[:, 1]
    along = end - start
    squared = np.maximum((along**2).sum(axis=1), 1e-30)
    shares = np.clip(((points[:, None] - start) * along).sum(axis=2) / squared, 0, 1)
    nearest = start + shares[:, :, None] * along
    return (cover.radius - np.linalg.norm(points[:, None] - nearest, axis=2)).max(axis=1)


def surface_of(cover: Cover, rng: np.random.Generator, count: int) -> Array:
    """Points on the capsules of a cover: on the spheres about both ends, where a convex body is farthest (., 3)."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions = np.vstack([directions, np.eye(3), -np.eye(3)])
    return (cover.ends.reshape(-1, 1, 3) + cover.radius * directions).reshape(-1, 3)


BOXES = [
    (1.0, 1.0),
    (0.6, 0.36),
    (0.2, 1.5),
    (3.0, 0.1),
    (1.0, 1.0, 1.0),
    (0.9, 0.8, 0.7),
    (0.1, 0.7, 0.2),
    (0.02, 0.5, 2.0),
]


@pytest.mark.parametrize("edges", BOXES)
def test_a_box_is_in_its_cover_which_reaches_no_further_than_it_says(edges: tuple[float, ...]) -> None:
    rng = np.random.default_rng(0)
    cover = cover_box(edges)
    assert 1 <= len(cover.ends) <= MOST_CAPSULES
    half = np.array([*edges, 0.0])[:3] / 2
    corners = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    inside = np.vstack([corners, half * rng.uniform(-1, 1, (3000, 3))])
    assert depth_in(cover, inside).min() > -1e-9
    points = surface_of(cover, rng, 3000)
    if len(edges) == 2:
        points[:, 2] = 0  # what of them is in the plane
        points = points[depth_in(cover, points) > -1e-9]
    beyond = np.linalg.norm(np.maximum(np.abs(points) - half, 0), axis=1)
    assert 0.9 * cover.excess < beyond.max() < cover.excess + 1e-9


def test_more_capsules_are_taken_while_the_excess_is_large() -> None:
    assert len(cover_box((3.0, 0.1)).ends) == 1
    assert len(cover_box((1.0, 1.0)).ends) == 2
    assert len(cover_box((1.0, 1.0, 1.0)).ends) == 4
    for edges in BOXES:
        cover = cover_box(edges)
        assert cover.excess <= COVER_EXCESS * max(edges) or len(cover.ends) == MOST_CAPSULES


def test_a_cover_moves_with_its_body() -> None:
    rng = np.random.default_rng(1)
    cover = cover_box((0.9, 0.8, 0.7))
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
    frame[:3, 3] = [1, 2, 3]
    points = rng.uniform(-0.6, 0.6, (500, 3))
    moved = points @ frame[:3, :3].T + frame[:3, 3]
    np.testing.assert_allclose(depth_in(cover.moved(frame), moved), depth_in(cover, points), atol=1e-12)
    assert cover.moved(frame).excess == cover.excess
