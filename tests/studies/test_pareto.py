from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.studies.fronts import STATUS, costs_of, dominated, extents, methods_in, read_pareto
from psmpc_cli.studies.pareto import HIGHEST, LOWEST, Question, choose_samples, is_log, parse_times, solve_pareto

from ..there_and_back import TASK
from .there_and_back_run import run_there_and_back

pytestmark = pytest.mark.slow

POINTS = 6


def question(**changes: object) -> Question:
    asked: dict[str, object] = {"stages": "1,2", "at": (), "points": POINTS, "method": "both", "free": False}
    return Question(**(asked | changes))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_there_and_back(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def log(run: Path) -> Run:
    return read_run(run)


@pytest.fixture(scope="module")
def studied(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("held") / "pareto.h5"
    solve_pareto(run, question(at=(0.2, 0.5)), path, 1)
    return read_pareto(path)


@pytest.fixture(scope="module")
def in_space(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("free") / "pareto.h5"
    solve_pareto(run, question(at=(0.3,), method="weighted-sum", free=True), path, 1)
    return read_pareto(path)


def test_every_point_is_solved_for(studied: Results, in_space: Results) -> None:
    assert methods_in(studied) == ("weighted", "constrained")
    assert methods_in(in_space) == ("weighted",)
    for results, names in ((studied, ("weighted", "constrained")), (in_space, ("weighted", "free"))):
        for name in names:
            assert np.all(results[f"{name}_status"] == STATUS.index("optimal"))
            assert np.isfinite(results[f"{name}_J_1"]).all()


def test_coordinates_are_named(studied: Results, in_space: Results) -> None:
    np.testing.assert_allclose(studied["instant"], [0.2, 0.5])
    np.testing.assert_allclose(studied["ratio"], np.geomspace(LOWEST, HIGHEST, POINTS))
    assert studied["stage"].tolist() == ["go", "back"]
    assert studied.quantities["weighted_J_1"].dims == ("instant", "ratio")
    assert studied.quantities["constrained_J_1"].dims == ("instant", "bound")
    assert in_space.quantities["weighted_J_1"].dims == ("instant", "later", "ratio")
    assert in_space["criterion"].tolist() == ["J_1", "J_2", "t_s - T0"]


def test_the_file_says_what_ran(studied: Results, log: Run) -> None:
    for name in ("task_yaml", "robot_yaml", "digest", "task_name", "horizon"):
        assert studied.attributes[name] == log.attributes[name]
    assert studied.attributes["kind"] == "pareto"
    assert studied.attributes["stages"] == "1,2"


def test_the_chosen_point_is_the_run_s(studied: Results, log: Run) -> None:
    for i, instant in enumerate(studied["instant"]):
        sample = int(np.argmin(np.abs(log.time - instant)))
        chosen = [studied["chosen_J_1"][i], studied["chosen_J_2"][i]]
        np.testing.assert_allclose(chosen, log["window/cost"][sample, :2], rtol=1e-6)
        assert studied["t_s"][i] == pytest.approx(log["window/instants"][sample, 0])
        np.testing.assert_allclose(studied["scale"][i], log["normalization/nadir"][sample, :2])


def test_the_front_falls_and_the_run_s_point_lies_on_it(studied: Results) -> None:
    for i, J in enumerate(costs_of(studied, "weighted")):
        least = 1e-6 * extents(J)
        assert np.all(np.diff(J[:, 0]) >= -least[0])
        assert np.all(np.diff(J[:, 1]) <= least[1])
        chosen = np.array([[studied["chosen_J_1"][i], studied["chosen_J_2"][i]]])
        assert not dominated(np.vstack([J, chosen]))[-1]


def test_both_methods_agree_on_a_convex_front(studied: Results) -> None:
    assert np.abs(studied["constrained_off_weighted"]).max() < 1e-5
    assert not studied["weighted_dominated"].any()
    assert not studied["constrained_dominated"].any()


def test_bounds_are_kept_to_and_reach_from_one_end_of_the_front_to_the_other(studied: Results) -> None:
    limit, second = studied["constrained_limit"], studied["constrained_J_2"]
    assert np.all(second <= limit * (1 + 1e-6))
    np.testing.assert_allclose(limit[:, [0, -1]], studied["weighted_J_2"][:, [0, -1]])


def test_the_reference_is_worse_than_every_point(studied: Results) -> None:
    for method in methods_in(studied):
        assert np.all(costs_of(studied, method) < studied["reference"])
    assert np.all(studied["hypervolume"] > 0)


def test_a_third_criterion_has_its_own_fronts(in_space: Results) -> None:
    waits = in_space["weighted_wait"][0]
    assert np.all(np.ptp(waits, axis=1) < 1e-9)
    assert np.all(np.diff(waits[:, 0]) > 0)
    assert waits[0, 0] == pytest.approx(in_space["t_s"][0] - in_space["instant"][0])
    assert len(in_space["reference"]) == 3
    assert not in_space["free_dominated"].any()


def test_bounds_alone_need_two_weighted_sums_only(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "pareto.h5"
    solve_pareto(run, question(at=(0.5,), method="epsilon-constraint"), path, 1)
    results = read_pareto(path)
    assert methods_in(results) == ("constrained",)
    assert results["constrained_J_1"].shape == (1, POINTS)


def test_samples_are_those_whose_window_holds_both_stages_alone(log: Run) -> None:
    samples = choose_samples(log, (0, 1), ())
    assert len(samples) == 5
    assert np.all(log["window/count"][samples] == 2)
    assert np.all(log["window/first"][samples] == 0)
    possible = np.flatnonzero((log["window/count"] == 2) & (log["window/first"] == 0))
    assert samples[0] == possible[0] and samples[-1] == possible[-1]


def test_a_time_is_its_nearest_sample_once(log: Run) -> None:
    assert choose_samples(log, (0, 1), (0.51, 0.52)) == [5]


def test_times_without_such_a_window_are_refused(log: Run) -> None:
    with pytest.raises(InputError, match=r"--at: found 1\.5, .* go and back alone; expected times from 0\.1 to 0\.7"):
        choose_samples(log, (0, 1), (0.3, 1.5))


def test_a_run_without_such_a_window_is_refused(tmp_path: Path) -> None:
    log = read_run(run_there_and_back(tmp_path, "controller.kind=hard"))
    with pytest.raises(InputError, match="found no sample whose window holds go and back alone"):
        choose_samples(log, (0, 1), ())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "simplex"}, "--method: found 'simplex', expected one of weighted-sum, epsilon-constraint, both"),
        ({"points": 2}, "--points: found 2, expected at least 3"),
        ({"stages": "2,3"}, "--stages: found '2,3'"),
    ],
)
def test_questions_without_answer_are_refused(
    run: Path, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        solve_pareto(run, question(**changes), tmp_path / "pareto.h5", 1)
    assert not (tmp_path / "pareto.h5").exists()


def test_a_log_without_plans_is_refused(tmp_path: Path) -> None:
    run = run_there_and_back(tmp_path, "log.plans=false")
    with pytest.raises(LogError, match="holds no plans"):
        solve_pareto(run, question(), tmp_path / "pareto.h5", 1)


@pytest.mark.parametrize(("text", "times"), [(None, ()), ("6.1", (6.1,)), ("8, 6.1,8", (6.1, 8.0))])
def test_times_are_read_rising_and_once(text: str | None, times: tuple[float, ...]) -> None:
    assert parse_times(text) == times


@pytest.mark.parametrize("text", ["", "soon", "1,,2", "nan", "1;2"])
def test_what_is_no_list_of_times_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--at: found"):
        parse_times(text)


def test_a_log_is_told_from_a_task(run: Path, tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    assert is_log(str(run))
    assert not is_log(str(tmp_path / "task.yaml"))
    assert not is_log("transport")
    assert not is_log(str(tmp_path))


def test_xarray_opens_the_file_with_named_coordinates(studied: Results, in_space: Results) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    for results in (studied, in_space):
        with xarray.open_dataset(results.path, engine="h5netcdf") as data:
            first = data["weighted_J_1"].sel(instant=results["instant"][0], ratio=LOWEST)
            np.testing.assert_allclose(np.ravel(first)[0], np.ravel(results["weighted_J_1"])[0])
            assert set(data["weighted_J_1"].coords) == set(results.quantities["weighted_J_1"].dims)
            assert data["hypervolume"].sizes == {"instant": len(results["instant"])}
