"""The bench as a whole: what it measures, its rows and its document."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.errors import InputError, RunError, SpecError
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.bench import Bench, Choices, load_bench, parse_nodes, parse_solvers, run_bench
from psmpc_cli.studies.bench_document import document, write_document
from psmpc_cli.studies.bench_freedom import Freedom, grow_with_freedom
from psmpc_cli.studies.bench_solves import COLD, REFERENCE, WARM, Way
from psmpc_cli.studies.bench_summary import grow, summarize_bench

from ..there_and_back import TASK
from .small_bench import FARTHER

CHOICES = Choices(nodes=("5", "10"), solvers=("sqp",), repeat=2, appends=1)


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("task") / "small.yaml"
    path.write_text(TASK)
    return path


@pytest.fixture(scope="module")
def bench(task: Path) -> Bench:
    return run_bench(load_bench(str(task), (FARTHER,), CHOICES))


@pytest.fixture(scope="module")
def found(bench: Bench) -> Mapping[str, Any]:
    return document(bench)


def test_windows_of_both_runs_stand_on_every_mesh(bench: Bench) -> None:
    assert [recorded.phase for recorded in bench.windows] == ["before", "at", "after"]  # equal priorities: one run
    assert set(bench.posed) == {(index, nodes) for index in range(3) for nodes in CHOICES.nodes}
    assert len(bench.solved) == 3 * 2 * 3


def test_failed_solves_are_counted_and_stand_in_no_other_column(bench: Bench) -> None:
    broken = [
        replace(one, outcome=Outcome.INFEASIBLE) if (one.index, one.way.solver) == (0, "sqp") else one
        for one in bench.solved
    ]
    rows = {(row.nodes, row.stages, row.way): row for row in summarize_bench(replace(bench, solved=tuple(broken)))}
    alone, every = rows["5", 1, Way("sqp", WARM)], rows["5", None, Way("sqp", WARM)]
    assert (alone.windows, alone.failed, alone.time.count) == (1, 1, 0)
    assert np.isnan(alone.time.median) and np.isnan(alone.speedup)
    assert (every.windows, every.failed, every.time.count) == (3, 1, 2 * CHOICES.repeat)
    assert all(growth.stages != 1 or not growth.nodes for growth in grow(list(rows.values())) if not _reference(growth))


def _reference(growth: Any) -> bool:
    return growth.way.solver == REFERENCE


def test_the_reference_way_is_as_fast_as_itself(bench: Bench) -> None:
    for row in summarize_bench(bench):
        if row.way == Way(REFERENCE, COLD):
            assert row.speedup == 1


def test_growth_is_that_of_the_given_meshes(bench: Bench) -> None:
    growths = list(grow(summarize_bench(bench)))
    assert {(growth.way.start, growth.stages) for growth in growths} == {(WARM, 1), (WARM, 2), (COLD, 1), (COLD, 2)}
    for growth in growths:
        assert growth.nodes == (5, 10)
        assert growth.exponent == pytest.approx(np.log2(growth.medians[1] / growth.medians[0]))
        assert np.isnan(growth.doubling)


def test_growth_with_freedom_counts_what_failed(bench: Bench) -> None:
    solved = tuple(one for one in bench.solved if one.nodes == "5")
    failed = tuple(replace(one, outcome=Outcome.FAILED) for one in solved)
    found = list(grow_with_freedom([Freedom(1, 3, solved), Freedom(2, 3, solved), Freedom(3, 3, failed)]))
    assert all(growth.n == (6, 9) or growth.stages == 2 for growth in found)
    assert all(growth.failed == (1 if growth.stages == 1 else 2) for growth in found)
    assert all(growth.exponent == pytest.approx(0.0, abs=1e-9) for growth in found if growth.stages == 1)


def test_the_document_says_everything(found: Mapping[str, Any]) -> None:
    assert {"machine", "choices", "windows", "problems", "solves", "summary", "growth_with_nodes"} <= set(found)
    assert {"cores", "processor", "compiler", "versions"} <= set(found["machine"])
    assert {"psmpc", "python", "casadi", "numpy"} <= set(found["machine"]["versions"])
    assert found["wall_over_busy"] > 0
    solve = found["solves"][0]
    for key in ("outcome", "iterations", "objective_gap", "instant_gap", "violation", "instant_gap_to_finest"):
        assert key in solve
    assert set(solve["time"]) == {"count", "median", "p95", "p99", "least", "largest"}
    assert {problem["nodes"] for problem in found["problems"]} == set(CHOICES.nodes)
    assert len(found["solves"]) == 18


def test_the_document_is_json_without_words_of_its_own(found: Mapping[str, Any], tmp_path: Path) -> None:
    write_document(tmp_path / "new" / "bench.json", dict(found))
    assert json.loads((tmp_path / "new" / "bench.json").read_text()) == found


def test_nothing_is_overwritten_unasked(found: Mapping[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    path.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_document(path, dict(found))
    assert path.read_text() == "mine"
    write_document(path, dict(found), force=True)
    assert path.read_text() != "mine"
    with pytest.raises(InputError, match="is a directory"):
        write_document(tmp_path, dict(found), force=True)


def test_lists_are_read_once_each() -> None:
    assert parse_nodes("25, 50,auto,25") == ("25", "50", "auto")
    assert parse_solvers("fatrop,sqp") == ("fatrop", "sqp")


@pytest.mark.parametrize("text", ["", "25,", "-3", "2.5", "fine"])
def test_meshes_that_are_none_are_named(text: str) -> None:
    with pytest.raises(InputError, match=r"--nodes: found .* expected numbers of intervals or auto"):
        parse_nodes(text)


def test_an_unknown_back_end_is_named() -> None:
    with pytest.raises(InputError, match="--solvers: found 'snopt', expected some of sqp, fatrop, ipopt"):
        parse_solvers("sqp,snopt")


def test_a_mesh_outside_its_range_is_found_before_anything_runs(task: Path) -> None:
    with pytest.raises(SpecError, match=r"controller\.nodes"):
        load_bench(str(task), (), replace(CHOICES, nodes=("5", "1")))


def test_a_run_without_an_append_is_refused(task: Path) -> None:
    with pytest.raises(RunError, match="in no sample of its runs a stage entered the window"):
        run_bench(load_bench(str(task), (FARTHER, "time_limit=0.3"), CHOICES))
