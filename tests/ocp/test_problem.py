"""A task made computable."""

import gc
import weakref

import numpy as np

from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.stage import StageShape
from psmpc_cli.specs.load import load_task


def test_a_model_that_nobody_uses_is_freed_with_what_was_built_for_it() -> None:
    problem = build_problem(load_task("transport", ["controller.nodes=4"]))
    problem.costs.errors(problem.stages[0], np.zeros((1, 2 * problem.model.n)))
    functions = stage_functions(problem.model, StageShape("joint"))
    assert stage_functions(problem.model, StageShape("joint")) is functions
    model = weakref.ref(problem.model)
    del problem, functions
    gc.collect()
    assert model() is None
