"""The paper's claims on its simulations as data, what became of each of them, and a claim as a row of text."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict

Event = Literal["end", "start"]
Value = float | str | tuple[float, ...] | tuple[str, ...]

REAL = "_real"
"""Suffix of the symbol of an actual start."""

HEADINGS = ("claim", "published", "reproduced", "difference", "tolerance", "holds")


class Claim(BaseModel):
    """What the paper says.

    Attributes:
        id: Its name, which stays; the part before the first dot names its group, such as psmpc or order.
        topic: What a claim on one method is about.
        statement: What it says.
        source: Where the paper says so.
        rule: How it is judged, one of `psmpc_cli.studies.judge.RULES`.
        reads: The quantities that the rule looks at.
        published: Their published value.
        ratio: The ratio of two weights that the claim is about.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    topic: Literal["times", "starts", "mission"] | None = None
    statement: str
    source: str
    rule: str
    reads: tuple[str, ...]
    published: float | str | tuple[float, ...] | tuple[str, ...]
    ratio: float = 1.0

    @property
    def group(self) -> str:
        """The method it is about, `setting`, `order`, `weights` or `fronts`."""
        return self.id.partition(".")[0]


class Claims(BaseModel):
    """All claims.

    Attributes:
        stages: The stage that each published time ends, by symbol.
        claims: In the order of the table.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stages: Mapping[str, str]
    claims: tuple[Claim, ...]

    def event(self, symbol: str) -> tuple[str, Event]:
        """Return which stage ends or actually starts at the time of a symbol such as t1 or t1_real."""
        if not symbol.endswith(REAL):
            return self.stages[symbol], "end"
        symbols = list(self.stages)
        return self.stages[symbols[symbols.index(symbol.removesuffix(REAL)) + 1]], "start"

    def published(self, method: str, event: Event) -> dict[str, float]:
        """Return the published ends, or actual starts, of a method's stages [s]."""
        found: dict[str, float] = {}
        for claim in self.claims:
            if claim.rule == "time" and claim.group == method and isinstance(claim.published, float):
                stage, of = self.event(claim.reads[0].partition(".")[2])
                found |= {stage: claim.published} if of == event else {}
        return found


@cache
def load_claims() -> Claims:
    """Return the claims that ship with the package."""
    text = files("psmpc_cli.studies").joinpath("claims.yaml").read_text(encoding="utf-8")
    return Claims.model_validate(yaml.safe_load(text))


@dataclass(frozen=True)
class Finding:
    """What became of a claim.

    Attributes:
        claim: The claim.
        reproduced: What was measured, in the unit of what is published; NaN where it never happened.
        holds: Whether the claim holds.
        unit: `s`, or empty.
        difference: Reproduced less published; NaN where there is none.
        tolerance: Largest difference at which the claim holds; 0 where it holds exactly or not at all.
        earlier: It holds although the difference is larger: earlier than published, and the mission succeeded.
        cause: Why it does not hold, or is earlier, point by point; empty otherwise.
    """

    claim: Claim
    reproduced: Value
    holds: bool
    unit: str = ""
    difference: float = math.nan
    tolerance: float = 0.0
    earlier: bool = False
    cause: tuple[str, ...] = ()

    @property
    def row(self) -> dict[str, str]:
        """The finding as text, by heading."""
        verdict = "yes, earlier" if self.earlier else "yes" if self.holds else "no"
        difference = f"{self.difference:+.2f} {self.unit}" if self.unit else f"{self.difference:+g}"
        texts = (
            self.claim.id,
            shown(self.claim.published, self.unit),
            shown(self.reproduced, self.unit),
            difference if math.isfinite(self.difference) else "-",
            f"{self.tolerance:.2f} {self.unit}" if self.tolerance > 0 else "exact",
            verdict,
        )
        return dict(zip(HEADINGS, texts, strict=True))


def shown(value: Value, unit: str) -> str:
    """Return a published or reproduced value as text; times in a row with the relation between neighbours."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        number = f"{value:.2f}".removesuffix("0") if unit else f"{value:g}"
        return f"{number} {unit}".rstrip() if math.isfinite(value) else "never"
    texts = [entry for entry in value if isinstance(entry, str)]
    times = [entry for entry in value if isinstance(entry, float)]
    return _related(times, unit) if times else ", ".join(texts) or "none"


def _related(times: Sequence[float], unit: str) -> str:
    relations = ("<" if one < other else ">=" for one, other in pairwise(times))
    rest = (f" {relation} {shown(time, unit)}" for relation, time in zip(relations, times[1:], strict=True))
    return shown(times[0], unit) + "".join(rest)
