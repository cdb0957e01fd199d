"""The paper's claims on the weights of two stages, as data. `psmpc_cli.studies.sweep_findings` judges them."""

from dataclasses import dataclass

from psmpc_cli.studies.claims import Claim, Topic
from psmpc_cli.studies.published import Published

WEIGHTS: Topic = "weights"


@dataclass(frozen=True)
class TrendClaim(Claim):
    """The larger omega_2 / omega_1, the earlier the actual start of the second stage, from t_s on."""


@dataclass(frozen=True)
class WeightsFloorClaim(Claim):
    """However large the ratio, the second stage starts no earlier than t_s - T_h."""


@dataclass(frozen=True)
class SettlesClaim(Claim):
    """At large ratios the actual start stabilizes at a published time [s]."""

    published: float


@dataclass(frozen=True)
class ChosenClaim(Claim):
    """The published ratio is more efficient than equal weights, and spares the control what larger ones ask of it."""

    ratio: float


def weights_claims(published: Published) -> tuple[Claim, ...]:
    """Return what the published data claim on the weights of Approach and Capture."""
    about, source = published.weights, "section IV-B, Fig. 6"
    trend = "as omega_2/omega_1 grows, the actual start of capture advances from the switching instant t_s"
    floor = "whatever the weights, capture does not start before t_s - T_h"
    settles = f"as omega_2/omega_1 grows, the actual start of capture stabilizes around {about.settles:g} s"
    chosen = (
        f"omega_2/omega_1 = {about.chosen:g} works more efficiently than equal weights, and avoids the decline in "
        "control performance of excessively large ones"
    )
    return (
        TrendClaim("weights.trend", WEIGHTS, WEIGHTS, trend, source),
        WeightsFloorClaim("weights.floor", WEIGHTS, WEIGHTS, floor, source),
        SettlesClaim("weights.settles", WEIGHTS, WEIGHTS, settles, source, about.settles),
        ChosenClaim("weights.chosen", WEIGHTS, WEIGHTS, chosen, "section IV-B", about.chosen),
    )
