from dataclasses import replace

import pytest
from psmpc_cli.ocp.layout import WindowShape
from psmpc_cli.ocp.transcription import Nlp, transcribe

from psmpc_cli.ocp.problem import Stage
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.robot.model import RobotModel

CHANGES = {"as they are": {}, "at rest": {"end_velocity": True}, "timed": {"end_rows": (), "fixed_end": True}}


def shapes(stages: tuple[Stage, ...], count: int, **changes: object) -> WindowShape:
    shape = window_shape(stages[:count], (3,) * count, "exact")
    ended = tuple(replace(stage, **changes) for stage in shape.stages[:-1])
    return replace(shape, stages=(*ended, shape.stages[-1]))


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("changes", CHANGES.values(), ids=CHANGES)
def test_every_row_has_its_place(
    model: RobotModel, stages: tuple[Stage, ...], count: int, changes: dict[str, object]
) -> None:
    nlp: Nlp = transcribe(model, shapes(stages, count, **changes))
    found = [*nlp.gap_rows.ravel(), *nlp.x0_rows, *nlp.instant_rows.values()]
    equalities = len(found)
    found += [row for rows in nlp.end_rows.values() for row in rows]
    found += [] if nlp.last_duration_row is None else [nlp.last_duration_row]
    assert sorted(found) == list(range(nlp.g.shape[0])) == list(range(len(nlp.equality)))
    assert sum(nlp.equality) == equalities
    assert all(nlp.equality[row] for row in found[:equalities])
    assert sum(nlp.nx[1:]) + sum(nlp.ng) == len(nlp.equality)
    assert sum(nlp.nx) + sum(nlp.nu) == nlp.x.shape[0] == nlp.layout.size
