"""One run of a Monte Carlo study: the task with a seed of its own, in closed loop to its end, without a log."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.summary import LimitSummary, Summary, end_errors, summarize
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.studies.cell import Outcome, outcome_of
from psmpc_cli.studies.tally import Values


@dataclass(frozen=True, eq=False)
class Run:
    """What a run needs: the task, and the seed it has here."""

    task: Task
    seed: int


def run_once(run: Run) -> Outcome:
    """Make a run; whatever goes wrong in it is its outcome."""
    return outcome_of(partial(_run, run))


def _run(run: Run) -> tuple[Values, str]:
    """Return the numbers of a run; a mission that fails is no failure to measure it."""
    task, changes = run.task, [f"seed={run.seed}", "log.plans=false", "log.ticks=false"]
    log = simulate(parse_task(task.task_yaml, task.robot_yaml, task.spec.name, changes))
    summary = summarize(log)
    return run_values(summary, end_errors(log)[1]), ""


def run_values(summary: Summary, final_error: float) -> Values:
    """Return a run's numbers by the names of `RUN_QUANTITIES`."""
    monitors = {"monitor_margin": np.array([verdict.margin for verdict in summary.monitors])}
    return {
        "completed": int(summary.completed),
        "succeeded": int(summary.succeeded),
        "reason": summary.reason,
        "end_time": summary.duration,
        "switch_time": np.array([stage.switch_time for stage in summary.stages]),
        "actual_start": np.array([stage.actual_start for stage in summary.stages]),
        "final_error": final_error,
        **_margins({limit.kind: limit for limit in summary.limits}),
        **(monitors if summary.monitors else {}),
        "fallbacks": summary.fallbacks,
        "unmeasured": summary.unmeasured,
        "control_effort": summary.control_effort,
    }


def _margins(tightest: Mapping[str, LimitSummary]) -> dict[str, float]:
    """Return the tightest margins, as they are and over half the limits' distance; none without such limits."""
    found = {}
    for kind, limit in tightest.items():
        found[f"{kind}_margin"], found[f"relative_{kind}_margin"] = limit.margin, limit.relative
    return found
