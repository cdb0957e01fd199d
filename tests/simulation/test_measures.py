"""What counterfactual solves measure: the presence of a stage in the control, and the shares of the stages."""

from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.measures import DISTINCT, closeness, nearest_combination
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import Experiment, build_experiment, closed_loop, simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.task import OnsetSpec

from ..control.short_transports import QUICK, SHORT
from ..short_runs import CUT, there_and_back

Build = Callable[..., Experiment]

controls = arrays(float, 3, elements=st.floats(-10, 10))
several = st.integers(2, 4).flatmap(lambda S: arrays(float, (S, 9), elements=st.floats(-5, 5)))


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


def test_the_form_alone_selects_it() -> None:
    assert load_task("transport", ["onset={kind: closeness}"]).spec.onset == OnsetSpec(kind="closeness")
    chosen = load_task("transport", ["onset={kind: closeness}", "onset.epsilon=0.5"]).spec.onset
    assert chosen == OnsetSpec(kind="closeness", epsilon=0.5)


def test_a_log_says_which_form_it_holds(experiment_of: Build, tmp_path) -> None:
    for kind, units in (("control", "m/s^2, rad/s^2"), ("closeness", "1")):
        LogWriter(tmp_path / kind, header(experiment_of(*QUICK, f"onset={{kind: {kind}}}"))).close()
        with h5py.File(tmp_path / kind) as log:
            assert log.attrs["onset"] == kind
            assert log["window/presence"].attrs["units"] == log["stages/epsilon"].attrs["units"] == units


@pytest.fixture(scope="module")
def observed(experiment_of: Build) -> dict[str, list[Sample]]:
    """Runs over four stages, with presence in both forms, and shares in the first."""
    forms = {
        "control": ("onset={kind: control}", "log.shares=true"),
        "closeness": ("onset={kind: closeness, epsilon: 0.99}",),
    }
    return {kind: list(closed_loop(experiment_of(*SHORT, *changes))) for kind, changes in forms.items()}


def test_measuring_changes_nothing(observed: dict[str, list[Sample]]) -> None:
    for one, other in zip(observed["control"], observed["closeness"], strict=True):
        np.testing.assert_array_equal(one.command.u, other.command.u)


@pytest.fixture(scope="module")
def disturbed(transport: Task) -> Task:
    """A short run with a payload, noise and a log of everything."""
    changes = ("uncertainty={noise: {position: 1e-3}, payload: {mass: 5, inertia: 1}}", "log.ticks=true")
    return load_task("transport", (*SHORT, "plant={kind: rk4, low_level_rate: 100}", *changes, "time_limit=1.5"))


@pytest.fixture(scope="module")
def unread(disturbed: Task) -> dict[str, np.ndarray]:
    """The datasets of its log where nobody reads any metrics while it runs."""
    return datasets(simulate(disturbed))


def datasets(run: Run) -> dict[str, np.ndarray]:
    return {path: values for path, values in run.arrays.items() if path != "solver/wall_time"}


@pytest.mark.parametrize("read", ["at once", "late", "backwards", "some"])
def test_metrics_read_in_any_order_or_never_give_the_same_log(
    disturbed: Task, unread: dict[str, np.ndarray], read: str
) -> None:
    samples = list[Sample]()

    def watch(sample: Sample) -> None:
        samples.append(sample)
        orders = {
            "at once": samples[-1:],
            "late": samples[-4:-3],
            "backwards": samples[::-1] if len(samples) % 7 == 0 else [],
            "some": samples[::5],
        }
        for each in orders[read]:
            assert each.metrics["control/u"].shape == each.command.u[0].shape

    np.testing.assert_equal(datasets(simulate(disturbed, watch=watch)), unread)


def test_reading_a_sample_measures_no_other(disturbed: Task) -> None:
    samples = list(closed_loop(build_experiment(disturbed)))
    expected = [dict(sample.metrics) for sample in closed_loop(build_experiment(disturbed))]
    for number in (5, 2, 9):
        np.testing.assert_equal(dict(samples[number].metrics), expected[number])
    assert [sample.number for sample in samples if sample.measured] == [2, 5, 9]


def test_presence_is_measured_of_waiting_stages_until_they_reach_the_largest_threshold(
    observed: dict[str, list[Sample]],
) -> None:
    reached: set[int] = set()
    for sample in observed["control"]:
        sequence, presence = sample.command.sequence, sample.metrics["window/presence"]
        assert set(presence) == set(range(sequence.first + 1, sequence.last + 1)) - reached
        assert all(value >= 0 for value in presence.values())
        reached |= {stage for stage, value in presence.items() if value >= 0.1}
    assert reached


def test_closeness_is_at_most_1_in_a_run(observed: dict[str, list[Sample]]) -> None:
    found = [value for sample in observed["closeness"] for value in sample.metrics["window/presence"].values()]
    assert found
    assert max(found) <= 1


@pytest.mark.slow
def test_an_important_stage_comes_close_to_its_own_optimum_before_its_switch_time(experiment_of: Build) -> None:
    reached = {}
    for priority in (1e4, 1e-6):
        changes = (*QUICK, "onset={kind: closeness, epsilon: 0.99}", f"stages.capture.priority={priority}")
        early = [s for s in closed_loop(experiment_of(*changes, "time_limit=9")) if s.command.stage.index == 0]
        reached[priority] = max(sample.metrics["window/presence"].get(1, 0.0) for sample in early)
    assert reached[1e4] > 0.9
    assert reached[1e-6] < 0.1


@given(several, st.data())
def test_weights_are_those_of_a_convex_combination(u: np.ndarray, data: st.DataObject) -> None:
    weights = nearest_combination(u, data.draw(arrays(float, 9, elements=st.floats(-5, 5))))
    assert weights.min() >= 0
    assert weights.sum() == pytest.approx(1)


@given(several, st.data())
def test_a_combination_is_recognized(u: np.ndarray, data: st.DataObject) -> None:
    raw = data.draw(arrays(float, len(u), elements=st.floats(0.05, 1)))
    applied = raw / raw.sum() @ u
    np.testing.assert_allclose(nearest_combination(u, applied) @ u, applied, atol=1e-6)


def nearest_by_search(u: np.ndarray, applied: np.ndarray) -> float:
    """Return the distance of the nearest convex combination: the best of the affine ones of every subset inside it."""
    distances = []
    for count in range(1, len(u) + 1):
        for kept in map(list, combinations(range(len(u)), count)):
            base, rest = u[kept[0]], u[kept[1:]]
            weights = np.linalg.lstsq((rest - base).T, applied - base, rcond=None)[0] if count > 1 else np.zeros(0)
            weights = np.r_[1 - weights.sum(), weights]
            if weights.min() >= -1e-12:
                distances.append(float(np.linalg.norm(weights @ u[kept] - applied)))
    return min(distances)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=40)
def test_no_combination_of_correlated_controls_is_nearer(seed: int) -> None:
    """Controls that differ along few directions, where dropping negative weights one by one goes wrong."""
    random = np.random.default_rng(seed)
    u = random.normal(size=(4, 2)) @ random.normal(size=(2, 9)) + 1e-2 * random.normal(size=(4, 9))
    applied = random.normal(size=9)
    found = float(np.linalg.norm(nearest_combination(u, applied) @ u - applied))
    assert found == pytest.approx(nearest_by_search(u, applied), abs=1e-9)


def test_the_stage_before_gives_its_share_to_the_next(observed: dict[str, list[Sample]]) -> None:
    samples = observed["control"]
    alone = [sample for sample in samples if len(sample.command.switch_times) == 0]
    shared = [sample for sample in samples if len(sample.command.switch_times) > 0 and sample.metrics["window/share"]]
    assert all(sample.metrics["window/share"] == {sample.command.stage.index: 1.0} for sample in alone)
    assert all(sum(sample.metrics["window/share"].values()) == pytest.approx(1) for sample in shared)
    assert any(0.05 < sample.metrics["window/share"][sample.command.stage.index] < 0.95 for sample in shared)
    late = [s for s in shared if s.command.stage.index == 0 and s.command.switch_times[0] - s.command.time < 0.1]
    assert all(sample.metrics["window/share"][1] > 0.5 for sample in late)  # capture, with its priority of 100


def test_shares_can_be_left_out(experiment_of: Build) -> None:
    assert next(closed_loop(experiment_of(*SHORT, "log.shares=false"))).metrics["window/share"] == {}


def test_effort_is_of_the_mean_control_of_a_sample_and_peaks_are_of_its_ticks(tmp_path: Path) -> None:
    """On the ideal plant the integral of the commanded accelerations is the change of velocity."""
    log = there_and_back(tmp_path, "log.ticks=true", "log.shares=false")
    v = np.vstack([log["state/Qdot"], log["final/Qdot"]])
    sample_time = 0.1
    efforts = sample_time * np.sum((np.diff(v, axis=0) / sample_time) ** 2, axis=1)
    assert log["effort/control"] == pytest.approx(efforts, abs=1e-9)
    assert (log["effort/squared_acceleration"] >= log["effort/control"] - 1e-12).all()
    assert log["effort/squared_acceleration"].sum() > 1.001 * log["effort/control"].sum()
    F = log.ticks["F"].reshape(len(log.time), -1, v.shape[1])
    assert log["peak/base_force"] == pytest.approx(np.linalg.norm(F[:, :, :2], axis=2).max(axis=1))
    assert log["peak/base_torque"] == pytest.approx(np.abs(F[:, :, 2]).max(axis=1))
    assert log["peak/joint_torque"] == pytest.approx(np.abs(F[:, :, 3:]).max(axis=(1, 2)))
    assert log.summary().peaks["joint_torque"] == log["peak/joint_torque"].max()


@pytest.mark.slow
def test_forces_are_measured_against_the_limits_at_which_they_are_cut(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, *CUT, name="cut")
    shape = (len(log.time), -1, len(log.coordinates))
    F = log.ticks["F"].reshape(shape)
    commanded = log.ticks["commanded"].reshape(shape)
    is_cut = np.any(np.abs(commanded - F) > 1e-5, axis=2)
    np.testing.assert_array_equal(log["force/saturated"], is_cut.mean(axis=1))
    assert 0.0 in log["force/saturated"] and 1.0 in log["force/saturated"]
    turned = log.ticks["Q"].reshape(shape)[:, :, 2]
    applied_along_x, along_x = (np.cos(turned) * f[:, :, 0] + np.sin(turned) * f[:, :, 1] for f in (F, commanded))
    assert np.abs(applied_along_x).max() == pytest.approx(0.8 * 6.0)
    assert log["force/utilization"][:, 0] == pytest.approx(np.abs(along_x).max(axis=1) / (0.8 * 6.0))
    assert log["force/utilization"][:, 2] == pytest.approx(np.abs(commanded[:, :, 2]).max(axis=1))
    assert np.isnan(log["force/utilization"][:, 3:]).all()


def test_logs_of_tasks_without_limits_of_forces_say_nothing_of_them(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "log.ticks=true", "log.shares=false")
    assert not any("commanded" in path or "utilization" in path or "saturated" in path for path in log.arrays)


def test_the_force_of_the_base_is_logged_along_its_own_axes_too(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "log.shares=false", "plant.kind=rk4", "initial.base=[0, 0, 90 deg]")
    F = log["force/F"]
    own = log["force/own_axes"]
    angle = log["state/Q"][:, 2]
    np.testing.assert_allclose(own[:, 0], np.cos(angle) * F[:, 0] + np.sin(angle) * F[:, 1], atol=1e-9)
    np.testing.assert_allclose(own[:, 1], np.cos(angle) * F[:, 1] - np.sin(angle) * F[:, 0], atol=1e-9)
    np.testing.assert_array_equal(own[:, 2:], F[:, 2:])
    assert np.abs(own - F).max() > 0.1
