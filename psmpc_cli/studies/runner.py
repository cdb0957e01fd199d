"""The runner of studies: cells computed in parallel, and a results file that is filled in and resumed.

A study is a task, the keys that each cell changes in it, and a measure: a function from the run of a cell to a row of
named values. Sweeps and Monte Carlo studies are instances. The results are labelled arrays, which xarray opens.
"""

import logging
import os
import pickle
import re
import signal
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from difflib import unified_diff
from functools import partial
from itertools import islice
from multiprocessing import current_process
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from pkgutil import resolve_name
from queue import Empty, SimpleQueue
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from loky import get_reusable_executor
from loky.process_executor import TerminatedWorkerError

from psmpc_cli import __version__
from psmpc_cli.errors import InputError, LogError, RunError, SpecError, begin_worker, deferred_signals
from psmpc_cli.logs.files import FileLock, check_output
from psmpc_cli.logs.results import Quantity, Results, new_results, read_results
from psmpc_cli.logs.schema import Column
from psmpc_cli.ocp.feasibility.checks import ensure_feasible, load_task
from psmpc_cli.plant import require_plant
from psmpc_cli.progress import Watch, Work
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.document import quoted
from psmpc_cli.specs.load import Task, TaskDocuments, parse_task, read_documents
from psmpc_cli.studies.measures import check_columns

logger = logging.getLogger(__name__)

Key = TypeVar("Key")
Item = TypeVar("Item")
Result = TypeVar("Result")

LOST = "its process was killed each time it was computed, perhaps for lack of memory"
"""Failure of a cell that was lost."""

WAITING, COMPUTED, SHARED, FAILED = range(4)
"""Codes of a cell's status; its run is its own, or that of another cell."""

CELL_COLUMNS = (
    Column("status", "1", "status of the cell", dtype="i4", unknown=WAITING),
    Column("origin", "1", "flat index of the cell whose run it shares", dtype="i4", unknown=-1),
    Column("reason", "1", "why the run ended, where it says so, or the cell failed", dtype="text"),
    Column("cell_time", "s", "wall time of the cell's run, with all that is around"),
)
"""What the results have of a cell itself."""

REFERENCE = "reference_"
"""How the names of the reference run's quantities begin."""

CONNECTING = 10
"""Time within which a Dask scheduler answers and has a worker [s]."""

POLL = 0.1
"""Time between two looks for a signal while processes compute [s]."""

IDLE = 30
"""Time after which a process that computes nothing ends [s]."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of the processes."""

REDUCED_LOG = ("log.shares=false", "log.plans=false", "log.ticks=false")
"""Changes of a task: what is logged but not measured, and costs solves or memory."""


@dataclass(frozen=True, eq=False)
class Study:
    """A study and the arrays of its results file.

    Attributes:
        kind: Kind of the results file.
        task: The task.
        cells: The keys that each cell changes in the task, each `path=value`.
        dims: Dimensions of the cells' arrays, whose elements in C order are the cells.
        coordinates: The coordinates, and what is known of the cells before they run.
        quantities: What is read from a run; those along a coordinate that there is not are left out. They are pickled.
        identity: What the file of a study to resume has in common with this one, by its name for a user.
        attributes: Further attributes of the file.
        statuses: What the codes of a cell's status mean.
        required_stage: Index of the stage without whose end a cell counts as failed; None if there is none.
        reference: Whether the unchanged task is run as well, to compare the cells with: `of_reference`.
        first_equal_runs: For each run the index of the first run with the same result, which is made for both (runs,);
            None if all differ.
    """

    kind: str
    task: Task
    cells: Sequence[tuple[str, ...]]
    dims: tuple[str, ...]
    coordinates: Sequence[Quantity]
    quantities: Sequence[Column]
    identity: Mapping[str, str | int | float] = field(default_factory=dict)
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)
    statuses: tuple[str, ...] = ("waiting", "computed", "shared", "failed")
    required_stage: int | None = None
    reference: bool = False
    first_equal_runs: np.ndarray | None = None

    @property
    def runs(self) -> list[tuple[str, ...]]:
        """The keys that each run changes in the task: those of the cells, then the reference, if there is one."""
        return [*self.cells, ()] if self.reference else [*self.cells]

    def results(self, path: Path | None = None) -> Results:
        """Build the results of the study before anything is computed: every array in its final size, without values.

        Quantities along a dimension that the study does not have, such as monitors, are left out.

        Args:
            path: The file that the results will be written to; None for results that stay in memory.
        """
        dim_sizes = {axis.name: len(axis.values) for axis in self.coordinates if axis.dims == (axis.name,)}
        arrays = [*self.coordinates, Quantity("wall_time", (), np.array(0.0), "s", "wall time spent on the study")]
        measurable = [column for column in (*CELL_COLUMNS, *self.quantities) if {*column.dims} <= {*dim_sizes}]
        columns = [replace(column, dims=(*self.dims, *column.dims)) for column in measurable]
        # quantities of the cells, then those of the reference run, which have no dimension of cells
        for column in (*columns, *(of_reference(measurable) if self.reference else ())):
            is_text = column.dtype == "text"
            shape = [dim_sizes[name] for name in column.dims]
            values = np.full(shape, "" if is_text else column.unknown, object if is_text else column.dtype)
            meanings = self.statuses if column.path.removeprefix(REFERENCE) == "status" else ()
            arrays.append(Quantity(column.path, column.dims, values, column.units, column.long_name, meanings))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        task = self.task
        task_attributes = {"digest": task.digest, "task_name": task.spec.name, "task_yaml": task.task_yaml}
        attributes = {
            **self.identity,
            **task_attributes,
            "robot_yaml": task.robot_yaml,
            "created": created,
            **self.attributes,
        }
        return new_results(path or Path("a study in memory"), self.kind, attributes, arrays)


def of_reference(columns: Iterable[Column]) -> list[Column]:
    """Return the columns of the reference run, each a single value or along its own dimensions."""
    return [replace(each, path=REFERENCE + each.path, long_name=f"{each.long_name}: task as it is") for each in columns]


def run_study(
    study: Study,
    path: Path | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = lambda progress: None,
) -> Results:
    """Compute all cells of a study in parallel: run its task once for each cell, with the keys that the cell changes.

    A cell whose run fails or whose process is killed is marked as failed; the others go on. The file is filled in cell
    by cell, so that a study that was stopped can be resumed.

    Args:
        study: The study.
        path: File of the results; None for results in memory alone.
        jobs: Number of processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on instead.
        force: Whether an existing file is overwritten.
        resume: Whether to go on with the study in an existing file: its cells that wait or failed are computed.
        watch: Called with the progress at the beginning, after every run, and from time to time meanwhile.

    Returns:
        The results, which are also in the file.

    Raises:
        InputError: The file exists, cannot be written, is being filled in by another process or holds another study; or
            there is no such cluster, or a package that the plant needs. Then no file was touched.
        RunError: The file cannot be written any further, or the cluster is gone.
    """
    require_plant(study.task.spec.plant)
    if dask is not None:
        with _workers_on_cluster(dask):
            pass  # only to see that it can be reached, before a file is touched
    if path is None:
        return _compute_cells(study, study.results(), jobs, dask, None, watch)
    if not resume:
        check_output(path, force)
    with FileLock(path) as lock:
        results = study.results(path)
        if resume:
            results = _results_to_resume(study, results)
        else:
            results.create(force, lock)
        return _compute_cells(study, results, jobs, dask, lock, watch)


def _compute_cells(
    study: Study, results: Results, jobs: int | None, dask: str | None, lock: FileLock | None, watch: Watch
) -> Results:
    """Compute the cells of a study that wait or failed, and enter what was measured as each run ends.

    A run is made once for all cells with equal results, and counts as theirs: `study.first_equal_runs` says which these
    are. The run after that of the last cell is the reference, the task without changes, if the study has one. Its
    quantities have names that begin with `REFERENCE`.

    Args:
        study: The study.
        results: Its results so far, which are filled in and returned.
        jobs: Number of processes on this machine; None for one for each core.
        dask: Address of the scheduler of a Dask cluster to use instead; None for this machine.
        lock: Lock of the file of results, which is written after every run; None without a file.
        watch: Called with the progress.
    """
    cell_shape = results["status"].shape
    status = [*results["status"].flat, *([results[f"{REFERENCE}status"]] if study.reference else [])]
    time_before = float(results["wall_time"])
    runs = study.runs
    first_equal_runs = np.arange(len(runs)) if study.first_equal_runs is None else study.first_equal_runs
    runs_to_make = np.unique(first_equal_runs[np.isin(status, (WAITING, FAILED))])
    began_at = time.monotonic()
    work = Work("runs", len(runs_to_make), watch)
    run_cell = partial(_run_cell, documents_of(study.task), study.quantities, study.required_stage)
    with closing(
        compute(run_cell, {int(cell): runs[cell] for cell in runs_to_make}, jobs, dask, work.wait)
    ) as results_of_runs:
        for origin, measured in results_of_runs:
            # None if the run killed its process
            row = {"reason": LOST, "cell_time": np.nan, "status": FAILED} if measured is None else measured
            failed = row["status"] == FAILED
            for cell in np.flatnonzero(first_equal_runs == origin):
                code = row["status"] if failed or cell == origin else SHARED
                is_cell = cell < len(study.cells)
                index = np.unravel_index(cell, cell_shape) if is_cell else ()
                for name, value in {**row, "origin": origin, "status": code}.items():
                    results[name if is_cell else REFERENCE + name][index] = value
            results["wall_time"][()] = time_before + time.monotonic() - began_at
            if lock is not None:
                results.save(lock)
            work.advance(failed=bool(failed))
    return results


def _run_cell(
    documents: TaskDocuments, quantities: Sequence[Column], required_stage: int | None, changes: tuple[str, ...]
) -> dict[str, Any]:
    """Run one cell of a study, in the process of a worker, and measure the run.

    An error in the run makes the cell fail but is not raised, so that the study goes on. A mission that does not
    succeed is measured like any other. A run that does not end the required stage is measured and counts as failed.

    Args:
        documents: Texts of task and robot.
        quantities: What is measured of the run.
        required_stage: Index of a stage that has to end; None if none has to.
        changes: The keys that the cell changes in the task, each `path=value`.

    Returns:
        What was measured, by the names of the quantities, without those that have no value. In addition `reason`, why
        the run ended or failed; `status`, `COMPUTED` or `FAILED`; and `cell_time`, the wall time [s].
    """
    began_at = time.perf_counter()
    try:
        run = simulate(documents.changed(changes))
        row = {
            quantity.path: value for quantity in quantities if quantity.value and np.size(value := quantity.value(run))
        }
        ends_required_stage = required_stage is None or np.isfinite(run.stages["switch_time"][required_stage])
        row["reason"] = run.summary().reason
        row["status"] = COMPUTED if ends_required_stage else FAILED
    except Exception as error:
        logger.exception("a cell failed")
        row = {"reason": f"{type(error).__name__}: {error}", "status": FAILED}
    return {**row, "cell_time": time.perf_counter() - began_at}


def with_changes(task: Task | str | Path, changes: Sequence[str]) -> Task:
    """Return a task, its file or a built-in one of this name, with keys changed.

    Raises:
        SpecError: The task, or a change of it, does not hold, or no run of it could succeed.
    """
    if not isinstance(task, Task):
        return load_task(task, changes)
    return ensure_feasible(documents_of(task).changed(changes)) if changes else task


def documents_of(task: Task) -> TaskDocuments:
    """Read the texts of a task, once for all the variants that are made of it."""
    return read_documents(task.task_yaml, task.robot_yaml, task.spec.name)


def task_in(results: Results, changes: Sequence[str] = ()) -> Task:
    """Return the task of a study from its file, with keys changed.

    Raises:
        LogError: There is none, or it does not hold in this version.
    """
    texts = [results.attributes.get(key) for key in ("task_yaml", "robot_yaml", "task_name")]
    if not all(isinstance(text, str) for text in texts):
        raise LogError(f"{results.path}: found no task and robot, expected the file of a study")
    task, robot, name = map(str, texts)
    try:
        return parse_task(task, robot, name, changes)
    except SpecError as error:
        raise LogError(f"{results.path}: the task or robot in it is not valid in this version:\n{error}") from None


def names_along(task: Task) -> list[Quantity]:
    """Build the further coordinates of a whole run's quantities: stages, and monitors where there are any."""
    judged = task.spec.judged
    coordinates = [Quantity("stage", ("stage",), np.array([each.name for each in task.spec.stages]), "1", "stage")]
    if judged:
        coordinates.append(Quantity("monitor", ("monitor",), np.array(list(judged)), "1", "monitor"))
        coordinates.append(
            Quantity("monitor_unit", ("monitor",), np.array(list(judged.values())), "1", "unit of its margin")
        )
    return coordinates


def _results_to_resume(study: Study, new: Results) -> Results:
    """Read the results of a study that was stopped, to go on with it; the study may have more cells than the file.

    Args:
        study: The study, as it is asked for now.
        new: Its results with nothing computed and the path of the file. What the file has is copied into its arrays.

    Returns:
        The results with what was computed before, and with the attributes of the file.

    Raises:
        InputError: There is no file, or it holds another study: of another task, version or options, or with more
            cells.
    """
    path = new.path
    cells = len(study.cells)
    if not path.exists():
        raise InputError(
            f"--resume: found no file {path}, expected a {study.kind} study that was stopped; omit --resume"
        )
    stored = read_results(path, study.kind)
    # what has to be the same: `digest` stands for the texts of task and robot
    for name in ("psmpc_version", "digest", *study.identity):
        value_in_file, value_now = (either.attributes.get(name) for either in (stored, new))
        if value_in_file != value_now:
            difference = f"found {name.replace('_', ' ')} {value_in_file}, this one has {value_now}"
            if name == "digest":
                difference = _task_difference(stored, new)
            advice = "give the same task and options, or choose another file with -o"
            raise InputError(f"--resume: {path} holds another {study.kind} study: {difference}; {advice}")
    if (cells_in_file := stored["status"].size) > cells:
        raise InputError(f"--resume: {path} has {cells_in_file} runs, found {cells}, expected at least as many")
    if missing := [name for name in new.quantities if name not in stored.quantities]:
        raise InputError(
            f"--resume: {path} was written by an earlier version, whose studies had no {missing[0]}: start anew with "
            "--force, or choose another file with -o"
        )
    for name, quantity in new.quantities.items():
        dtype = "text" if quantity.is_text else quantity.values.dtype.str
        check_columns(stored, [Column(name, quantity.units, quantity.long_name, dtype=dtype, dims=quantity.dims)])
        shape = stored[name].shape
        if any(size > most for size, most in zip(shape, quantity.values.shape, strict=True)):
            raise InputError(f"--resume: {path} holds another {study.kind} study: found {name} of shape {shape}")
        quantity.values[tuple(map(slice, shape))] = stored[name]  # the array of the file is the corner of the new one
    return replace(new, attributes=stored.attributes)


def _task_difference(*studies: Results) -> str:
    """Write the lines in which the tasks of two studies differ."""
    before, now = (f"{each.attributes['task_yaml']}\n{each.attributes['robot_yaml']}".splitlines() for each in studies)
    lines = list(unified_diff(before, now, n=0, lineterm=""))[2:]
    found, wanted = (quoted("; ".join(line[1:].strip() for line in lines if line[0] == sign)) for sign in "-+")
    return f"found {found} in its task, this one has {wanted}"


@dataclass(frozen=True)
class Workers:
    """Processes that make calls.

    Attributes:
        submit: Function that has a function called on an item.
        result: Function from a call that has ended to what it returned; it raises what the call raised.
        error_if_killed: What a call raises if its process is killed.
    """

    submit: Callable[[Callable[[Any], Any], Any], Future[Any]]
    result: Callable[[Future[Any]], Any]
    error_if_killed: type[Exception]


def compute(
    function: Callable[[Item], Result],
    items: Mapping[Key, Item],
    jobs: int | None = None,
    dask: str | None = None,
    wait: Callable[[], None] = lambda: None,
) -> Generator[tuple[Key, Result | None], None, None]:
    """Call a function on many items in parallel, and yield the results in the order in which the calls end.

    The calls are made in other processes with one thread each, because a call may kill its process, for instance for
    lack of memory. (They are made in this process only if it may start no others.) If a process is killed, one cannot
    tell by which call: then the first call without a result is repeated alone, and is given up if its process is
    killed again. After that the others go on. Signals are deferred from the first result until the iterator is closed.

    Args:
        function: The function. It can be pickled, as can items and results. What it raises is raised here.
        items: The items by key.
        jobs: Number of processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to use instead.
        wait: Called again and again while no call ends, to show the progress.

    Yields:
        Pairs of the key of an item and its result; the result is None if the call was given up.

    Raises:
        InputError: There is no such cluster, or its workers do not fit.
        RunError: The cluster is gone.
        KeyboardInterrupt: Ctrl-C or SIGTERM came; the processes are killed. No other code of a study is interrupted.
    """
    waiting = dict(items)  # those without a result
    one_at_a_time = False
    in_this_process = dask is None and current_process().daemon
    with deferred_signals() as interruption:
        while waiting:
            submitted = dict(islice(waiting.items(), 1 if one_at_a_time or in_this_process else None))
            ended_calls = SimpleQueue[Future[Any]]()
            worker_source = _workers_at(jobs, dask, in_this_process)
            # if a process is killed, submissions and calls raise this error; those without a result are then made again
            with worker_source as workers, suppress(workers.error_if_killed):
                with _interrupts_blocked():
                    calls = {workers.submit(function, item): key for key, item in submitted.items()}
                for call in calls:
                    call.add_done_callback(ended_calls.put)
                while calls:
                    interruption.raise_if_signalled()
                    wait()
                    try:
                        call = ended_calls.get(timeout=POLL)
                    except Empty:
                        continue
                    key = calls.pop(call)
                    if not isinstance(call.exception(), workers.error_if_killed):
                        del waiting[key]
                        yield key, workers.result(call)
            # a call that was made alone and has no result has killed its process, and is given up; of several calls any
            # may have done it, so the first of them is made alone next time
            without_result = submitted.keys() & waiting.keys()
            if one_at_a_time:
                for key in without_result:
                    del waiting[key]
                    yield key, None
            one_at_a_time = bool(without_result) and not one_at_a_time


def compute_all(
    function: Callable[[Item], Result],
    items: Mapping[str, Item],
    jobs: int | None = None,
    watch: Watch = lambda progress: None,
    parts: str = "runs",
) -> dict[str, Result]:
    """Call a function on many items in parallel, as `compute` does, and return all results when the last is there.

    Args:
        function: The function. It can be pickled, as can items and results.
        items: The items by name.
        jobs: Number of processes on this machine; by default one for each core.
        watch: Called with the progress at the beginning, after every call, and from time to time meanwhile.
        parts: What the calls are, in the plural, as the progress names them.

    Returns:
        The results by name, in the order of the items.

    Raises:
        RunError: A call kills its process each time it is made.
    """
    by_name = dict[str, Result]()
    work = Work(parts, len(items), watch)
    with closing(compute(function, items, jobs, wait=work.wait)) as results:
        for name, result in results:
            if result is None:
                raise RunError(f"{name}: {LOST}: try fewer --jobs")
            by_name[name] = result
            work.advance(name)
    return {name: by_name[name] for name in items}


def _call_and_store_result(folder: str, function: Callable[[Item], Result], item: Item) -> Path:
    """Call a function, and return a file in a folder that holds its result.

    The processes of this machine share one pipe for what they return. It would be blocked for ever by one that is
    killed while it writes a result longer than the pipe; a file's name is written at once.
    """
    result = function(item)
    with NamedTemporaryFile(dir=folder, delete=False) as file:
        pickle.dump(result, file, pickle.HIGHEST_PROTOCOL)
    return Path(file.name)


def _load_stored_result(call: Future[Path]) -> Any:
    """Read what a call on this machine has stored, and remove the file."""
    path = call.result()
    result = pickle.loads(path.read_bytes())
    path.unlink()
    return result


def _workers_at(jobs: int | None, dask: str | None, in_this_process: bool) -> AbstractContextManager[Workers]:
    """Return a context that provides the processes in which calls are made.

    Args:
        jobs: Number of processes on this machine; None for one for each core.
        dask: Address of the scheduler of a Dask cluster that is used instead, if there is one.
        in_this_process: Whether this process makes the calls itself, if there is no cluster.
    """
    if dask is not None:
        return _workers_on_cluster(dask)
    if in_this_process:
        return nullcontext(Workers(_call_at_once, Future.result, TerminatedWorkerError))
    return _workers_on_this_machine(jobs or os.cpu_count() or 1)


def _call_at_once(function: Callable[[Item], Result], item: Item) -> Future[Result]:
    """Call a function at once, and return the call that has ended."""
    call = Future[Result]()
    try:
        call.set_result(function(item))
    except Exception as error:
        call.set_exception(error)
    return call


@contextmanager
def _workers_on_this_machine(jobs: int) -> Iterator[Workers]:
    """Provide processes of this machine, which wait for further calls for some time after the last one.

    Results come back as files in a temporary folder, see `_call_and_store_result`. If the caller is interrupted or
    fails, the processes are killed.

    Args:
        jobs: Number of processes.
    """
    # first start multiprocessing's tracker of resources: its start unblocks the interrupts that are blocked below
    ensure_running()
    with TemporaryDirectory(prefix="psmpc-") as folder:
        with _interrupts_blocked():
            executor = get_reusable_executor(
                jobs, timeout=IDLE, env=ONE_THREAD, initializer=begin_worker, initargs=(os.getpid(),)
            )
        try:
            yield Workers(
                partial(executor.submit, _call_and_store_result, folder), _load_stored_result, TerminatedWorkerError
            )
        except BaseException:
            executor.shutdown(kill_workers=True)
            raise


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C for the processes that are started inside, which inherit that: this process ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _workers_on_cluster(address: str) -> Iterator[Workers]:
    """Connect to a Dask cluster, and make sure that its workers compute the same as this process would.

    For this they must have the same version of psmpc, and one thread each, because sums over several threads are
    rounded differently.

    Args:
        address: Address of its scheduler, HOST:PORT.

    Yields:
        The workers of the cluster, through which calls are made.

    Raises:
        InputError: Dask is not installed, no scheduler with workers answers, or a worker has another version or more
            threads.
        RunError: The connection is lost while it is used.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError("--dask: Dask is not installed, expected the extra: pip install 'psmpc[dask]'") from None
    # silence Dask's own loggers: what they would report is in the messages here
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        if not re.search(r":\d+$", address):
            raise ValueError("expected HOST:PORT")
        client = Client(address, timeout=CONNECTING, set_as_default=False)
        client.wait_for_workers(1, timeout=CONNECTING)
    except Exception as error:  # whatever answers there
        raise InputError(
            f"--dask: found no Dask scheduler with workers at '{address}' ({' '.join(str(error).split())}); start them "
            "with: dask scheduler --host 127.0.0.1, dask worker HOST:PORT --host 127.0.0.1 --nthreads 1"
        ) from None
    with client:
        versions = client.run(resolve_name, "psmpc_cli:__version__", on_error="return")
        for worker, threads in client.nthreads().items():
            version = versions.get(worker, OSError())
            if isinstance(version, OSError):  # a worker that ended or joined just now
                continue
            if threads != 1 or version != __version__:
                raise InputError(
                    f"--dask: worker {worker} has {threads} threads and psmpc {version}, expected 1 "
                    f"(--nthreads 1; --nworkers for several calls at a time) and {__version__} as here"
                )
        try:
            yield Workers(client.get_executor(pure=False).submit, Future.result, KilledWorker)
        except CancelledError:
            raise RunError(f"the connection to the Dask scheduler at {address} was lost") from None
