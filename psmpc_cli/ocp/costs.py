"""Stage costs, errors and end conditions evaluated on numbers, many nodes at once."""

from functools import cache

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import RowFunction
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.robot.model import RobotModel


class StageCosts:
    """Evaluates the skills of one robot on arrays of states."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._error = cache(self._build_error)
        self._pose_acceleration = cache(self._build_pose_acceleration)

    def _build_error(self, space: str) -> tuple[RowFunction, RowFunction]:
        skill, n = SKILLS[space], self.model.n
        Q, Qdot = ca.SX.sym("Q", n), ca.SX.sym("Qdot", n)
        target = ca.SX.sym("target", skill.rows(self.model))
        error = ca.Function("error", [Q, target], [ca.densify(skill.error(self.model, Q, target))])
        rate = ca.Function("rate", [Q, Qdot], [ca.densify(skill.rate(self.model, Q, Qdot))])
        return RowFunction(error), RowFunction(rate)

    def _build_pose_acceleration(self) -> RowFunction:
        Q, Qdot, u = (ca.SX.sym(name, self.model.n) for name in ("Q", "Qdot", "u"))
        acceleration = self.model.J_C(Q) @ u + self.model.Jdot_Qdot(Q, Qdot)
        return RowFunction(ca.Function("a", [Q, Qdot, u], [ca.densify(acceleration)]))

    def errors(self, stage: Stage, X: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return the stage's error at each state (K, rows) [m, rad]; X is (K, 2n).

        Against what its cost follows at times `since` its start (K,) [s]; without them against its target.
        """
        if since is None or stage.trajectory is None:
            return self.errors_from(stage.space, X, stage.target)
        return self.errors_from(stage.space, X, stage.reference(since))

    def errors_from(self, space: str, X: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the error in a space at each state (K, rows) [m, rad], from a reference (K, rows) or (rows,)."""
        error, _ = self._error(space)
        return error(X[:, : self.model.n], reference, rows=len(X))[0]

    def rates(self, stage: Stage, X: np.ndarray) -> np.ndarray:
        """Return the rate of the stage's error at each state (K, rows) [m/s, rad/s]."""
        _, rate = self._error(stage.space)
        return rate(X[:, : self.model.n], X[:, self.model.n :], rows=len(X))[0]

    def along(self, stage: Stage, X: np.ndarray, u: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return Lbar at the nodes (K + 1,) of X (K + 1, 2n), u (K, n); the last control counts twice."""
        return self.at(stage, X, np.vstack([u, u[-1:]]), since)

    def at(self, stage: Stage, X: np.ndarray, u: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return Lbar (K,) at states X (K, 2n) under accelerations u (K, n). Paper eq. (10)."""
        if stage.input == "task":
            u = self.task_acceleration(X, u)
        error = self.errors(stage, X, since)
        return np.asarray(error**2 @ stage.weights + u**2 @ stage.control_weights)

    def task_acceleration(self, X: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the acceleration of xi (K, m) that Qddot = u means: J_C u + Jdot_C Qdot."""
        n = self.model.n
        return self._pose_acceleration()(X[:, :n], X[:, n:], u, rows=len(X))[0]

    def met(self, stage: Stage, X: np.ndarray, margin: float = 1.0) -> np.ndarray:
        """Return whether the end condition (18) holds at each state (K,), its tolerances widened by `margin`."""
        if not stage.end_rows:
            return np.zeros(len(X), bool)
        rows = list(stage.end_rows)
        ok = np.all(np.abs(self.errors(stage, X)[:, rows]) <= stage.tolerance * margin + 1e-6, axis=1)
        if stage.end_velocity is not None:
            ok &= np.all(np.abs(self.rates(stage, X)[:, rows]) <= stage.end_velocity * margin + 1e-6, axis=1)
        return np.asarray(ok)
