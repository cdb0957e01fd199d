"""The stages' normalized cost integrals on numbers, as they stand in a window's objective."""

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.layout import Layout
from psmpc_cli.ocp.parameters import Parameters, split_parameters
from psmpc_cli.ocp.transcription import Nlp


def stage_integrals(nlp: Nlp, costs: StageCosts, z: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return sum_i L_s(x_i, u_i) tau_s / N_s of each stage, without priorities, (S + 1,). Paper eq. (16).

    Args:
        nlp: The window's NLP.
        costs: The errors of its robot.
        z: Decision vector.
        p: Parameter vector.
    """
    numbers = split_parameters(p, nlp.shape, nlp.layout)
    return np.array([_integral(nlp, costs, s, z, numbers) for s in range(nlp.layout.switches + 1)])


def _integral(nlp: Nlp, costs: StageCosts, s: int, z: np.ndarray, p: Parameters[np.ndarray]) -> float:
    layout: Layout = nlp.layout
    N, nodes = layout.nodes[s], slice(layout.first_node[s], layout.first_node[s + 1])
    tau, path = z[layout.duration_index[nodes]], p.paths[s]
    tau = p.horizon - tau.sum(axis=1) if s == layout.switches else tau[:, s]
    wanted = p.targets[s] if path.shape[1] == 0 else (path[:, :N] + path[:, N + 1 : -1] * tau).T
    e = costs.errors_from(nlp.shape.stages[s].space, z[layout.state_index[nodes]], wanted)
    Lbar = e**2 @ p.weights[s] + z[layout.input_index(s)] ** 2 @ p.control_weights[s]
    return float((Lbar - p.offset[s]) @ tau / p.scale[s] / N)
