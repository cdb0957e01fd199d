"""What the paper publishes of its simulations, as data."""

from collections.abc import Mapping
from importlib.resources import files
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PublishedRun(_Frozen):
    """What is published of one method.

    Attributes:
        times: By symbol [s]: `t1` ends the first stage, `t1_real` is when the second one actually starts.
        mission: How it ends.
        released_early: The mission fails because the object is let go before its destination.
        starts_early: Starts that come before the stage before them has ended.
        starts_once_seen: Starts that come a horizon before it has ended, as early as can be.
        starts_on_time: Starts that come when it has ended.
    """

    times: Mapping[str, float]
    mission: Literal["succeeds", "fails"]
    released_early: bool = False
    starts_early: tuple[str, ...] = ()
    starts_once_seen: tuple[str, ...] = ()
    starts_on_time: tuple[str, ...] = ()


class PublishedWeights(_Frozen):
    """What is published of the actual start over the ratio of two stages' weights.

    Attributes:
        settles: Where it stabilizes at large ratios [s].
        chosen: The ratio that is recommended.
    """

    settles: float
    chosen: float


class PublishedFronts(_Frozen):
    """What is published of the Pareto fronts of two stages' costs, J_2 to the right and J_1 up.

    Attributes:
        with_ratio: Where the optimum moves as the ratio of the weights grows.
        with_time: Where the front moves as sampling time passes.
    """

    with_ratio: Literal["upper left"]
    with_time: Literal["upper left"]


class Published(_Frozen):
    """What is published.

    Attributes:
        setting: Horizon [s] and intervals a stage.
        stages: The stage that each time ends, by symbol.
        runs: By method.
        orders: Times (method.symbol) that come one after another.
        weights: On the weights of the first two stages.
        fronts: On the Pareto fronts of their costs.
    """

    setting: Mapping[Literal["horizon", "nodes"], float]
    stages: Mapping[str, str]
    runs: Mapping[str, PublishedRun]
    orders: tuple[tuple[str, ...], ...]
    weights: PublishedWeights
    fronts: PublishedFronts


def load_published() -> Published:
    """Return the published results that ship with the package."""
    text = files("psmpc_cli.studies").joinpath("published.yaml").read_text(encoding="utf-8")
    return Published.model_validate(yaml.safe_load(text))
