"""The skills by their name in a task file (`space:`); a new one is one more file here and one line of the table."""

from psmpc_cli.ocp.skills import joint, point, task
from psmpc_cli.ocp.skills.base import Posture, Skill

__all__ = ["SKILLS", "Posture", "Skill"]

SKILLS: dict[str, Skill] = {
    "joint": joint.SKILL,
    "task": task.SKILL,
    "point": point.SKILL,
}
