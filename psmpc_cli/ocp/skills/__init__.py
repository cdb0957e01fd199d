"""What a skill is, and the skills by their name in a task file; a new one is one more file here and one line below."""

from psmpc_cli.ocp.skills import joint, point, task
from psmpc_cli.ocp.skills.base import Posture, Skill

__all__ = ["SKILLS", "Posture", "Skill"]

SKILLS: dict[str, Skill] = {skill.space: skill for skill in (joint.SKILL, task.SKILL, point.SKILL)}
