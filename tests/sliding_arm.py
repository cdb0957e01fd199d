"""A short task of a robot with an arm that turns and slides."""

from typing import Any

ROBOT = """name: slider
space: spatial
mobility: fixed
base: {mass: 10, inertia: [1, 1, 1]}
arms:
  arm:
    links:
      - {joint: {axis: [0, 0, 1]}, mass: 2, centre_of_mass: [0.2, 0, 0], inertia: [0.01, 0.1, 0.1]}
      - {joint: {axis: [1, 0, 0], kind: prismatic, position: [0.4, 0, 0]}, mass: 2, inertia: [0.01, 0.1, 0.1]}
    tool: {position: [0.3, 0, 0]}
limits:
  arm: {position: [[-90 deg, 90 deg], [0, 8]], velocity: [0.5, 0.4], acceleration: [2, 3], force: [20, 30]}
"""


def sliding_task(robot: str, **more: Any) -> dict[str, Any]:
    """A task of it, as a mapping."""
    base = {"position": [0, 0, 0]}
    return {
        "robot": robot,
        "controller": {"nodes": 8, "horizon": 1.5},
        "initial": {"base": base, "arm": [0.1, "7 m"]},
        "skills": {"move": {"space": "joint", "weights": {"arm": [1, 1]}}},
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"arm": ["15 deg", 7.1]},
                "ends_when": {"coordinates": "arm", "tolerance": {"arm": ["2 deg", "0.02 m"]}},
            }
        ],
        **more,
    }
