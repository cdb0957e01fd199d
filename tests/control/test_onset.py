from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import cast

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.onset import DISTINCT, OnsetObserver, closeness

from psmpc_cli.control import Command
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.run import header
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.task import OnsetSpec

QUICK = ("controller.nodes=8", "plant.kind=ideal", "log.plans=false")
ROWS, EDGES = (1, 2), np.array([0.0, 1e-3])
OTHER = 9.0

controls = arrays(float, 3, elements=st.floats(-10, 10))


def steady(u: np.ndarray) -> Plan:
    """A plan that applies the same control throughout."""
    return Plan(np.array([0.0, 4.0]), np.zeros((2, 6)), np.array([u]), np.zeros(0))


@dataclass
class Aside:
    """Answers with given controls: of the window up to the waiting stage, and of that stage alone."""

    without: np.ndarray
    own: np.ndarray
    solved: bool = True
    asked: list[tuple[int, int]] = field(default_factory=list)

    @property
    def controller(self) -> object:
        return SimpleNamespace(stages=(SimpleNamespace(onset_rows=()), SimpleNamespace(onset_rows=ROWS)))

    def plan(self, sequence: MovingSequence, decision: Command, x: np.ndarray) -> tuple[Plan, bool]:
        self.asked.append((sequence.first, sequence.last))
        return (steady(self.without), True) if sequence.first == 0 else (steady(self.own), self.solved)


def observer(aside: Aside, **onset: object) -> OnsetObserver:
    return OnsetObserver(cast(WindowsAside, aside), OnsetSpec.model_validate(onset))


def deciding(u: np.ndarray) -> Command:
    """A decision with one stage waiting, whose plan applies u."""
    sequence = MovingSequence(0, np.array([2.0]), 0.0)
    return cast(Command, SimpleNamespace(sequence=sequence, plan=steady(u), prediction=steady(u), exhausted=False))


@given(controls, controls)
def test_closeness_is_0_without_the_stage_and_1_at_its_own_optimum(without: np.ndarray, own: np.ndarray) -> None:
    assert closeness(without, without, own) == 0
    if np.linalg.norm(without - own) >= DISTINCT:
        assert closeness(own, without, own) == pytest.approx(1)


@given(controls, controls, controls)
def test_closeness_is_at_most_1_and_at_most_what_the_stage_adds(
    applied: np.ndarray, without: np.ndarray, own: np.ndarray
) -> None:
    distance = max(float(np.linalg.norm(without - own)), DISTINCT)
    added = float(np.linalg.norm(applied - without))
    assert closeness(applied, without, own) <= min(1.0, added / distance) + 1e-9


@given(controls, controls, st.floats(0, 1))
def test_closeness_is_the_way_gone(without: np.ndarray, own: np.ndarray, part: float) -> None:
    if np.linalg.norm(without - own) >= DISTINCT:
        assert closeness(without + part * (own - without), without, own) == pytest.approx(part, abs=1e-6)


def test_a_stage_that_wants_what_happens_anyway_is_not_seen() -> None:
    u = np.array([1.0, -2.0, 0.5])
    assert closeness(u, u, u) == 0
    assert abs(closeness(u, u + 1e-9, u - 1e-9)) < 1e-5


def test_presence_is_what_the_stage_adds_in_its_coordinates() -> None:
    aside = Aside(without=np.array([1.0, 1.0, 1.0]), own=np.full(3, OTHER))
    found = observer(aside).observe(deciding(np.array([5.0, 4.0, 5.0])), np.zeros(6), EDGES)
    assert found == {1: pytest.approx(5.0)}
    assert aside.asked == [(0, 0)]


def test_closeness_is_taken_in_the_coordinates_of_the_stage() -> None:
    aside = Aside(without=np.array([OTHER, 0.0, 0.0]), own=np.array([-OTHER, 4.0, 0.0]))
    found = observer(aside, kind="closeness").observe(deciding(np.array([0.0, 1.0, 0.0])), np.zeros(6), EDGES)
    assert found == {1: pytest.approx(0.25)}
    assert aside.asked == [(0, 0), (1, 1)]


def test_closeness_is_not_known_without_the_stage_s_own_optimum() -> None:
    aside = Aside(without=np.zeros(3), own=np.ones(3), solved=False)
    assert observer(aside, kind="closeness").observe(deciding(np.ones(3)), np.zeros(6), EDGES) == {}


def test_a_stage_is_looked_at_until_it_reaches_the_largest_threshold() -> None:
    aside = Aside(without=np.zeros(3), own=np.full(3, 4.0))
    looking = observer(aside, kind="closeness", epsilon=0.5, series=[0.1])
    seen = [looking.observe(deciding(np.full(3, u)), np.zeros(6), EDGES) for u in (0.4, 1.0, 2.0, 1.0)]
    assert seen == [{1: pytest.approx(part)} for part in (0.1, 0.25, 0.5)] + [{}]


def test_the_form_alone_selects_it() -> None:
    assert load_task("transport", ["onset=closeness"]).spec.onset == OnsetSpec(kind="closeness")
    chosen = load_task("transport", ["onset=closeness", "onset.epsilon=0.5"]).spec.onset
    assert chosen == OnsetSpec(kind="closeness", epsilon=0.5)


def test_a_log_says_which_form_it_holds(experiment_of: Callable[..., Experiment], tmp_path) -> None:
    for kind, units in (("control", "m/s^2, rad/s^2"), ("closeness", "1")):
        LogWriter(tmp_path / kind, header(experiment_of(*QUICK, f"onset={kind}"))).close()
        with h5py.File(tmp_path / kind) as log:
            assert log.attrs["onset"] == kind
            assert log["window/presence"].attrs["units"] == log["stages/epsilon"].attrs["units"] == units


def test_the_form_changes_what_is_observed_and_nothing_else(experiment_of: Callable[..., Experiment]) -> None:
    runs = {}
    for kind in ("control", "closeness"):
        samples = closed_loop(experiment_of(*QUICK, f"onset={kind}", "time_limit=10"))
        runs[kind] = [record for record in samples if record.command.time < 9.95]
    pairs = list(zip(runs["control"], runs["closeness"], strict=True))
    assert all(np.array_equal(one.command.x, other.command.x) for one, other in pairs)
    assert any(one.presence for one, _ in pairs)
    assert max(max(other.presence.values(), default=0.0) for _, other in pairs) >= 0.1
    assert all(value <= 1 for _, other in pairs for value in other.presence.values())


def test_an_important_stage_comes_close_to_its_own_optimum_before_its_instant_and_an_unimportant_one_does_not(
    experiment_of: Callable[..., Experiment],
) -> None:
    reached = {}
    for priority in (1e4, 1e-6):
        changes = (*QUICK, "onset={kind: closeness, epsilon: 0.99}", f"stages.capture.priority={priority}")
        early = [r for r in closed_loop(experiment_of(*changes, "time_limit=9")) if r.command.sequence.first == 0]
        reached[priority] = max(record.metrics.presence.get(1, 0.0) for record in early)
    assert reached[1e4] > 0.9
    assert reached[1e-6] < 0.1
