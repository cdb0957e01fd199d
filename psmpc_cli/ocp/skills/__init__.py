"""The skills: how each part of a target is wanted, by names that are also those of the files here."""

from functools import cache
from pkgutil import resolve_name

from psmpc_cli.ocp.skills.base import PartKind, Posture, Skill, TargetPart
from psmpc_cli.ocp.skills.task import BasePose
from psmpc_cli.specs.parts import BASE, SKILL_KINDS, Space

__all__ = ["PartKind", "Posture", "Skill", "TargetPart", "skill_in"]

KINDS: dict[str, PartKind] = {name: resolve_name(f"{__name__}.{name}:KIND") for name in SKILL_KINDS}
KINDS[BASE] = BasePose()
"""How parts may be wanted; every target begins with the pose of the base."""


@cache
def skill_in(space: Space) -> Skill:
    """Return the skill whose parts are wanted in a space."""
    return Skill(space, KINDS)
