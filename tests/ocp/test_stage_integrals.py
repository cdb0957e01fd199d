from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from psmpc_cli.ocp.stage_integrals import stage_integrals
from psmpc_cli.ocp.transcription import transcribe

from psmpc_cli.ocp.problem import Stage, StageCosts
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.robot.model import RobotModel


@pytest.mark.parametrize("changes", [{}, {"moving": True}, {"input": "task"}], ids=["still", "moving", "task input"])
def test_they_are_the_costs_of_the_objective(
    model: RobotModel, stages: tuple[Stage, ...], costs: StageCosts, changes: dict[str, object]
) -> None:
    shape = window_shape(stages[:2], (4, 4), "exact")
    nlp = transcribe(model, replace(shape, stages=tuple(replace(s, **changes) for s in shape.stages)))
    random = np.random.default_rng(0)
    z, p = random.random(nlp.x.shape[0]), 0.5 + random.random(nlp.p.shape[0])
    expected = np.asarray(ca.Function("costs", [nlp.x, nlp.p], [nlp.costs])(z, p)).ravel()
    np.testing.assert_allclose(stage_integrals(nlp, costs, z, p), expected, rtol=1e-12)
