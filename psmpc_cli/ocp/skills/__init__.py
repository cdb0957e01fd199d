"""The skills by their name in a task file (`space:`), which is also the name of their file here."""

from pkgutil import resolve_name

from psmpc_cli.ocp.skills.base import Posture, Skill
from psmpc_cli.specs.parts import SPACES

__all__ = ["SKILLS", "Posture", "Skill"]

SKILLS: dict[str, Skill] = {space: resolve_name(f"{__name__}.{space}:SKILL") for space in SPACES}
