"""Many runs of a task: `psmpc compare`, `sweep-weights`, `monte-carlo` and `pareto`."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from psmpc_cli.cli import common, options
from psmpc_cli.cli.common import ending_on_signals, live_line, watched_run
from psmpc_cli.errors import InputError, RunError

if TYPE_CHECKING:
    from psmpc_cli.studies.runner import Study

WITH_WINDOWS = ("log.plans=true", "log.shares=false")
"""Changes of a task whose windows are studied: the log holds the windows, and no more than is needed."""


def compare(
    task: options.Task,
    controllers: Annotated[
        str, typer.Option(metavar="KIND,...", help="Some of psmpc, smpc, htmpc, hard; the first is the reference.")
    ] = "psmpc,smpc,htmpc,hard",
    own_settings: Annotated[
        bool,
        typer.Option(
            "--own-settings", help="Apply all of by_controller. Default: equal weights, tolerances and limits."
        ),
    ] = False,
    output: Annotated[Path | None, options.output("runs/<task>-comparison.h5", what="File of all logs.")] = None,
    force: options.Force = False,
    changes: options.Changes = None,
    jobs: options.Jobs = None,
    figures: options.Figures = True,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run several controllers on one task: print one table, write one file of logs and figures."""
    common.ensure_not_both(quiet, verbose)
    common.validate(task, changes)
    from psmpc_cli.cli.contents import present
    from psmpc_cli.logs.schema import COMPARISON
    from psmpc_cli.studies.compare import compared_tasks, run_tasks

    tasks = compared_tasks(task, re.findall(r"[^\s,]+", controllers), changes or [], own_settings)
    name = next(iter(tasks.values())).spec.name
    path = common.output_file(output, f"{name}-comparison", COMPARISON, force, figures, inputs=[task])
    with ending_on_signals("no comparison was written"), live_line(quiet) as line:
        run_tasks(tasks, path, jobs, force, line.show)
    present(path, figures, force, quiet, verbose)


def sweep_weights(
    grid: Annotated[
        str | None, typer.Argument(help="Points of omega_1 by omega_2, such as 25x25; or a number of ratios: 49.")
    ] = None,
    task: Annotated[
        str | None, typer.Argument(help="Task, before or after the grid. Default: approach_capture.")
    ] = None,
    stages: options.Stages = "1,2",
    bounds: Annotated[str, typer.Option("--range", metavar="LOW:HIGH", help="Range of both priorities.")] = "1e-3:1e3",
    epsilon: Annotated[
        str | None, typer.Option(metavar="E,...", help="Thresholds of the actual start. Default: onset.series.")
    ] = None,
    sampling: Annotated[
        str | None, typer.Option(metavar="random:N", help="N random draws from the range instead of a grid.")
    ] = None,
    output: Annotated[Path | None, options.output("runs/<task>-sweep.h5")] = None,
    every_cell: Annotated[bool, typer.Option("--every-cell", help="Run cells of equal ratio separately.")] = False,
    resume: options.Resume = False,
    force: options.Force = False,
    changes: options.Changes = None,
    jobs: options.Jobs = None,
    dask: options.Dask = None,
    figures: options.Figures = True,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run missions under many pairs of priorities, and recommend a pair. Paper Fig. 6."""
    common.ensure_not_both(quiet, verbose)
    if grid is not None and not _is_grid(grid):
        grid, task = task, grid  # the two arguments may come in any order
    if task is not None:
        common.validate(task, changes)
    from psmpc_cli.studies import sweep
    from psmpc_cli.studies.sampling import parse_numbers, parse_sampling

    expected = "positive numbers between commas, such as 1e-3,1e-2,0.1"
    epsilons = parse_numbers("--epsilon", epsilon, expected, above=0.0) if epsilon is not None else ()
    loaded = sweep.load_sweep_task(task or sweep.DEFAULT_TASK, tuple(changes or ()), epsilons)
    if (grid is None) == (sampling is None):  # both, or neither
        found = "neither a grid nor --sampling" if grid is None else "both a grid and --sampling"
        raise InputError(f"found {found}, expected one: 25x25, a number of ratios such as 49, or --sampling random:100")
    limits = parse_numbers("--range", bounds, "LOW:HIGH of positive numbers, such as 1e-3:1e3", 0.0, ":")
    cells = parse_sampling(grid or sampling or "", limits, loaded.spec.seed)
    study = sweep.weight_study(loaded, sweep.parse_stages(stages, loaded), cells, every_cell)
    _run_study(
        study,
        task or sweep.DEFAULT_TASK,
        output,
        force=force,
        resume=resume,
        jobs=jobs,
        dask=dask,
        figures=figures,
        quiet=quiet,
        verbose=verbose,
    )


def _is_grid(text: str) -> bool:
    """Return whether a text is meant as a grid or a number of ratios, and not as a task."""
    is_file = text.endswith((".yaml", ".yml")) or "/" in text
    return bool(re.match(r"\s*[-+]?\d", text)) and not is_file


def monte_carlo(
    task: Annotated[str, typer.Argument(help="Task file or built-in task, with an uncertainty.")],
    runs: Annotated[int, typer.Option(min=1, max=100_000, metavar="N", help="Runs, each with its own seed.")],
    output: Annotated[Path | None, options.output("runs/<task>-monte-carlo.h5")] = None,
    resume: options.Resume = False,
    force: options.Force = False,
    changes: options.Changes = None,
    jobs: options.Jobs = None,
    dask: options.Dask = None,
    figures: options.Figures = True,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run a task many times with other seeds for its uncertainty, and count how often it succeeds."""
    common.ensure_not_both(quiet, verbose)
    common.validate(task, changes)
    from psmpc_cli.studies.monte_carlo import monte_carlo_study

    study = monte_carlo_study(task, runs, tuple(changes or ()))
    _run_study(
        study,
        task,
        output,
        force=force,
        resume=resume,
        jobs=jobs,
        dask=dask,
        figures=figures,
        quiet=quiet,
        verbose=verbose,
    )


def _run_study(
    study: "Study",
    task: str,
    output: Path | None,
    *,
    force: bool,
    resume: bool,
    jobs: int | None,
    dask: str | None,
    figures: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Run a study into its file, show its progress, and print and draw its results.

    After a signal the file keeps the cells that were done, and --resume continues with the others.

    Args:
        study: The cells to run, each the task with other settings, and the quantities to keep of each run.
        task: The task file or the name of the built-in task, which the output must not overwrite.
        output: The file of results; None for runs/TASK-KIND.h5.
        force: Replace files of an earlier command.
        resume: Continue the study in its file.
        jobs: Number of processes at once; None for one a core.
        dask: Address of the scheduler of a Dask cluster that runs the cells instead.
        figures: Whether figures are drawn.
        quiet: Whether neither progress nor results are printed.
        verbose: Whether all that was measured is printed.

    Raises:
        InputError: Options exclude each other, or the file cannot be written.
    """
    from psmpc_cli.cli.contents import present
    from psmpc_cli.studies.runner import run_study

    if resume and force:
        raise InputError("found both --resume and --force, expected at most one of them")
    if jobs is not None and dask is not None:
        raise InputError("found both --jobs and --dask, expected at most one: a cluster has as many workers as it has")
    name = f"{study.task.spec.name}-{study.kind}"
    path = common.output_file(output, name, study.kind, force, figures, resume, inputs=[task])
    with ending_on_signals(f"{path} holds what was done: continue with --resume"), live_line(quiet) as line:
        run_study(study, path, jobs, dask, force, resume, line.show)
    present(path, figures, force or resume, quiet, verbose)


def pareto(
    task: Annotated[
        str, typer.Argument(help="Task file, the name of a built-in task, or the log of a run with its plans.")
    ] = "approach_capture",
    stages: options.Stages = "1,2",
    at: Annotated[
        str | None, typer.Option(metavar="T,...", help="Samples [s]. Default: five, from detection to the switch.")
    ] = None,
    points: Annotated[int, typer.Option(min=3, metavar="N", help="Points of each front, by each method.")] = 25,
    method: Annotated[
        Literal["weighted-sum", "epsilon-constraint", "both"], typer.Option(help="How the points are found.")
    ] = "both",
    free_instant: Annotated[
        bool, typer.Option("--free-instant", help="Let the switch time vary too, as a third criterion.")
    ] = False,
    output: Annotated[Path | None, options.output("runs/<task>-pareto.h5")] = None,
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="Keep the log of the closed loop here.")] = None,
    force: options.Force = False,
    changes: options.Changes = None,
    jobs: options.Jobs = None,
    figures: options.Figures = True,
    quiet: options.Quiet = False,
) -> None:
    """Compute Pareto fronts of the costs of two stages, at several samples of a run. Paper Fig. 7."""
    from h5py import is_hdf5

    file = Path(task)
    is_log = file.is_file() and file.stat().st_size > 0 and is_hdf5(file)  # files of the kernel have no size
    if not is_log:
        common.validate(task, changes)
    from psmpc_cli.cli.contents import present
    from psmpc_cli.logs.files import check_output
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.logs.schema import PARETO
    from psmpc_cli.ocp.feasibility.checks import load_task
    from psmpc_cli.simulation.run import simulate
    from psmpc_cli.studies.pareto import ParetoSettings, solve_pareto
    from psmpc_cli.studies.sampling import parse_numbers
    from psmpc_cli.studies.sweep import parse_stages

    times = parse_numbers("--at", at, "times in seconds between commas, such as 6.1,8.0") if at is not None else ()
    settings = ParetoSettings(stages, times, points, method, free_instant)
    run = read_run(task) if is_log else None
    if run is not None and (changes or log is not None):
        raise InputError(f"{task} is the log of a run: it is studied as it ran, without --set and --log")
    loaded = load_task(task, [*(changes or []), *WITH_WINDOWS]) if run is None else run.task
    parse_stages(stages, loaded)
    path = common.output_file(output, f"{loaded.spec.name}-pareto", PARETO, force, figures, inputs=[task])
    if log is not None:
        check_output(log, force, option="--log", inputs=[task])
        if log.resolve() == path.resolve():
            raise InputError(f"found {log} after both -o and --log, expected different files")

    with ending_on_signals("no results were written"):
        if run is None:
            with watched_run(quiet) as (watch, interruption):
                run = simulate(loaded, log, watch, force=True)
            interruption.raise_if_signalled()
            if run.attributes["stuck"]:
                raise RunError(f"the closed loop could not go on: {run.attributes['end_reason']}")
        with live_line(quiet) as line:
            solve_pareto(run, settings, path, jobs, force, line.show)
    present(path, figures, force, quiet)
