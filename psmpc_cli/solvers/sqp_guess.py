"""Another guess for a window whose first program has no solution."""

import numpy as np

from psmpc_cli.ocp.layout import mesh
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.velocity_form import Point, VelocityForm
from psmpc_cli.solvers.sqp_limits import Limits

SHARE = 0.9
"""How much of the time that a stage could last longer it is given."""


def later(form: VelocityForm, limits: Limits, point: Point, horizon: float) -> Point | None:
    """Return the motion of a guess with its last switch near the latest instant; None where that cannot move.

    A stage that is too short for its end condition has to last longer and to be faster at once. The product of the two
    is not in a linear program; from a late instant the second alone is enough.
    """
    last = len(point.tau) - 1
    if last < 0 or {last, last - 1, last + 1} & {*limits.shape.fixed, *limits.shape.tied}:
        return None
    room = min(limits.tau_high[last], limits.together - point.tau[:last].sum()) - point.tau[last]
    if room <= 0:
        return None
    tau = point.tau.copy()
    tau[last] += SHARE * room
    times = mesh(form.durations(point, horizon), form.layout.nodes)
    motion = Plan(times, point.X, form.inputs(point, horizon), np.cumsum(point.tau))
    longer = Point(point.X, tau)
    X = motion.states_at(mesh(form.durations(longer, horizon), form.layout.nodes))
    return Point(np.vstack([point.X[:1], X[1:]]), tau)
