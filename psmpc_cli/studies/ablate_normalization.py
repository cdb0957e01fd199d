"""The normalization by the nadir against none, and against the range of eq. (12) as printed."""

from collections.abc import Mapping

from psmpc_cli.logs.read import Log
from psmpc_cli.studies.ablation import (
    JUMP,
    OURS,
    Ablation,
    ending,
    instants,
    joined,
    measured,
    starting,
    starts_and_ends,
    variation,
)

NONE, RANGE, ALL_PRINTED = "none", "range", "range and printed"
"""The runs without normalization, with the printed form, and with the objective printed as well (delta = 0)."""

FORMS: Mapping[str, str] = {
    OURS: "with costs over their nadir",
    NONE: "with costs as they are",
    RANGE: "with the range as printed",
    ALL_PRINTED: "with the range and delta = 0, both as printed,",
}
"""The runs in words."""


def ablate_normalization(logs: Mapping[str, Log]) -> Ablation:
    """Compare the runs `OURS`, `NONE`, `RANGE` and `ALL_PRINTED`."""
    numbers = measured(logs, FORMS)
    panels = {
        "stages": {name: starts_and_ends(logs[name]) for name in FORMS},
        "instant": instants(logs, FORMS),
        "variation": {name: variation(logs[name]) for name in FORMS},
    }
    return Ablation("normalization", _sentence(numbers, logs[OURS].stage_names[1:]), panels, numbers)


def _sentence(numbers: Mapping[str, float], stages: tuple[str, ...]) -> str:
    """Say what becomes of the run in each form."""
    parts = []
    for name, words in FORMS.items():
        starts = starting(numbers[f"start of {stage}, {name}"] for stage in stages)
        parts.append(
            f"{words} at {starts}, the run {ending(numbers[f'end, {name}'])}, the optimized instant jumps "
            f"{numbers[f'jumps, {name}']:.0f} times by more than {JUMP:g} s and the joints' control varies by "
            f"{numbers[f'variation, {name}']:.1f} rad/s^2"
        )
    return f"{joined(stages).capitalize()} start {'; '.join(parts)}."
