"""A whole run in memory, from its log or straight from a simulation."""

import csv
import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from psmpc_cli.errors import InputError, LogError, SpecError
from psmpc_cli.logs.conditions import ALWAYS
from psmpc_cli.logs.files import (
    TABLE,
    check_output,
    kind_of,
    new_image,
    read_array,
    read_attributes,
    read_file,
    write_new,
)
from psmpc_cli.logs.schema import (
    COLUMN_UNITS,
    COMPARISON,
    KEEP_GOING,
    NEW_TARGETS,
    Q_COORDINATE,
    RUN,
    Column,
    columns,
    condition_of,
    layout,
    sliding_of,
    units_of_columns,
)
from psmpc_cli.logs.summary import Summary, early_starts
from psmpc_cli.logs.verdicts import samples_of_returns
from psmpc_cli.logs.walk import RUNS, unexpected_item
from psmpc_cli.logs.write import create_log
from psmpc_cli.ocp.problem import ObjectState, Problem, build_problem
from psmpc_cli.ocp.reference import Trajectory
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.specs.arguments import as_path, rejected, require
from psmpc_cli.specs.document import quoted
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.robots.robot import labels

if TYPE_CHECKING:
    import xarray

Array = np.ndarray

IN_MEMORY = Path("a run in memory")
"""Path of a run without a file."""

ATTRIBUTES: Mapping[str, type] = {
    **dict.fromkeys(("finished", "stuck"), np.bool_),
    **dict.fromkeys(("end_reason", "controller", "task_name", "task_yaml", "robot_yaml"), str),
}
"""Attributes that every log has, and what they are."""


@dataclass(frozen=True)
class Span:
    """The time in which a stage was the current one [s]; a stage to which the sequence returned has several.

    Attributes:
        index, name: The stage.
        start, end: First and last instant; for a stage that did not end, the end of the run, or when the sequence
            returned to an earlier stage.
        early: Its actual start if that lies before `start` and it goes on acting (`early_starts`), else None.
    """

    index: int
    name: str
    start: float
    end: float
    early: float | None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a run at its samples and, if the run ended, at its end: N times.

    Attributes:
        time: Times (N,) [s].
        Q: Coordinates (N, nq) [m, rad].
        v: Velocities (N, n) [m/s, rad/s].
        xi: Poses of base and end-effectors (N, m) [m, rad].
        Q_seen, v_seen: The state that the controller saw (N, nq), (N, n): measured, or predicted over a known delay.
    """

    time: Array
    Q: Array
    v: Array
    xi: Array
    Q_seen: Array
    v_seen: Array

    def __repr__(self) -> str:
        return f"<Motion: {len(self.time)} times from {self.time[0]:g} s to {self.end:g} s>"

    @property
    def end(self) -> float:
        """Last time [s]."""
        return float(self.time[-1])

    def poses_at(self, time: Array) -> Array:
        """Interpolate the poses (K, m) [m, rad] at times (K,) [s]."""
        return self._at(time, self.xi, range(3, self.xi.shape[1], 7))

    def coordinates_at(self, time: float) -> Array:
        """Interpolate the coordinates (nq,) [m, rad] at a time [s]."""
        return np.asarray(self._at(np.array([time]), self.Q, (3,))[0])

    def _at(self, time: Array, values: Array, quaternions: Iterable[int]) -> Array:
        """Interpolate values (N, columns) at times (K,) [s]; the quaternions of a spatial robot stay of length 1.

        Args:
            time: The times.
            values: The values, one row a time of the motion.
            quaternions: First columns of the quaternions.
        """
        interpolated = np.column_stack([np.interp(time, self.time, column) for column in values.T])
        for first in quaternions if self.Q.shape[1] > self.v.shape[1] else ():
            interpolated[:, first : first + 4] /= np.linalg.norm(
                interpolated[:, first : first + 4], axis=1, keepdims=True
            )
        return interpolated


@dataclass(frozen=True)
class ChangeOfTarget:
    """A stage has another target from a sample on.

    Attributes:
        time: Of the sample [s].
        stage: Name of the stage.
        target: The target as a task file has it.
    """

    time: float
    stage: str
    target: Any


@dataclass(frozen=True, eq=False)
class Run:
    """A whole run in memory, with K samples, nq coordinates, n velocities, m pose coordinates and S stages.

    In the plane nq is n. In space Q has position, unit quaternion (w, x, y, z) and joints, and a pose 7 coordinates.

    `run["window/instants"]` is the array of a dataset of the log; docs/log.md lists them.

    Attributes:
        path: The file, or `IN_MEMORY`.
        attributes: Versions, effective texts of task and robot, `finished`, `end_reason`, ...
        arrays: Every dataset by its path.
    """

    path: Path
    attributes: Mapping[str, Any]
    arrays: Mapping[str, Array]

    def __repr__(self) -> str:
        name = f"{self.attributes['task_name']} under {self.attributes['controller']}"
        size = f"{len(self.time)} samples, {len(self.stage_names)} stages"
        return f"<Run of {name}: {size}; {self.attributes['end_reason'] or 'not ended'}>"

    def __getitem__(self, path: str) -> Array:
        """Return the array of a dataset.

        Raises:
            KeyError: The log has none of this path.
        """
        if path not in self.arrays:
            condition = condition_of(path)
            why = "no log has one" if condition is None else f"logs have it {condition.description}"
            raise KeyError(f"{self.path}: found no dataset {path}; {why}")
        return self.arrays[path]

    def __contains__(self, path: str) -> bool:
        return path in self.arrays

    @property
    def time(self) -> Array:
        """Times of the samples (K,) [s]."""
        return self["time"]

    @property
    def Q(self) -> Array:
        """True coordinates at the samples (K, nq) [m, rad]."""
        return self.arrays.get("state/Q_true", self["state/Q"])

    @property
    def v(self) -> Array:
        """True velocities at the samples (K, n) [m/s, rad/s]."""
        return self.arrays.get("state/Qdot_true", self["state/Qdot"])

    @property
    def u(self) -> Array:
        """Acceleration over the first tick of each sample (K, n) [m/s^2, rad/s^2]."""
        return self["control/u"]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the n coordinates of v."""
        return tuple(self["coordinate"].tolist())

    @property
    def Q_coordinates(self) -> tuple[str, ...]:
        """Names of the nq coordinates of Q."""
        return tuple(self[Q_COORDINATE].tolist()) if self.Q_has_a_scale else self.coordinates

    @property
    def Q_has_a_scale(self) -> bool:
        """Whether the robot moves in space."""
        return Q_COORDINATE in self.arrays

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Names of the S stages."""
        return tuple(self["stages/name"].tolist())

    @property
    def stages(self) -> dict[str, Array]:
        """Table of the stages: name, priority, switch_time [s], actual_start [s] and early (S,).

        Also epsilon (E,), and actual_start_by_epsilon (S, E) [s]. A time is NaN if it never came.
        """
        return self._datasets_in("stages")

    @property
    def monitors(self) -> dict[str, Array]:
        """Table of the monitors: name, held (-1 if unknown), margin [m, m/s]."""
        return self._datasets_in("monitors")

    @property
    def ticks(self) -> dict[str, Array]:
        """Low-level ticks: time (M,) [s], Q (M, nq), v, F (M, n); empty unless the task logs them."""
        return {"v" if name == "Qdot" else name: values for name, values in self._datasets_in("ticks").items()}

    @property
    def final(self) -> dict[str, Array]:
        """State at the end of the run: time [s], Q, v and xi; NaN if the run did not end."""
        Q, v = (self.arrays.get(f"final/{name}_true", self[f"final/{name}"]) for name in ("Q", "Qdot"))
        return {"time": self["final/end_time"], "Q": Q, "v": v, "xi": self["final/xi"]}

    @property
    def keeps_going(self) -> bool:
        """Whether a mission that could no longer succeed went on, as all did before logs had an attribute for it."""
        return bool(self.attributes.get(KEEP_GOING, True))

    @property
    def has_plans(self) -> bool:
        """Whether the run has plans, see `plan`."""
        return "plan/solution" in self.arrays

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped from outside, or still runs."""
        return not np.isfinite(self["final/end_time"])

    @cached_property
    def task(self) -> Task:
        """The task as it ran, parsed from the texts of task and robot in the log; checked to be that of the datasets.

        If somebody edited these texts, figures and summaries would mix two tasks. So the digest, and the names of
        coordinates and stages, have to be those of the datasets.

        Raises:
            LogError: The texts in the log are not a task and a robot of this version, or not those of this run.
        """
        task_yaml, robot_yaml, name = (str(self.attributes[key]) for key in ("task_yaml", "robot_yaml", "task_name"))
        try:
            task = parse_task(task_yaml, robot_yaml, name)
        except SpecError as error:
            raise LogError(f"{self.path}: the task or robot in it is not valid in this version:\n{error}") from None
        if self.attributes.get("digest", task.digest) != task.digest:
            raise LogError(f"{self.path}: the task and robot in it do not describe the run it holds")
        stage_names = tuple(stage.name for stage in task.spec.stages)
        coordinate_names = labels(task.robot, "joint")
        expected_names = {"coordinate": coordinate_names, "stage": stage_names, "stages/name": stage_names}
        for path, names_in_task in expected_names.items():
            names_in_log = tuple(self[path].tolist())
            if names_in_log != names_in_task:
                raise LogError(
                    f"{self.path}: /{path}: found {', '.join(names_in_log)}, "
                    f"expected {', '.join(names_in_task)} as its task has"
                )
        return task

    @cached_property
    def problem(self) -> Problem:
        """The computable problem of the task.

        Raises:
            LogError: As for `task`.
        """
        return build_problem(self.task)

    @cached_property
    def changes_of_targets(self) -> tuple[ChangeOfTarget, ...]:
        """The targets that changed while the run went on, by time.

        Raises:
            LogError: The log does not say them as it should.
        """
        try:
            return tuple(ChangeOfTarget(**each) for each in json.loads(self.attributes.get(NEW_TARGETS, "[]")))
        except (TypeError, ValueError):
            wanted = "a list of mappings with time, stage and target"
            raise LogError(f"{self.path}: attribute {NEW_TARGETS}: expected {wanted}") from None

    @property
    def new_targets(self) -> Callable[[float], dict[str, Any]] | None:
        """What tells at each sample which targets changed then, as `simulate` takes it; None where none could."""
        if NEW_TARGETS not in self.attributes:
            return None
        return lambda time: {each.stage: each.target for each in self.changes_of_targets if each.time == time}

    def problem_at(self, time: float) -> Problem:
        """Return the problem with the targets that were in force at a time [s].

        Raises:
            LogError: As for `task`; or a target is none of its stage.
        """
        count = sum(each.time <= time for each in self.changes_of_targets)
        return self._problems[count]

    @cached_property
    def _problems(self) -> tuple[Problem, ...]:
        """The problem of the task, and with each of the changes of targets up to one."""
        problems = [self.problem]
        for each in self.changes_of_targets:
            try:
                problems.append(problems[-1].retargeted(each.stage, each.target))
            except SpecError as error:
                raise LogError(f"{self.path}: attribute {NEW_TARGETS}: {error}") from None
        return tuple(problems)

    @cached_property
    def motion(self) -> Motion:
        """The motion at the samples and at the end of the run.

        Raises:
            LogError: The run has no samples.
        """
        if not len(self.time):
            raise LogError(f"{self.path}: found no samples, expected at least one: the run ended before its first one")
        rows = [self.time, self.Q, self.v, self["pose/xi"], self["state/Q"], self["state/Qdot"]]
        if self.final["time"] > self.time[-1]:
            last = [*self.final.values(), self["final/Q"], self["final/Qdot"]]
            rows = [np.concatenate([values, end[None]]) for values, end in zip(rows, last, strict=True)]
        return Motion(*rows)

    @cached_property
    def spans(self) -> tuple[Span, ...]:
        """The time spans of all stages that were reached, in order, for figures and reports.

        A stage begins at the switch time of the one before. Plans reach beyond the switch, so that the cost of the next
        stage may change the control earlier: that is its early start. A stage of which there is only an early start has
        `start` at the end of the run. If the sequence returned to an earlier stage, after grippers missed or lost the
        object, stages occur once for each try; `stages` has the times of the last try alone.

        Raises:
            LogError: The run has no samples; or as for `task`.
        """
        earlier_spans = self._spans_of_earlier_tries
        end_of_run = self.motion.end
        start = earlier_spans[-1].end if earlier_spans else float(self.time[0])
        # the last try begins with the stage to which the sequence returned last
        first_stage = int(self["window/first"][samples_of_returns(self.arrays)[-1]]) if earlier_spans else 0
        stages = self.stages
        starts_early = early_starts(self.arrays, self.task.spec.onset.epsilon)
        spans: list[Span] = []
        for index, name in list(enumerate(self.stage_names))[first_stage:]:
            actual_start = float(stages["actual_start"][index])
            switch_time = float(stages["switch_time"][index])
            early_start = actual_start if index and starts_early[index] and actual_start < start else None
            if spans and start >= end_of_run and early_start is None:
                break  # this stage was not reached
            end = switch_time if np.isfinite(switch_time) else end_of_run
            spans.append(Span(index, name, start, end, early_start))
            start = end
        return (*earlier_spans, *spans)

    @cached_property
    def _spans_of_earlier_tries(self) -> tuple[Span, ...]:
        """The time spans of stages before the last return of the sequence to an earlier stage, in order.

        The sequence returns when grippers have missed or lost the object, or taken too long. The stage that is current
        then ends at the return. A stage that was never current at a sample has no span, and early starts are left out.
        """
        spans: list[Span] = []
        first_sample = 0  # of a try, which lasts up to the sample of the return
        for return_sample in samples_of_returns(self.arrays):
            # by stage, when it ended in this try [s]; a sample has NaN for stages that did not end since the one before
            end_times = np.fmax.reduce(
                self["window/ended_at"][first_sample : return_sample + 1], axis=0, initial=np.nan
            )
            stages_of_try = np.unique(self["window/first"][first_sample:return_sample]).tolist()
            for index in stages_of_try:
                start = spans[-1].end if spans else float(self.time[0])
                is_last = index == stages_of_try[-1]
                end = float(self.time[return_sample] if is_last else end_times[index])
                spans.append(Span(index, self.stage_names[index], start, end, early=None))
            first_sample = return_sample
        return tuple(spans)

    @cached_property
    def switches(self) -> tuple[tuple[int, float], ...]:
        """Index and switch time [s] of each stage that ended, as often as it did, in order."""
        last_return = max(samples_of_returns(self.arrays), default=0)
        ended_at = self.arrays.get("window/ended_at", np.zeros((0, 0)))[: last_return + 1]  # (samples, S)
        last_ends = self.stages["switch_time"]
        in_last_try = [(index, float(last_ends[index])) for index in np.flatnonzero(np.isfinite(last_ends)).tolist()]
        in_earlier_tries = {
            (index, float(ended_at[sample, index])) for sample, index in np.argwhere(np.isfinite(ended_at)).tolist()
        }
        return tuple(sorted({*in_earlier_tries, *in_last_try}, key=lambda switch: (switch[1], switch[0])))

    def followed(self, span: Span) -> Stage:
        """Return the stage of a span, with the target it had at its end.

        Targets relative to an object with a mass are where it was since the span's start.
        """
        problem = self.problem_at(span.end)
        stage = problem.stages[span.index]
        if not stage.on_object or "object/pose" not in self or len(self.time) < 2:
            return stage
        states = zip(self["object/pose"], self["object/velocity"], strict=True)
        values = np.array([stage.unplaced_copy().at_object(*state).target for state in states])
        path = Trajectory(self.time - span.start, values, tuple(stage.attitudes.values()))
        return replace(stage, reference=path)

    def object_state_at(self, time: float) -> ObjectState | None:
        """Return pose and velocity of an object with a mass at a time [s]; None where the log has no such object.

        Since the sample before it moves as if it was free; at the end of the run they are those of the log.
        """
        if "object/pose" not in self:
            return None
        if time >= self.final["time"]:
            return self["final/object_pose"], self["final/object_velocity"]
        sample = max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)
        state = self["object/pose"][sample], self["object/velocity"][sample]
        return body_of(self.task.spec.body).predicted(*state, time - float(self.time[sample]))

    def with_problem(self, problem: Problem) -> "Run":
        """Return the run with the problem that was run, which otherwise is built from the texts in the log."""
        run = replace(self)
        vars(run).update(task=problem.task, problem=problem)
        return run

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone, so that what is computed from them on demand is not pickled."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def summary(self) -> Summary:
        """Summarize the run.

        Raises:
            LogError: As for `task`.
        """
        return Summary(self.arrays, self.attributes, self.problem_at(np.inf))

    def plan(self, name: str, sample: int) -> Array:
        """Return one vector of a sample's solve: guess, guess_multipliers, parameters or solution.

        Raises:
            LogError: The run has no plans, or not this sample's.
        """
        if not self.has_plans:
            raise LogError(f"{self.path}: found no plans, expected the log of a task with log: {{plans: true}}")
        if not 0 <= sample < len(self.time):
            choices = f"one from 0 to {len(self.time) - 1}" if len(self.time) else "none: the log holds no samples"
            raise LogError(f"{self.path}: found no sample {sample}, expected {choices}")
        return self[f"plan/{name}"][sample, : self[f"plan/{name}_length"][sample]]

    def save(self, path: Path | str, force: bool = False) -> None:
        """Write the run into a log of its own.

        Raises:
            InputError: The path is taken (with `force`, by a file that psmpc did not write), or cannot be written.
        """
        write_new(Path(path), new_image(self.write_into), force)

    def write_into(self, group: h5py.Group) -> None:
        """Write the log of the run into an empty group of an open file."""
        present = [column for column in layout(self.Q_has_a_scale) if column.path in self.arrays]
        create_log(group, present, self.attributes, self.arrays)

    def to_csv(self, directory: Path | str, force: bool = False) -> list[Path]:
        """Export the run to tables for other programs: samples.csv and stages.csv, and ticks.csv if ticks were logged.

        Ticks are the periods of the low-level controller; a sample has several.

        Args:
            directory: Where they are written; created if necessary.
            force: Overwrite tables that are there.

        Returns:
            Their paths.

        Raises:
            InputError: A file exists already, or the directory cannot be written.
        """
        directory = Path(directory)
        tables = {
            "samples.csv": self._csv_table(along="time"),
            "stages.csv": self._csv_table(along="stage", left_out="stages/"),
        }
        if self.ticks:
            tables["ticks.csv"] = self._csv_table(along="ticks/tick", left_out="ticks/")
        paths = [directory / name for name in tables]
        for path in paths:  # before the first is written, so that all of them are or none
            check_output(path, force, kind=TABLE, option="--csv")
        for path, columns_by_heading in zip(paths, tables.values(), strict=True):
            text = StringIO(newline="")
            headings = list(columns_by_heading)
            rows = zip(*columns_by_heading.values(), strict=True)
            csv.writer(text).writerows([headings, *rows])
            write_new(path, text.getvalue().encode(), force, kind=TABLE, option="--csv")
        return paths

    def to_xarray(self) -> "xarray.Dataset":
        """Convert all datasets with a row for each sample to an xarray.Dataset, with named dimensions and units.

        Where the columns of a dataset have different units (of lengths and angles), its attribute `column_units` lists
        them.

        Raises:
            InputError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise InputError("found no xarray, which Run.to_xarray needs: pip install xarray") from None
        sampled_columns = self._columns_along("time")
        variables: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]] = {}
        for column in sampled_columns:
            attributes: dict[str, Any] = {"units": column.units, "long_name": column.long_name}
            if len(column.dims) == 2 and len({*self._units_of_columns(column)}) > 1:
                attributes[COLUMN_UNITS] = self._units_of_columns(column)
            variables[column.path] = (column.dims, self[column.path], attributes)
        coordinates = {dim: self[dim] for column in sampled_columns for dim in column.dims}
        return xarray.Dataset(variables, coordinates, dict(self.attributes))

    def _datasets_in(self, group: str) -> dict[str, Array]:
        """Return the datasets of a group of the log by their names in it."""
        paths = [path for path in self.arrays if path.startswith(f"{group}/")]
        return {path.removeprefix(f"{group}/"): self.arrays[path] for path in paths}

    def _columns_along(self, dim: str) -> tuple[Column, ...]:
        """Return the datasets that the run has along a dimension and that fit into a table: equal rows, no scale."""
        defined = columns(dim, self.Q_has_a_scale)
        return tuple(column for column in defined if column.path in self.arrays and not column.ragged)

    def _units_of_columns(self, column: Column) -> list[str]:
        """Return the unit of each column of a dataset of two dimensions."""
        names = self[column.dims[-1]].tolist()
        return units_of_columns(column, names, sliding_of(self.attributes)) or [column.units] * len(names)

    def _csv_table(self, along: str, left_out: str = "") -> dict[str, Array]:
        """Collect all datasets along one dimension as the columns of a CSV table.

        A dataset with more dimensions becomes a column for each element of its rows, which the heading names:
        `state/Q/base.x [m]`.

        Args:
            along: Path of the scale of the dimension, such as `time`.
            left_out: Beginning of paths that headings leave out.

        Returns:
            One-dimensional columns of equal length, by heading.
        """
        table = {"time [s]": self.time} if along == "time" else {}
        for column in self._columns_along(along):
            name = column.path.removeprefix(left_out)
            values = self[column.path]
            if values.ndim == 1:
                table[_heading(name, column.units)] = values
                continue
            units = self._units_of_columns(column) if values.ndim == 2 else [column.units] * values.shape[1]
            for index in np.ndindex(values.shape[1:]):
                labels_of_element = (
                    self[scale][position] for scale, position in zip(column.dims[1:], index, strict=True)
                )
                texts = (label if isinstance(label, str) else f"{label:g}" for label in labels_of_element)
                table[_heading("/".join([name, *texts]), units[index[0]])] = values[:, *index]
        return table


def _heading(name: str, unit: str) -> str:
    """Return the heading of a column of a CSV table: its name, and its unit if it has one."""
    return name if unit == "1" else f"{name} [{unit}]"


def read_run(path: Path | str) -> Run:
    """Read the log of a run, finished or cut short by a kill.

    Raises:
        LogError: The file is missing, damaged, of another program or version, or not the log of one run.
    """
    path = as_path("path", path)
    return read_file(path, lambda file: run_in(file, path), kind=RUN)


RunOrPath = Run | Path | str
"""A run, or the path of its log."""


def resolve_runs(runs: RunOrPath | Mapping[str, RunOrPath]) -> Run | dict[str, Run]:
    """Return runs for what a public function was given: runs in memory as they are, paths read from their files.

    Args:
        runs: A run, the path of its log or of a comparison, or several runs by name, each as a run or a path.

    Returns:
        A run for a run or the path of its log; else several by name.

    Raises:
        InputError: It is none of these, or a mapping of no runs.
        LogError: As for `read_run`, of a file that a path leads to.
    """
    wanted = "a Run, the path of its log, or a mapping of names to at least one of them"
    require("run", runs, (Run, str, PathLike, Mapping), wanted)
    if isinstance(runs, Run):
        return runs
    if not isinstance(runs, Mapping):
        path = as_path("run", runs)
        return read_comparison(path) if kind_of(path) == COMPARISON else read_run(path)
    if not runs:
        raise rejected("run", runs, wanted)
    by_name = {}
    for name, run in runs.items():
        require("run", name, str, wanted)
        require(f"run of {quoted(name)}", run, (Run, str, PathLike), "a Run, or the path of its log")
        by_name[name] = run if isinstance(run, Run) else read_run(run)
    return by_name


def read_comparison(path: Path) -> dict[str, Run]:
    """Read a file with several runs of a comparison; return them by name, in the order in which they were compared.

    Raises:
        LogError: As for `read_run`; or the file is no comparison.
    """

    def read_open(file: h5py.File) -> dict[str, Run]:
        names = file.attrs[RUNS].tolist()  # in the order of the comparison, which the groups do not have
        groups = file[RUNS]
        # there is nothing beside the groups, and none has a name that HDF5 takes for the group itself or the one above
        if sorted(names) != sorted(groups) or not names or {".", ".."} & {*names} or len(file) > 1:
            found = f"the groups {', '.join(groups)}"
            raise unexpected_item(file, found, "one for each run", at=f" attribute {RUNS}")
        return {name: run_in(groups[name], path) for name in names}

    return read_file(path, read_open, "a comparison written by psmpc compare", COMPARISON)


def run_in(group: h5py.Group, path: Path = IN_MEMORY) -> Run:
    """Read a run from a group of an open HDF5 file, checked against the schema of logs.

    Which datasets a log has depends on the run: those of a condition (the robot has wheels, ticks are logged, ...) are
    there all together, or none of them. Datasets that are newer than the file's format are filled with their value for
    "unknown".

    Args:
        group: The group; the root of a log, or a run in a comparison.
        path: The file, for messages.

    Returns:
        The run, with all of its arrays in memory.

    Raises:
        LogError: The group is not as the schema has it.
        Exception: One of `files.DAMAGE`: it is damaged.
    """
    attributes = read_attributes(group)
    if missing := [name for name in ATTRIBUTES if name not in attributes]:
        raise ValueError(f"no attribute {', '.join(missing)}")
    for name, type_of_attribute in ATTRIBUTES.items():
        if not isinstance(attributes[name], type_of_attribute):
            raise unexpected_item(
                group, repr(attributes[name]), f"a {type_of_attribute.__name__}", f" attribute {name}"
            )
    members: list[str] = []  # paths of all groups and datasets
    group.visit(members.append)
    columns = layout(Q_COORDINATE in members)
    # a condition holds if one of its datasets is there; then all of them have to be
    conditions = {ALWAYS, *(column.only for column in columns if column.path in members)}
    columns_of_log = [part for column in columns if column.only in conditions for part in column.parts]
    format_version = int(group.file.attrs["format_version"])
    columns_of_format = [column for column in columns_of_log if column.since <= format_version]
    datasets = _open_datasets(group, members, columns_of_format)
    arrays = {path: read_array(dataset) for path, dataset in datasets.items()}
    for column in columns_of_log:
        if column.path not in arrays:
            arrays[column.path] = np.full([len(arrays[dim]) for dim in column.dims], column.unknown)
    _require_consistent_values(group, arrays)
    return Run(path, attributes, arrays)


def _open_datasets(group: h5py.Group, members: Collection[str], expected: Iterable[Column]) -> dict[str, h5py.Dataset]:
    """Open the datasets of a log, and check that they are exactly those of the schema, with its types and shapes.

    All are checked before any is read, so that a file of another program is found at once. A dataset is as long as the
    scales of its dimensions, which are datasets themselves.

    Args:
        group: The group of the run.
        members: Paths of all that is in it.
        expected: The datasets that a log of such a run has.

    Returns:
        The datasets by path.

    Raises:
        LogError: One is unknown, of another type, or of another shape.
    """
    columns_by_path = {column.path: column for column in expected}
    group_paths = {path.rpartition("/")[0] for path in columns_by_path}
    unknown_paths = [path for path in members if path not in columns_by_path and path not in group_paths]
    if unknown_paths:
        first_unknown = group[unknown_paths[0]]
        raise unexpected_item(first_unknown, "a dataset or group that no such log has", "those of docs/log.md")
    datasets = {path: group[path] for path in columns_by_path}
    scale_lengths = {path: len(datasets[path]) for path, column in columns_by_path.items() if column.is_scale}
    for path, column in columns_by_path.items():
        dataset = datasets[path]
        shape = tuple(scale_lengths[dim] for dim in column.dims)
        dtype = h5py.string_dtype() if column.dtype == "text" else np.dtype(column.dtype)
        if not isinstance(dataset, h5py.Dataset) or (dataset.shape, dataset.dtype) != (shape, dtype):
            raise unexpected_item(dataset, str(dataset), f"a dataset of type {column.dtype} with shape {shape}")
    return datasets


def _require_consistent_values(group: h5py.Group, arrays: Mapping[str, Array]) -> None:
    """Make sure that times rise, and that indices and lengths lie within the arrays that they refer to.

    Whoever reads the log relies on it: with an index beyond an array, figures and summaries would fail in the middle.

    Args:
        group: The group of the run, for messages.
        arrays: Its datasets by path.

    Raises:
        LogError: Times do not rise, or an index or a length is beyond its array.
    """
    stages = len(arrays["stage"])
    # the largest value of each index or length: of the first stage in a window, of the number of stages from it on, and
    # of the length of a row with a length of its own
    largest_allowed = {"window/first": stages - 1, "window/count": stages - arrays["window/first"]}
    for path, values in arrays.items():
        if f"{path}_length" in arrays:
            largest_allowed[f"{path}_length"] = values.shape[1]
    for path, most in largest_allowed.items():
        if ((arrays[path] < 0) | (arrays[path] > most)).any():
            raise unexpected_item(group[path], "an index or a length beyond what it is of", "none")
    for path in ("time", "ticks/time"):
        time = arrays.get(path, np.zeros(0))
        if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
            raise unexpected_item(group[path], "times that do not rise", "each after the one before")
