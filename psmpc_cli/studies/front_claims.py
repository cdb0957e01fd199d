"""The paper's claims on the Pareto fronts of two stages, as data. `psmpc_cli.studies.front_findings` judges them."""

from dataclasses import dataclass

from psmpc_cli.studies.claims import Claim, Topic
from psmpc_cli.studies.published import Published

FRONTS: Topic = "fronts"


@dataclass(frozen=True)
class FrontClaim(Claim):
    """Something moves in a direction."""

    direction: str


@dataclass(frozen=True)
class AlongClaim(FrontClaim):
    """The larger omega_2 / omega_1, the further the optimum lies that way on a front."""


@dataclass(frozen=True)
class OnwardClaim(FrontClaim):
    """The front moves that way from sample to sample."""


def fronts_claims(published: Published) -> tuple[FrontClaim, ...]:
    """Return what the published data claim on the fronts of Approach and Capture, J_2 to the right and J_1 up."""
    about, source = published.fronts, "section IV-B, Fig. 7"
    along = f"at one sampling instant, as omega_2/omega_1 grows, the optimum moves to the {about.with_ratio}"
    onward = f"as sampling time passes, the whole front moves to the {about.with_time}"
    return (
        AlongClaim("fronts.with_ratio", FRONTS, FRONTS, along, source, about.with_ratio),
        OnwardClaim("fronts.with_time", FRONTS, FRONTS, onward, source, about.with_time),
    )
