"""Pareto fronts of two stages' costs at several samples of a run. Paper section IV-B, Fig. 7."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.simulation.run import header
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.simulation.summary import task_of
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.pareto_file import write_pareto
from psmpc_cli.studies.pareto_windows import Grid, SampleFronts, SampleTask, solve_sample
from psmpc_cli.studies.runner import compute
from psmpc_cli.studies.weights import parse_stages

METHODS = ("weighted-sum", "epsilon-constraint", "both")

LOWEST, HIGHEST = 1e-3, 1e3
"""The ratios omega_2 / omega_1 lie between these."""

SAMPLES = 5
"""Samples that are looked at where none are named."""

LATER = np.linspace(0.0, 0.8, 5)
"""How much later the instant is held, as parts of what is left of the horizon, where it is a criterion of its own."""

FEWEST = 3
"""Points of a front."""

HDF5 = b"\x89HDF\r\n\x1a\n"
"""How an HDF5 file begins."""


@dataclass(frozen=True)
class Question:
    """What a Pareto study is asked.

    Attributes:
        stages: The two stages as the user named them, such as 1,2.
        at: Sampling instants [s]; none for `SAMPLES` ones, evenly from the switch's detection to the switch.
        points: Points of a front, by each method.
        method: One of `METHODS`.
        free: Whether the switching instant is a criterion of its own.
    """

    stages: str
    at: tuple[float, ...]
    points: int
    method: str
    free: bool


def parse_times(text: str | None) -> tuple[float, ...]:
    """Return the times of a list such as 6.1,8.0 [s], rising, each once; none without one.

    Raises:
        InputError: They are not finite numbers.
    """
    if text is None:
        return ()
    try:
        times = tuple(sorted({float(part) for part in text.split(",")}))
    except ValueError:
        times = (np.nan,)
    if not np.isfinite(times).all():
        raise InputError(f"--at: found '{text}', expected times in seconds between commas, such as 6.1,8.0")
    return times


def is_log(reference: str) -> bool:
    """Return whether what a user named is a file of ours rather than a task."""
    path = Path(reference)
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(HDF5)) == HDF5


def ensure_answerable(question: Question) -> None:
    """Refuse a question that no run can answer.

    Raises:
        InputError: The method is unknown, or there are too few points.
    """
    if question.method not in METHODS:
        raise InputError(f"--method: found '{question.method}', expected one of {', '.join(METHODS)}")
    if question.points < FEWEST:
        raise InputError(f"--points: found {question.points}, expected at least {FEWEST}")


def solve_pareto(
    run: Path,
    question: Question,
    path: Path,
    jobs: int | None = None,
    force: bool = False,
    done: Callable[[float, int, int], None] = lambda instant, ended, count: None,
) -> None:
    """Find the fronts at samples of a run and write them into a file, whole or not at all.

    Args:
        run: Log of the run, with its plans.
        question: What is asked.
        path: The file.
        jobs: Processes; by default one for each core.
        force: Overwrite the file.
        done: Told the instant of each sample as it is done [s], how many are, and how many there are.

    Raises:
        InputError: The question does not fit the run, or the file exists already or cannot be written.
        LogError: The log has no plans, or cannot be read.
        RunError: Processes are ended from outside again and again.
    """
    ensure_answerable(question)
    log = read_log(run)
    if not log.plans:
        raise LogError(f"{run}: holds no plans; expected a log of a task with log: {{plans: true}}")
    loaded = task_of(log)
    stages = _stages(question, loaded)
    names = [log.stage_names[stage] for stage in stages]
    grid = _grid(question)
    tasks = [SampleTask(run, sample, grid) for sample in choose_samples(log, stages, question.at)]
    found: dict[int, SampleFronts] = {}
    for index, fronts in compute(solve_sample, tasks, jobs):
        if fronts is None:
            raise RunError("a process was killed each time, perhaps for lack of memory: try fewer --jobs")
        found[index] = fronts
        done(fronts.start, len(found), len(tasks))
    attributes = {**header(build_experiment(loaded)).attributes, "method": question.method}
    attributes["stages"] = ",".join(str(stage + 1) for stage in stages)
    write_pareto(path, attributes, names, grid, [found[i] for i in range(len(tasks))], force)


def _stages(question: Question, loaded: Task) -> tuple[int, int]:
    """Return the two stages; refuse a free instant where it is given."""
    stages = parse_stages(question.stages, loaded)
    first = loaded.spec.stages[stages[0]]
    if question.free and first.at is not None:
        raise InputError(f"--free-instant: {first.name} ends at a fixed time, expected a stage with an end condition")
    return stages


def _grid(question: Question) -> Grid:
    return Grid(
        ratios=np.geomspace(LOWEST, HIGHEST, question.points),
        weighted=question.method != "epsilon-constraint",
        bounds=0 if question.method == "weighted-sum" else question.points,
        parts=LATER if question.free else LATER[:1],
        free=question.free,
    )


def possible_samples(log: Log, stages: tuple[int, int]) -> np.ndarray:
    """Return the samples whose window holds exactly the two stages and was solved (K,)."""
    alone = (log["window/first"] == stages[0]) & (log["window/count"] == 2)
    return np.flatnonzero(alone & (log["events/solve_failed"] == 0))


def choose_samples(log: Log, stages: tuple[int, int], at: Sequence[float]) -> list[int]:
    """Return the samples at these times [s]; without any, some evenly from the first to the last possible one.

    Raises:
        InputError: There is none, or none at a time.
    """
    possible = possible_samples(log, stages)
    first, second = (log.stage_names[stage] for stage in stages)
    if not len(possible):
        raise InputError(f"{log.path}: found no sample whose window holds {first} and {second} alone, expected some")
    if not at:
        places = np.linspace(0, len(possible) - 1, min(SAMPLES, len(possible)))
        return [int(sample) for sample in possible[np.round(places).astype(int)]]
    times, half = log.time[possible], float(np.asarray(log.attributes["sample_time"])) / 2
    nearest = [int(np.argmin(np.abs(times - time))) for time in at]
    for time, place in zip(at, nearest, strict=True):
        if abs(times[place] - time) > half + 1e-9:
            raise InputError(
                f"--at: found {time:g}, where no window holds {first} and {second} alone; expected times from "
                f"{times[0]:g} to {times[-1]:g} s"
            )
    return [int(possible[place]) for place in dict.fromkeys(nearest)]
