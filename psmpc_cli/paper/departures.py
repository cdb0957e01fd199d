"""What tells the shipped transport task from the printed one, departure by departure."""

from dataclasses import dataclass

from psmpc_cli.specs.controller import AS_PRINTED, ControllerSpec
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_task

SHIPPED = "transport"
"""The built-in task of the claims, with our departures from the paper."""

PRINTED = "transport_as_printed"
"""The same as the paper prints it; what the paper leaves open is the same in both."""


@dataclass(frozen=True)
class Departure:
    """One difference between the two tasks.

    Attributes:
        name: What differs, as we have it.
        as_paper: The same as the paper has it.
        printed, shipped: The keys of a task in which it does, each `path=value`, with the values of either task.
    """

    name: str
    as_paper: str
    printed: tuple[str, ...]
    shipped: tuple[str, ...]


def _of_controller(key: str, name: str, as_paper: str) -> Departure:
    """Return the departure that a key of the controller takes back; `as_printed` has the printed value."""
    shipped = getattr(ControllerSpec(), key)
    return Departure(name, as_paper, (f"controller.{key}={AS_PRINTED[key]}",), (f"controller.{key}={shipped}",))


_ENDS = tuple(f"stages.{stage}.ends_when.coordinates=" for stage in ("approach", "transport"))
_ONSETS = {"approach": "base", "capture": "arms", "transport": "base", "release": "arms"}

DEPARTURES = (
    _of_controller("normalization", "the nadir alone in (12)", "the range in (12)"),
    _of_controller("normalization_at", "costs read at samples in (12)", "costs read at nodes in (12)"),
    _of_controller("pending_cost", "the pending cost in (16)", "no pending cost in (16)"),
    _of_controller("discretization", "the exact step in (20)", "Euler's step in (20)"),
    _of_controller("detection_margin", "the detection margin", "no detection margin"),
    Departure(
        "one iteration of sqp a sample", "every window solved to convergence", ("solver=fatrop",), ("solver=sqp",)
    ),
    Departure(
        "Approach and Transport ending by the base alone",
        "Approach and Transport ending by all coordinates",
        tuple(f"{key}all" for key in _ENDS),
        tuple(f"{key}base" for key in _ENDS),
    ),
    Departure(
        "starts by closeness 0.5",
        "starts by the control, 1e-4",
        (
            "onset={kind: control, epsilon: 1e-4, series: [1e-4, 1e-3, 0.01, 0.1]}",
            *(f"stages.{stage}.onset=null" for stage in _ONSETS),
        ),
        (
            "onset={kind: closeness, epsilon: 0.5, series: [0.1, 0.25, 0.75]}",
            *(f"stages.{stage}.onset={part}" for stage, part in _ONSETS.items()),
        ),
    ),
)
"""All differences between the two tasks under PSMPC and SMPC, but for their texts."""

CONTROLLER_AS_PRINTED = tuple(change for departure in DEPARTURES[: len(AS_PRINTED)] for change in departure.printed)
"""What `as_printed` sets, as changes of a task that gives some of these keys itself."""


def load_variant(base: str, departure: Departure | None, changes: tuple[str, ...] = ()) -> Task:
    """Load one of the two transport tasks with one departure from the paper as it is in the other task.

    The shipped task has all departures, the printed one none. Runs of such a task show what one departure changes.

    Args:
        base: `SHIPPED` or `PRINTED`.
        departure: The departure; None for the task as it is.
        changes: Further changes, of keys that are no departures.
    """
    if base == PRINTED:
        # one key sets all of the controller's departures; written out, each of them can be switched
        written_out = ("controller.as_printed=false", *CONTROLLER_AS_PRINTED)
        switched = () if departure is None else departure.shipped
    else:
        written_out = ()
        switched = () if departure is None else departure.printed
    return load_task(built_ins("task")[base], (*written_out, *switched, *changes))
