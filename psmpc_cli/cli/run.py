"""Runs and their logs: `psmpc simulate`, `rerun`, `replay`, `verify`, `show`, `plot`, `view` and `report`."""

import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli import common, options
from psmpc_cli.cli.common import echo, watched_run
from psmpc_cli.errors import InputError, RunError

if TYPE_CHECKING:
    from psmpc_cli.logs.run import Run
    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.report.pages import Page
    from psmpc_cli.simulation.verify import Peaks
    from psmpc_cli.specs.document import Change

EQUAL = 1e-6
"""Largest difference up to which a replayed solve counts as equal."""


def simulate(
    task: options.OptionalTask = None,
    output: Annotated[Path | None, options.output("runs/<task>.h5", what="Log file.")] = None,
    force: options.Force = False,
    changes: options.Changes = None,
    controller: Annotated[
        str | None,
        typer.Option(metavar="psmpc|smpc|hard|htmpc", help="Controller; short for --set controller.kind=..."),
    ] = None,
    plant: Annotated[
        str | None, typer.Option(metavar="ideal|rk4|mujoco", help="Plant; short for --set plant.kind=...")
    ] = None,
    figures: options.Figures = True,
    render: options.Render = False,
    view: Annotated[bool, typer.Option("--view", help="Write the interactive page of `psmpc view` as well.")] = False,
    open_it: Annotated[bool, typer.Option("--open", help="Write that page and open it in the browser.")] = False,
    keep_going: Annotated[
        bool,
        typer.Option("--keep-going", help="Go on to the time limit even if the object is missed or lost for good."),
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Read the task file again when it changes, and take its new targets.")
    ] = False,
    unfinished: Annotated[
        Path | None, typer.Option("--continue", metavar="LOG", help="Complete an interrupted run, by repeating it.")
    ] = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run a task in closed loop and write its log and figures."""
    common.ensure_not_both(quiet, verbose)
    view = view or open_it
    if verbose:
        logging.getLogger("psmpc_cli").setLevel(logging.INFO)
    overrides = _overrides(changes or [], {"controller": controller, "plant": plant})
    films = ("render",) if render else ()
    if task is not None and unfinished is None:
        common.validate(task, overrides)
    from psmpc_cli.cli.contents import present
    from psmpc_cli.figures.animation import offscreen_driver
    from psmpc_cli.logs.schema import RUN
    from psmpc_cli.ocp.feasibility.checks import load_task
    from psmpc_cli.simulation.follow import FollowedTask
    from psmpc_cli.simulation.run import simulate as run_task
    from psmpc_cli.specs.library import find

    if unfinished is not None:
        if task or overrides or keep_going or follow:
            wanted = "expected no task, --set, --controller, --plant, --keep-going or --follow beside it"
            raise InputError(f"--continue repeats the task in the log: {wanted}")
        path = unfinished
        if output is not None:
            path = common.output_file(output, "", RUN, force, figures, films=films, inputs=[unfinished])
    elif task is not None:
        loaded = load_task(task, overrides)
        name = "-".join(filter(None, (loaded.spec.name, controller, plant)))
        path = common.output_file(output, name, RUN, force, figures, films=films, inputs=[task])
        new_targets = FollowedTask(loaded, find("task", task), overrides) if follow else None
    else:
        raise InputError("found no task: expected a task file, a built-in name such as transport, or --continue LOG")
    page = _page_path([path], "view", force) if view else None
    if render:
        offscreen_driver()
    with watched_run(quiet) as (watch, interruption):
        if unfinished is not None:
            _finish_run(unfinished, output, watch)
        else:
            run_task(loaded, path, watch, force, keep_going=keep_going, new_targets=new_targets)
    log = present(path, figures, force or path == unfinished, quiet, verbose, films)
    if view and len(log.time):
        from psmpc_cli.report.view import view as show

        _save_page(lambda: show(log), page, [path], "view", force, open_it)
    if log.interrupted:
        raise typer.Exit(interruption.exit_code)
    _require_not_stuck(log)


def _overrides(changes: "Sequence[Change]", kinds: Mapping[str, str | None]) -> "list[Change]":
    """Return changes of a task with those that short options stand for, such as `--plant mujoco`.

    Args:
        changes: Those by `--set`.
        kinds: The chosen kinds by the names of the options; None where an option is not given.
    """
    chosen = {option: kind for option, kind in kinds.items() if kind is not None}
    return [*changes, *((f"--{option} {kind}", f"{option}.kind={kind}") for option, kind in chosen.items())]


def _require_not_stuck(run: "Run") -> None:
    """Raise RunError if a run could not go on, with what the last solve came to."""
    from psmpc_cli.solvers import Outcome

    if run.attributes["stuck"]:
        outcomes = [Outcome[str(status).upper()] for status in run["solver/status"][-1:]]
        advice = "".join(f" ({outcome.value})" for outcome in outcomes if not outcome.usable)
        raise RunError(f"{run.attributes['end_reason']}{advice}; {run.path} holds the run up to then")


def _finish_run(path: Path, output: Path | None, watch: "Callable[[Sample], None]") -> None:
    """Finish an interrupted run by running it again from its beginning, for `psmpc simulate --continue`.

    The samples in its log show whether the repeated run is the same. If it differs, the differences are printed, the
    log stays as it is, and the command ends with exit code 1 unless the whole run goes to another file.

    Args:
        path: The log of the interrupted run.
        output: Where the whole run goes; None to complete the log itself.
        watch: Called with every sample.
    """
    from psmpc_cli.cli.tables import print_differences
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.replay import continue_run

    log = read_run(path)
    comparison = continue_run(log, output, watch)
    if comparison is None or not comparison.differences:  # None after a signal
        return
    print_differences(comparison, log)
    if output is None:
        echo(
            f"{path} was not continued and is unchanged, since its run differs from it when it is repeated; "
            "with -o FILE the whole run goes to another file",
            err=True,
        )
        raise typer.Exit(1)


def rerun(
    log: options.Log,
    output: Annotated[Path | None, options.output("none", what="Keep the new log.")] = None,
    force: options.Force = False,
    strict: Annotated[bool, options.strict("anything differs")] = False,
    quiet: options.Quiet = False,
) -> None:
    """Repeat a run from its log and compare every dataset but the wall times."""
    from psmpc_cli.cli.tables import print_differences
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.replay import rerun as repeat

    loaded = read_run(log)
    with watched_run(quiet, loaded.motion.end) as (watch, interruption):
        comparison = repeat(loaded, output, force, watch)
    if comparison is None:  # a signal came
        raise typer.Exit(interruption.exit_code)
    print_differences(comparison, loaded)
    if strict and comparison.differences:
        raise typer.Exit(1)


def replay(
    log: options.Log,
    step: Annotated[int, typer.Option("--step", metavar="K", help="Number of the sample, from 0.")],
    solver: Annotated[
        str | None, typer.Option(metavar="sqp|fatrop|ipopt|adjoint", help="Default: that of the run.")
    ] = None,
) -> None:
    """Solve one horizon of a run again, from its log alone, and compare it with what was logged."""
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.replay import replay as solve_again

    run = read_run(log)
    again = solve_again(run, step, solver)
    window = again.logged.window
    kind = solver or run.task.spec.solver.kind
    stages = ", ".join(stage.name for stage in window.stages)
    echo(f"sample {step} of {len(run.time)}, {window.start:.2f} s: window of {stages}; solver {kind}")
    for remark in again.remarks:
        echo(f"note: {remark}")
    echo("\n".join(again.iterations))
    if (largest := max(window.omega)) != 1:  # solvers divide J by it
        echo(f"objective in the lines above: J over the largest priority, {largest:g}")
    rows = [(name, f"{was:.9g}", f"{now:.9g}", f"{abs(now - was):.1e}") for name, (was, now) in again.compared.items()]
    rows.append(("largest of a control in the plan", "", "", f"{again.largest_of_controls:.1e}"))
    print_table(("", "logged", "again", "difference"), rows, left_aligned=1)
    equal = f"the log is repeated to {EQUAL:g}"
    differs = f"differs from the log by up to {again.largest:.1e}"
    result = (equal if again.largest <= EQUAL else differs) + ("" if again.same_solver else ", by another solver")
    was, now = (f"{each.outcome.name.lower()} after {each.iterations}" for each in (again.logged, again.solution))
    echo(f"{result}: {was} iterations, again {now}")


def verify(
    log: options.Log,
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Integrate every N-th horizon only.")] = 1,
) -> None:
    """Integrate the full dynamics along every plan of a log and along its closed loop, with an adaptive integrator."""
    import time

    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.verify import Verification

    began = time.perf_counter()
    with common.live_line(quiet=False) as line:
        verification = Verification(read_run(log), every, line.show)
    echo(f"{verification.count} horizons, the low-level law acting at every instant")
    if verification.count:
        _print_peaks(verification.horizons)
    if verification.samples:
        echo(f"\nclosed loop, {verification.samples} samples, each from its logged state, the force held over a tick")
        _print_peaks(verification.loop)
    for remark in verification.remarks:
        echo(f"note: {remark}")
    echo(f"integrated in {time.perf_counter() - began:.1f} s")


def _print_peaks(peaks: "Peaks") -> None:
    """Print the largest deviations of the integrated motion."""
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.simulation.verify import QUANTITIES

    rows = []
    for quantity in (each for each in QUANTITIES if each in peaks):
        peak = peaks[quantity]
        value = f"{peak.value:.6f}" if quantity == "end condition" else f"{peak.value:.1e}" if peak.value else "0"
        where = (peak.where, f"{peak.time:.3f}") if peak.value else ("", "")
        rows.append((QUANTITIES[quantity], value, *where, str(peak.sample)))
    print_table(("", "largest", "of", "at [s]", "sample"), rows, left_aligned=1)


def show(
    log: options.AnyFile,
    csv: Annotated[Path | None, typer.Option(metavar="DIR", help="Export a log's tables as CSV files.")] = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Print the summary of a log or the table of a study, or export the tables of a log as CSV."""
    from psmpc_cli.cli.contents import read_contents

    contents = read_contents(log)
    if csv is None:
        contents.print(verbose)
        return
    for name, run in contents.logs().items():
        for path in run.to_csv(csv / name, force):
            echo(str(path))


def plot(
    log: options.AnyFile,
    output: Annotated[Path | None, options.output("beside the log", "DIR", "Directory of the figures.")] = None,
    formats: Annotated[
        list[str] | None, typer.Option("--format", metavar="png|pdf|svg", help="Repeatable. Default: png.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A figure that psmpc plot --help names; repeatable.")
    ] = None,
    animate: Annotated[
        bool, typer.Option("--animate", help="Add a GIF of the robot moving, an MP4 with ffmpeg.")
    ] = False,
    render: options.Render = False,
    run: options.OneRun = None,
    force: options.Force = False,
) -> None:
    """Draw the figures of a log, or of the results of any study.

    Figures of a log: snapshots, instants, states, velocities, controls, forces, errors, shares, solve_time, grasps (of
    an object), thrusters, wheels, clearance (of a task that keeps clear). Of a comparison: overlay, states, instants,
    shares, snapshots. Of a Pareto study: front, front_3d. Of a sweep: surface, heat_map (of random draws: draws),
    starts, sensitivity. Of a Monte Carlo study: success, runs.
    """
    from psmpc_cli.cli.contents import read_contents
    from psmpc_cli.figures.animation import mp4_possible
    from psmpc_cli.figures.registry import FIGURES, default_directory, draw
    from psmpc_cli.logs.schema import RUN

    films = [name for name, chosen in (("animation", animate), ("render", render)) if chosen]
    contents = read_contents(log)
    if contents.kind not in FIGURES:
        raise InputError(f"{log}: found a {contents.kind}, of which there are no figures; read it with xarray or h5py")
    kind = contents.kind
    subject = contents.value
    directory = output or default_directory(log)
    if run is not None:
        (subject,) = contents.runs([run], quiet=False).values()
        kind = RUN
        directory = output or default_directory(log) / run
    elif films:
        contents.ensure_filmable("animate" if animate else "render")
    for path in draw(kind, subject, directory, formats or ("png",), only or None, force, films):
        echo(str(path))
    if films and not mp4_possible():
        echo("psmpc: no MP4 was written: found no ffmpeg on the PATH", err=True)


def view(
    logs: Annotated[list[Path], typer.Argument(help="Logs of runs, comparisons, Monte Carlo studies.")],
    output: Annotated[Path | None, options.output("beside the first log", what="The page.")] = None,
    run: options.SomeRuns = None,
    open_it: options.Open = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Write runs as one interactive HTML page: the robot in 3-D with its plans, a time line, and linked plots."""
    from psmpc_cli.cli.contents import read_contents
    from psmpc_cli.report.view import view as show

    def page() -> "Page":
        runs: dict[str, Run] = {}
        for log in logs:
            for name, chosen in read_contents(log).runs(run or [], quiet).items():  # names may repeat between logs
                runs[name if name not in runs else f"{name} of {log.stem} {len(runs) + 1}"] = chosen
        return show(runs)

    _save_page(page, output, logs, "view", force, open_it)


def report(
    log: options.Log,
    output: Annotated[Path | None, options.output("beside the log", what="The page.")] = None,
    open_it: options.Open = False,
    force: options.Force = False,
) -> None:
    """Write a run as one HTML page to read and print: verdict, stages, figures, measurements and settings."""
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.report.pages import report_run

    _save_page(lambda: report_run(read_run(log)), output, [log], "report", force, open_it)


def _page_path(logs: Sequence[Path], kind: str, force: bool, output: Path | None = None) -> Path:
    """Choose the file of a page of logs, by default LOG-kind.html of the first or one with a number, and check it."""
    from psmpc_cli.logs.files import PAGE, check_output

    path = output or common.free_path(logs[0].with_name(f"{logs[0].stem}-{kind}.html"), force)
    check_output(path, force, PAGE, inputs=logs)
    return path


def _save_page(
    page: "Callable[[], Page]",
    output: Path | None,
    logs: Sequence[Path],
    kind: str,
    force: bool,
    open_it: bool = False,
) -> None:
    """Make and write an HTML page of logs, print where it is, and open it if asked to.

    Args:
        page: Makes the page; called once it is clear that its file can be written.
        output: Where it goes; None for LOG-kind.html beside the first log, or one with a number that is free.
        logs: The files that it shows.
        kind: `view` or `report`.
        force: Replace a page of an earlier command.
        open_it: Open it in the browser; without one a message says so.

    Raises:
        InputError: The file exists and is not to be overwritten, or cannot be written.
    """
    import webbrowser

    path = _page_path(logs, kind, force, output)
    echo(f"page: {page().save(path, force)}")
    if open_it and not webbrowser.open(path.resolve().as_uri()):
        echo("psmpc: no browser was opened: found none; set BROWSER, or open the page yourself", err=True)
