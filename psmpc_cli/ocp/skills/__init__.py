"""The skill kinds by their name in a task file."""

from psmpc_cli.ocp.skills import joint, task
from psmpc_cli.ocp.skills.base import Skill

SKILLS: dict[str, Skill] = {skill.space: skill for skill in (joint.SKILL, task.SKILL)}
