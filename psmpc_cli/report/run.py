"""The report of a run: verdict, stages, figures, measurements and settings in one HTML page to read and print."""

from functools import partial

from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.style import readable
from psmpc_cli.logs.run import Run
from psmpc_cli.report.page import Page, render, versions_of
from psmpc_cli.report.texts import measure_rows, stage_rows

CAPTIONS = {
    "snapshots": "The robot at the key instants, with the targets of the stages that act.",
    "instants": "Planned switch times over time, and the actual ends of the stages.",
    "states": "Base pose and joint angles; stages are shaded, early starts dotted.",
    "velocities": "Velocities, with the limits in force.",
    "controls": "Applied accelerations, constant over each sample, with the limits in force.",
    "forces": "Generalized forces of the low-level controller.",
    "errors": "Largest errors against the current stage's target, with the tolerances of its end condition.",
    "shares": "Share of each stage in the applied control.",
    "solve_time": "Wall time of the solves.",
}
"""What the figures show, in the order of the page; a figure without a caption here has its name."""


def report_run(run: Run) -> Page:
    """Report a run on one page.

    Raises:
        LogError: The run has no samples.
    """
    motion, summary, known = run.motion, run.summary(), figures_of("run", run)
    names = [name for name in CAPTIONS if name in known] + [name for name in known if name not in CAPTIONS]
    return render(
        "run.html.j2",
        title=readable(str(run.attributes["task_name"])),
        run=run,
        end=motion.end,
        summary=summary,
        stages=stage_rows(summary),
        measures=list(measure_rows(summary, verbose=True)),
        figures={CAPTIONS.get(name, f"{readable(name)}."): partial(known[name].function, run) for name in names},
        versions=versions_of(run.attributes),
    )
