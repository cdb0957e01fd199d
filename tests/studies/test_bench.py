"""The bench: what it measures, its rows, and what it rejects."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.errors import RunError, SpecError
from psmpc_cli.studies.bench import (
    HEADINGS,
    NOTE,
    SOLVERS,
    Bench,
    bench_rows,
    load_bench,
    median_time,
    run_bench,
)

from .. import free_flyer
from ..short_runs import TASK

FARTHER = "stages[0].target.base=[0.3, 0, 0]"
"""So far that the second stage enters the window after some samples, not at once."""

NODES = ("5", "10")


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("task") / "small.yaml"
    path.write_text(TASK)
    return str(path)


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def bench(task: str, told: list[str]) -> Bench:
    tasks = load_bench(task, (FARTHER,), "5, 10,5")
    return run_bench(tasks, repeat=2, appends=1, watch=lambda progress: told.append(str(progress)))


@pytest.mark.slow
def test_windows_before_at_and_after_the_append_are_solved_on_every_mesh(bench: Bench, told: list[str]) -> None:
    meshes = [line.partition(", about")[0] for line in told if "meshes" in line]
    assert meshes == [
        "0 of 2 meshes",
        "1 of 2 meshes, 5 nodes a stage, 6 windows done",
        "2 of 2 meshes, 10 nodes a stage, 6 windows done",
    ]
    assert sum(line.startswith("10 nodes a stage: ") for line in told) > 6
    ways = [(name, start) for name in SOLVERS for start in ("warm", "cold")] + [("reference", "cold")]
    assert list(bench.solves) == [(nodes, *way) for nodes in NODES for way in ways]
    for solves in bench.solves.values():
        assert [solve.stages for solve in solves] == [1, 2, 2, 1, 2, 2]  # of both controllers
        assert all(solve.times.shape == (2,) and (solve.times > 0).all() for solve in solves)


@pytest.mark.slow
def test_every_back_end_finds_the_optimum(bench: Bench) -> None:
    for (_, solver, _), solves in bench.solves.items():
        tight = solver in ("fatrop", "ipopt", "reference")
        for solve in solves:
            assert solve.usable
            assert abs(solve.gap) < (1e-5 if tight else 1e-2)
            assert solve.violation < (1e-6 if tight else 1e-4)


def test_a_row_has_every_column_and_the_reference_is_as_fast_as_itself(bench: Bench) -> None:
    rows = [dict(zip(HEADINGS, row, strict=True)) for row in bench_rows(bench)]
    assert len(rows) == len(bench.solves)
    assert {row["times faster"] for row in rows if row["solver"] == "reference"} == {"1.0"}
    assert {row["failed"] for row in rows} == {"0 of 6"}
    assert all(word in NOTE for word in ("times faster", "off", "violation", "failed"))


def test_failed_solves_are_counted_and_count_in_no_other_column(bench: Bench) -> None:
    way, solves = next(iter(bench.solves.items()))
    failed = [solve._replace(usable=False) for solve in solves]
    row = dict(zip(HEADINGS, next(bench_rows(replace(bench, solves={**bench.solves, way: failed}))), strict=True))
    assert row["failed"] == "6 of 6"
    assert set(row.values()) == {"5", "sqp", "warm", "-", "6 of 6"}
    assert np.isnan(median_time(failed))
    assert np.isnan(median_time(solves, stages=3))
    assert median_time(solves, stages=2) > 0


@pytest.mark.parametrize("text", ["", "25,", "5,1", "2.5", "fine"])
def test_a_mesh_that_is_none_is_found_before_anything_runs(task: str, text: str) -> None:
    with pytest.raises(SpecError, match=r"controller\.nodes"):
        load_bench(task, (), text)


def test_a_run_without_an_append_is_rejected(task: str) -> None:
    changes = (FARTHER, "time_limit=0.3")
    with pytest.raises(RunError, match="in no sample of its runs a stage entered the window"):
        run_bench(load_bench(task, changes, "5"))


@pytest.mark.slow
def test_windows_of_a_robot_in_space_have_one_optimum_from_every_start() -> None:
    """A turn about one axis and a flight along another: limits of the angular velocity depend on the attitudes."""
    pose = {"position": [0.1, 0.1, -0.1], "attitude": free_flyer.attitude([0.6, 0, 0.8], 30)}
    changes = [f"stages.{name}.target.base={pose}" for name in ("fly", "unfold")]
    task = free_flyer.turning(30, "controller={nodes: 6, horizon: 3}", "plant.kind=ideal", "log.shares=false", *changes)
    bench = run_bench({"6": [task]}, "sqp", repeat=1, appends=1)
    assert [solve.stages for solve in bench.solves["6", "sqp", "warm"]] == [1, 2, 2]
    for (_, solver, start), solves in bench.solves.items():
        tight = 1e-7 if solver == "reference" else 1e-4
        assert all(solve.usable and abs(solve.gap) < tight for solve in solves), (solver, start)
        assert all(solve.violation < tight for solve in solves), (solver, start)
