"""The controller as a task declares it."""

from typing import Any

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.controller import AS_PRINTED, ControllerSpec
from psmpc_cli.specs.load import load_task


def test_as_printed_sets_the_keys_of_the_controllers_departures() -> None:
    changes = {"controller": {"as_printed": True, "horizon": 3.0}}
    spec = load_task("transport", changes).spec.controller
    assert {key: getattr(spec, key) for key in AS_PRINTED} == {
        "normalization": "range",
        "normalization_at": "nodes",
        "pending_cost": 0.0,
        "discretization": "euler",
        "detection_margin": 1.0,
    }
    assert spec.horizon == 3.0
    assert ControllerSpec.model_validate(spec.model_dump()) == spec
    one_by_one = load_task("transport", {"controller": {**AS_PRINTED, "horizon": 3.0}}).spec.controller
    assert one_by_one.model_copy(update={"as_printed": True}) == spec
    assert load_task("transport", {"controller.as_printed": False}).digest == load_task("transport").digest


@pytest.mark.parametrize("value", ["own", "as_printed"])
@pytest.mark.parametrize("key", AS_PRINTED)
def test_a_key_that_as_printed_sets_is_not_given_beside_it(key: str, value: str) -> None:
    given = AS_PRINTED[key] if value == "as_printed" else getattr(ControllerSpec(), key)
    controller: dict[str, Any] = {"as_printed": True, key: given}
    with pytest.raises(SpecError) as caught:
        load_task("transport", {"controller": controller})
    message = str(caught.value)
    assert f'controller.{key}: found "{key}" beside as_printed: true' in message
    assert f"as_printed sets {key} to {AS_PRINTED[key]}" in message
    assert len(message.splitlines()) == 1
