"""The paper's claims on its simulations: what each says, as data. `psmpc_cli.studies.findings` judges them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from psmpc_cli.studies.published import Published, PublishedRun

REAL = "_real"
"""How the symbol of an actual start ends."""

TITLES = {"htmpc": "HTMPC", "smpc": "SMPC", "psmpc": "PSMPC"}
"""The methods as the paper writes them."""

Topic = Literal["setting", "times", "starts", "mission", "order", "weights", "fronts"]

TIMES: Topic = "times"
STARTS: Topic = "starts"


@dataclass(frozen=True)
class Moment:
    """A time of a run: when a stage ends, or when it actually starts.

    Attributes:
        run: The method.
        symbol: As in `load_published`.
        stage: Which stage ends or starts.
        event: Which of both.
    """

    run: str
    symbol: str
    stage: str
    event: Literal["end", "start"]

    def __str__(self) -> str:
        return f"{self.run}.{self.symbol}"


@dataclass(frozen=True)
class Claim:
    """What all claims have.

    Attributes:
        id: Names it for good.
        group: The method it is about, `setting`, `order`, `weights` or `fronts`.
        topic: What about it.
        statement: What it says.
        source: Where the paper says so.
    """

    id: str
    group: str
    topic: Topic
    statement: str
    source: str


@dataclass(frozen=True)
class SettingClaim(Claim):
    """The runs are made as the paper's."""

    name: Literal["horizon", "nodes"]
    published: float


@dataclass(frozen=True)
class TimeClaim(Claim):
    """Something happens at a published time [s]; `before` are the published times that lead up to it."""

    moment: Moment
    published: float
    before: tuple[tuple[Moment, float], ...] = ()


@dataclass(frozen=True)
class StartClaim(Claim):
    """A stage starts when the one before it ends, or as soon as that end comes into the horizon."""

    start: Moment
    end: Moment
    when: Literal["on time", "once seen"]


@dataclass(frozen=True)
class FloorClaim(Claim):
    """No stage starts before the end of the one before it comes into the horizon."""

    pairs: tuple[tuple[Moment, Moment], ...]


@dataclass(frozen=True)
class EarlyClaim(Claim):
    """These stages start before the one before them has ended."""

    starts: tuple[Moment, ...]


@dataclass(frozen=True)
class OrderClaim(Claim):
    """These times come one after another; the published ones [s] where there are any."""

    moments: tuple[Moment, ...]
    published: tuple[float, ...]


@dataclass(frozen=True)
class MissionClaim(Claim):
    """The mission succeeds, or fails."""

    run: str
    succeeds: bool


@dataclass(frozen=True)
class ReleaseClaim(Claim):
    """The mission fails because the last stage starts early and lets go of the object before its destination."""

    start: Moment
    end: Moment


def published_claims(published: Published) -> tuple[Claim, ...]:
    """Return every claim the published data make, grouped."""
    return (
        *_settings(published),
        *(claim for run in published.runs for claim in _of_run(published, run)),
        *(_order(published, symbols) for symbols in published.orders),
    )


def moment_of(published: Published, name: str) -> Moment:
    """Return the moment that `run.symbol` names."""
    run, symbol = name.split(".")
    if not symbol.endswith(REAL):
        return Moment(run, symbol, published.stages[symbol], "end")
    symbols = list(published.stages)
    following = symbols[symbols.index(symbol.removesuffix(REAL)) + 1]
    return Moment(run, symbol, published.stages[following], "start")


def _settings(published: Published) -> Iterator[Claim]:
    words = {"horizon": "the prediction horizon T_h is {:g} s", "nodes": "each stage has N_s = {:g} intervals"}
    for name, value in published.setting.items():
        yield SettingClaim(
            f"setting.{name}", "setting", "setting", words[name].format(value), "section IV", name, value
        )


def _of_run(published: Published, run: str) -> Iterator[Claim]:
    about = published.runs[run]
    yield from _times(published, run, about)
    yield from _starts(published, run, about)
    succeeds = about.mission == "succeeds"
    yield MissionClaim(f"{run}.mission", run, "mission", f"the mission {about.mission}", "section IV-C", run, succeeds)
    if about.released_early:
        *_, (end, start) = _handovers(published, run)
        words = f"it fails because {start.stage} starts early and lets go of the object before its destination"
        yield ReleaseClaim(f"{run}.released_early", run, "mission", words, "section IV-C", start, end)


def _times(published: Published, run: str, about: PublishedRun) -> Iterator[Claim]:
    known: list[tuple[Moment, float]] = []
    for symbol, value in about.times.items():
        moment = moment_of(published, f"{run}.{symbol}")
        what, topic = ("actually starts", STARTS) if moment.event == "start" else ("ends", TIMES)
        words = f"{moment.stage} {what} at {symbol} = {value:g} s"
        yield TimeClaim(str(moment), run, topic, words, "section IV-C", moment, value, tuple(known))
        known += [(moment, value)] if moment.event == "end" else []


def _starts(published: Published, run: str, about: PublishedRun) -> Iterator[Claim]:
    end_of = {start.symbol: end for end, start in _handovers(published, run)}
    for symbol in about.starts_once_seen:
        start, end = moment_of(published, f"{run}.{symbol}"), end_of[symbol]
        words = f"{start.stage} starts as early as can be: {symbol} = {end.symbol} - T_h"
        yield StartClaim(f"{run}.{symbol}.once_seen", run, STARTS, words, "section IV-B", start, end, "once seen")
    for symbol in about.starts_on_time:
        start, end = moment_of(published, f"{run}.{symbol}"), end_of[symbol]
        words = f"{start.stage} does not start early: {symbol} = {end.symbol}"
        yield StartClaim(f"{run}.{symbol}.on_time", run, STARTS, words, "section IV-C", start, end, "on time")
    if about.starts_early:
        starts = tuple(moment_of(published, f"{run}.{symbol}") for symbol in about.starts_early)
        words = "every stage starts before the one before it has ended"
        yield EarlyClaim(f"{run}.starts_early", run, STARTS, words, "section IV-C", starts)
    if about.starts_early or about.starts_once_seen:
        words = "no stage starts before the end of the one before it comes into the horizon: t_s_real >= t_s - T_h"
        pairs = tuple((start, end) for end, start in _handovers(published, run))
        yield FloorClaim(f"{run}.floor", run, STARTS, words, "section IV-B", pairs)


def _handovers(published: Published, run: str) -> Iterator[tuple[Moment, Moment]]:
    """Give the end of every stage but the last, with the start of the stage after it."""
    for symbol in list(published.stages)[:-1]:
        yield moment_of(published, f"{run}.{symbol}"), moment_of(published, f"{run}.{symbol}{REAL}")


def _order(published: Published, names: tuple[str, ...]) -> Claim:
    moments = tuple(moment_of(published, name) for name in names)
    times = tuple(published.runs[moment.run].times[moment.symbol] for moment in moments)
    words = " < ".join(f"{moment.symbol} of {TITLES[moment.run]}" for moment in moments)
    return OrderClaim(f"order.{moments[0].symbol}", "order", "order", words, "section IV-C", moments, times)
