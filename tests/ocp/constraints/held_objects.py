"""Shared by the tests of hands and others."""

from dataclasses import replace

from psmpc_cli.ocp.stage import PlacedStage


def without_forces(stage: PlacedStage) -> PlacedStage:
    """The stage without limits of forces, which other back-ends than sqp take half a minute to write out."""
    return replace(stage, constraints={name: each for name, each in stage.constraints.items() if name != "forces"})
