"""The paper's claims and our own, as data, and what became of one of them."""

import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, TypeAdapter

Value = float | str | tuple[float, ...] | tuple[str, ...]

HEADINGS = ("claim", "published", "reproduced", "difference", "tolerance", "searched", "holds")

APART: Mapping[str, str] = {
    "input": "Inputs of the runs, not counted: they say what was set, not what came out",
    "definition": (
        "From definitions, not counted: a stage has no control, and no share in it, before it is in the window; such a "
        "claim only fails where the end of the stage before moves after the plan that admitted it"
    ),
    "ours": "Our own, not counted: what the paper says, tested in another way",
}
"""Why claims stand apart from the published ones that can fail, by kind."""


class Claim(BaseModel):
    """What the paper says.

    Attributes:
        id: Its name, which stays; the part before the first dot names its group, such as psmpc or order.
        topic: What a claim on one method is about.
        statement: What it says.
        source: Where the paper says so.
        rule: How it is judged, one of `psmpc_cli.paper.missions.MISSION_RULES` or `psmpc_cli.paper.judge.RULES`.
        reads: The quantities that the rule looks at.
        published: Their published value.
        unit: Of what is published and reproduced.
        ratio: The ratio of two weights that the claim is about.
        apart: Why it is not counted among the published claims, one of `APART`; None for one that is.
        searched: In how many of the searched settings it holds, and their number, by `benchmarks/calibration.py held`;
            None where their runs do not tell.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    topic: Literal["times", "starts", "mission"] | None = None
    statement: str
    source: str
    rule: str
    reads: tuple[str, ...]
    published: float | str | tuple[float, ...] | tuple[str, ...]
    unit: Literal["s", ""] = "s"
    ratio: float = 1.0
    apart: Literal["input", "definition", "ours"] | None = None
    searched: tuple[int, int] | None = None

    @property
    def group(self) -> str:
        """The method it is about, `setting`, `order`, `weights`, `fronts` or `grasp`."""
        return self.id.partition(".")[0]

    @property
    def number(self) -> float:
        """The published number; NaN if something else is published."""
        return self.published if isinstance(self.published, float) else math.nan


@cache
def load_claims() -> tuple[Claim, ...]:
    """Return the claims that ship with the package, in the order of the table."""
    text = files("psmpc_cli.paper").joinpath("claims.yaml").read_text(encoding="utf-8")
    return TypeAdapter(tuple[Claim, ...]).validate_python(yaml.safe_load(text))


class Finding(NamedTuple):
    """What became of a claim.

    Attributes:
        claim: The claim.
        reproduced: What was measured, in the unit of what is published; NaN where it never happened.
        holds: Whether the claim holds.
        difference: Reproduced less published; NaN where there is none.
        tolerance: Largest difference at which the claim holds; 0 where it holds exactly or not at all.
        earlier: It holds although the difference is larger: earlier than published, and the mission succeeded.
        cause: Why it does not hold, or is earlier, point by point; empty otherwise.
    """

    claim: Claim
    reproduced: Value
    holds: bool
    difference: float = math.nan
    tolerance: float = 0.0
    earlier: bool = False
    cause: tuple[str, ...] = ()

    @property
    def row(self) -> tuple[str, ...]:
        """The finding as text, in the order of `HEADINGS`."""
        unit = self.claim.unit
        searched = self.claim.searched
        difference = f"{self.difference:+.2f} {unit}" if unit else f"{self.difference:+g}"
        return (
            self.claim.id,
            format_value(self.claim.published, unit),
            format_value(self.reproduced, unit),
            difference if math.isfinite(self.difference) else "-",
            f"{self.tolerance:.2f} {unit}" if self.tolerance > 0 else "exact",
            "-" if searched is None else f"{searched[0]} of {searched[1]}",
            "yes, earlier" if self.earlier else "yes" if self.holds else "no",
        )


def format_value(value: Value, unit: str) -> str:
    """Write a published or reproduced value; times in a row with the relation between neighbours."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        number = f"{value:.2f}".removesuffix("0") if unit else f"{value:g}"
        return f"{number} {unit}".rstrip() if math.isfinite(value) else "never"
    texts = [format_value(entry, unit) for entry in value]
    times = [entry for entry in value if isinstance(entry, float)]
    for i, (one, other) in enumerate(pairwise(times), start=1):
        texts[i] = f"{'<' if one < other else '>='} {texts[i]}"
    return (" " if times else ", ").join(texts) or "none"
