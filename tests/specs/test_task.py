"""A whole task as data."""

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.task import TaskSpec


def test_task_is_the_same_after_a_round_trip_through_plain_data() -> None:
    obstacles = [{"name": "post", "shape": {"box": [1, 2]}, "pose": [4, 4, "30 deg"], "velocity": [0.1, 0]}]
    clear = {"obstacles": obstacles, "clearance": {"except": [["arm_1", "post"]]}}
    for changes in ({}, clear):
        spec = load_task("transport", {"by_controller": {}, **changes}).spec
        assert TaskSpec.model_validate(spec.model_dump()) == spec
        assert TaskSpec.model_validate_json(spec.model_dump_json()) == spec


@pytest.mark.parametrize("kind", ["psmpc", "htmpc"])
def test_by_controller_gives_no_key_beside_as_printed_either(kind: str) -> None:
    with pytest.raises(SpecError, match=r"by_controller.*found \"pending_cost\" beside as_printed: true"):
        load_task("transport_as_printed", {"by_controller": {kind: {"controller.pending_cost": 1}}})
