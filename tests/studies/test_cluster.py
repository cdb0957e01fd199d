"""Calls on a Dask cluster, some of whose workers are killed."""

import importlib
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli import __version__
from psmpc_cli.errors import InputError, RunError
from psmpc_cli.logs.results import Quantity, read_results
from psmpc_cli.logs.schema import MONTE_CARLO
from psmpc_cli.simulation.monte_carlo_runs import ENDED
from psmpc_cli.studies import cluster as cluster_module
from psmpc_cli.studies import cluster_client
from psmpc_cli.studies.cluster import DaskCalls
from psmpc_cli.studies.monte_carlo import load_monte_carlo, run_monte_carlo
from psmpc_cli.studies.parallel import LocalCalls
from psmpc_cli.studies.sampling import grid_sampling
from psmpc_cli.studies.sweep import load_sweep_task, run_sweep
from psmpc_cli.studies.sweep_file import COMPUTED, Sweep, read_sweep

from ..there_and_back import TASK
from .dask_cluster import DaskCluster, dask_cluster
from .test_parallel import doubled, fatal_for, fatal_once, made

WORKERS = ("--nthreads", "1", "--nworkers", "2")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """Two workers with one thread each."""
    with dask_cluster(tmp_path_factory.mktemp("cluster")) as started:
        started.add(*WORKERS)
        yield started


@pytest.fixture(autouse=True)
def nothing_is_said(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing of Dask's own comes to the user."""
    yield
    assert tuple(capfd.readouterr()) == ("", "")


@contextmanager
def pretended(cluster: DaskCluster, version: str, *, module: str) -> Iterator[None]:
    """Let the workers say that they have another version, as far as a module of theirs knows."""
    from distributed import Client

    def tell(version: str) -> None:
        importlib.import_module("psmpc_cli.studies.cluster")
        vars(importlib.import_module(module))["__version__"] = version

    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(2)
        client.run(tell, version)
        try:
            yield
        finally:
            client.run(tell, __version__)


def assert_alike(here: Mapping[str, Quantity], there: Mapping[str, Quantity]) -> None:
    """Assert that the results of two studies are equal but for times that were measured."""
    for name, quantity in here.items():
        if "wall time" not in quantity.long_name:
            np.testing.assert_array_equal(there[name].values, quantity.values, err_msg=name)


def test_a_sweep_on_a_cluster_is_the_sweep_on_this_machine(tmp_path: Path, cluster: DaskCluster) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    task = load_sweep_task(str(tmp_path / "task.yaml"), ("controller.nodes=12",), ())
    sweep = Sweep(task, (0, 1), grid_sampling("3", (0.1, 10.0)), False)
    run_sweep(sweep, tmp_path / "here.h5", LocalCalls(1))
    run_sweep(sweep, tmp_path / "there.h5", DaskCalls(cluster.address))
    there = read_sweep(tmp_path / "there.h5")
    assert there["status"].tolist() == [COMPUTED] * 3
    assert_alike(read_sweep(tmp_path / "here.h5").quantities, there.quantities)


def test_monte_carlo_runs_on_a_cluster_are_those_on_this_machine(tmp_path: Path, cluster: DaskCluster) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    noise = ("uncertainty.noise={position: 1e-3, angle: 1e-3}", "controller.nodes=12")
    study = load_monte_carlo(str(tmp_path / "task.yaml"), noise, 3)
    run_monte_carlo(study, tmp_path / "here.h5", LocalCalls(1))
    run_monte_carlo(study, tmp_path / "there.h5", DaskCalls(cluster.address))
    here, there = (read_results(tmp_path / name, MONTE_CARLO) for name in ("here.h5", "there.h5"))
    assert there["status"].tolist() == [ENDED] * 3
    assert_alike(here.quantities, there.quantities)


def test_a_killed_worker_costs_no_result(tmp_path: Path, cluster: DaskCluster) -> None:
    note = tmp_path / "note"
    assert made(DaskCalls(cluster.address), fatal_once(note)) == doubled()
    assert note.exists()


def test_a_call_that_kills_its_worker_every_time_is_found_out_and_the_others_go_on(cluster: DaskCluster) -> None:
    calls = DaskCalls(cluster.address)
    assert made(calls, fatal_for(1)) == doubled(but=(1,))


def test_what_a_call_raises_comes_through(cluster: DaskCluster) -> None:
    def refuse(item: int) -> int:
        raise ArithmeticError("no such luck")

    with pytest.raises(ArithmeticError, match="no such luck"):
        made(DaskCalls(cluster.address), refuse)


def test_work_that_is_left_leaves_nothing_behind(cluster: DaskCluster, tmp_path: Path) -> None:
    def call(item: int) -> int:
        (tmp_path / str(item)).touch()
        time.sleep(0.2)
        return item

    results = DaskCalls(cluster.address).each(call, range(50))
    next(results)
    results.close()
    time.sleep(0.6)
    begun = len(list(tmp_path.iterdir()))
    time.sleep(0.6)
    assert len(list(tmp_path.iterdir())) == begun < 50


def test_a_worker_of_another_version_is_refused_with_both(cluster: DaskCluster) -> None:
    with pretended(cluster, "0.0.1", module="psmpc_cli"), pytest.raises(InputError) as error:
        DaskCalls(cluster.address)
    assert "worker tcp://127.0.0.1:" in str(error.value)
    assert f"has psmpc 0.0.1, expected psmpc {__version__}" in str(error.value)


def test_a_worker_of_another_version_that_comes_later_computes_nothing(cluster: DaskCluster) -> None:
    calls = DaskCalls(cluster.address)
    unasked = pretended(cluster, "0.0.1", module="psmpc_cli.studies.cluster")  # what a call itself compares with
    with unasked, pytest.raises(RunError, match=r"worker with psmpc 0\.0\.1 came to the cluster"):
        made(calls, fatal_for())


def test_a_cluster_has_workers_with_one_thread_each_or_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with dask_cluster(tmp_path) as lonely:
        monkeypatch.setattr(cluster_client, "ANSWER", 2)
        with pytest.raises(InputError, match=f"has no workers; .*: dask worker {lonely.address} --nthreads 1"):
            DaskCalls(lonely.address)
        monkeypatch.undo()
        lonely.add("--nthreads", "2", "--no-nanny")
        with pytest.raises(InputError, match="has 2 threads, expected 1; start it with --nthreads 1"):
            DaskCalls(lonely.address)


def test_a_scheduler_that_goes_away_ends_the_work(tmp_path: Path) -> None:
    with dask_cluster(tmp_path) as mortal:
        mortal.add("--nthreads", "1", "--no-nanny")
        results = DaskCalls(mortal.address).each(lambda item: time.sleep(0.2), range(50))
        next(results)
        mortal.scheduler.kill()
        with pytest.raises(RunError, match="connection to the Dask scheduler was lost"):
            list(results)


def test_workers_that_go_away_for_good_end_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "LOOK", 0.1)
    monkeypatch.setattr(cluster_module, "DESERTED", 0.5)

    def call(item: int) -> int:
        if item == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return item

    with dask_cluster(tmp_path) as mortal:
        mortal.add("--nthreads", "1", "--no-nanny")
        with pytest.raises(RunError, match="has had no workers"):
            made(DaskCalls(mortal.address), call)


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("tcp://127.0.0.1:1", "no Dask scheduler answers at 'tcp://127.0.0.1:1' (Timed out"),
        ("localhost", "missing port number"),
        ("", "missing port number"),
        ("http://127.0.0.1:8786", "unknown address scheme 'http'"),
    ],
)
def test_an_address_without_a_scheduler_is_refused_in_one_line(
    address: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_client, "ANSWER", 1)
    with pytest.raises(InputError) as error:
        DaskCalls(address)
    assert reason in str(error.value)
    assert "dask scheduler --host 127.0.0.1" in str(error.value)
    assert "\n" not in str(error.value)


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'psmpc\[dask\]'"):
        DaskCalls("tcp://127.0.0.1:8786")
