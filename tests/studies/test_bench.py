"""The bench: what it measures, its rows, and what it rejects."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.errors import InputError, RunError, SpecError
from psmpc_cli.studies.bench import (
    HEADINGS,
    NOTE,
    Bench,
    Choices,
    bench_rows,
    describe_machine,
    load_bench,
    parse_nodes,
    parse_solvers,
    run_bench,
)

from ..there_and_back import TASK

FARTHER = "stages[0].target.base=[0.3, 0, 0]"
"""So far that the second stage enters the window after some samples, not at once."""

CHOICES = Choices(nodes=("5", "10"), repeat=2, appends=1)


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
    return run_bench(load_bench(task, (FARTHER,), CHOICES), CHOICES, told.append)


def test_windows_before_at_and_after_the_append_are_solved_on_every_mesh(bench: Bench, told: list[str]) -> None:
    assert bench.windows == {"5": 3, "10": 3}  # equal priorities: both runs give the same windows
    assert [line.partition(":")[0] for line in told] == ["nodes 5", "nodes 10"]
    ways = [(name, start) for name in CHOICES.solvers for start in ("warm", "cold")] + [("reference", "cold")]
    assert [(one.nodes, one.solver, one.start) for one in bench.timed] == [
        (nodes, *way) for nodes in CHOICES.nodes for way in ways
    ]
    for one in bench.timed:
        assert list(one.stages) == [1, 2, 2]
        assert one.times.shape == (3, 2)
        assert (one.times > 0).all()


def test_every_back_end_finds_the_optimum(bench: Bench) -> None:
    for one in bench.timed:
        assert one.usable.all()
        tight = one.solver in ("fatrop", "ipopt", "reference")
        assert np.abs(one.gap).max() < (1e-5 if tight else 1e-2)
        assert one.violation.max() < (1e-6 if tight else 1e-4)


def test_compiled_code_and_piqp_come_to_the_same(bench: Bench) -> None:
    found = {(one.nodes, one.solver, one.start): one for one in bench.timed}
    for nodes in CHOICES.nodes:
        for start in ("warm", "cold"):
            kernel, piqp = found[nodes, "sqp", start], found[nodes, "piqp", start]
            np.testing.assert_allclose(kernel.gap, piqp.gap, atol=1e-6)


def test_a_row_has_every_column_and_the_reference_is_as_fast_as_itself(bench: Bench) -> None:
    rows = [dict(zip(HEADINGS, row, strict=True)) for row in bench_rows(bench)]
    assert len(rows) == len(bench.timed)
    assert {row["times faster"] for row in rows if row["solver"] == "reference"} == {"1.0"}
    assert {row["failed"] for row in rows} == {"0 of 3"}
    assert all(word in NOTE for word in ("times faster", "off", "violation", "failed"))


def test_failed_solves_are_counted_and_count_in_no_other_column(bench: Bench) -> None:
    first, *others = bench.timed
    failed = replace(first, usable=np.zeros(3, bool))
    row = dict(zip(HEADINGS, next(bench_rows(replace(bench, timed=(failed, *others)))), strict=True))
    assert row["failed"] == "3 of 3"
    assert set(row.values()) == {"5", "sqp", "warm", "-", "3 of 3"}
    assert np.isnan(failed.median())
    assert np.isnan(first.median(stages=3))


def test_the_machine_is_named(bench: Bench) -> None:
    said = describe_machine(bench)
    assert "cores" in said
    assert all(name in said for name in ("python", "psmpc", "casadi", "numpy", "piqp"))
    assert bench.wall_over_busy > 0


def test_lists_are_read_once_each() -> None:
    assert parse_nodes("25, 50,auto,25") == ("25", "50", "auto")
    assert parse_solvers("fatrop,sqp") == ("fatrop", "sqp")


@pytest.mark.parametrize("text", ["", "25,", "-3", "2.5", "fine"])
def test_meshes_that_are_none_are_named(text: str) -> None:
    with pytest.raises(InputError, match=r"--nodes: found .* expected numbers of intervals or auto"):
        parse_nodes(text)


def test_an_unknown_back_end_is_named() -> None:
    with pytest.raises(InputError, match="--solvers: found 'snopt', expected some of sqp, piqp, fatrop, ipopt"):
        parse_solvers("sqp,snopt")


def test_a_mesh_outside_its_range_is_found_before_anything_runs(task: str) -> None:
    with pytest.raises(SpecError, match=r"controller\.nodes"):
        load_bench(task, (), replace(CHOICES, nodes=("5", "1")))


@pytest.mark.parametrize("change", ["solver.kind=ipopt", "controller=smpc", "controller.nodes=7"])
def test_what_a_bench_sets_itself_is_not_for_changing(task: str, change: str) -> None:
    with pytest.raises(InputError, match="--solvers"):
        load_bench(task, (change,), CHOICES)


def test_a_run_without_an_append_is_rejected(task: str) -> None:
    changes = (FARTHER, "time_limit=0.3")
    with pytest.raises(RunError, match="in no sample of its runs a stage entered the window"):
        run_bench(load_bench(task, changes, CHOICES), CHOICES)
