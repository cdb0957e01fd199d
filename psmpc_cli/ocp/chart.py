"""The chart in which a controller plans: n coordinates whose second derivative is its control.

A planar robot's coordinates are its own: its chart changes nothing. A spatial robot's are Q = [position (3), phi (3),
joints] with the base's attitude R = A Exp(phi), A the attitude that was measured at the sample. So phi is 0 at the
start of every plan and its rate is the body's angular velocity, and the robot is the exact double integrator (8) in
space too. docs/formulation.md, section "attitude".
"""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.rotations import body_rate, chart_rate, conjugate, exp, log, product

ATTITUDE, TURN = slice(3, 7), slice(3, 6)
"""Rows of the quaternion in a spatial robot's Q (nq,), and of phi in the chart's (n,)."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Coordinates about an attitude.

    Attributes:
        anchor: Unit quaternion A (4,); empty of a planar robot.
    """

    anchor: np.ndarray

    @classmethod
    def at(cls, Q: np.ndarray, n: int) -> "Chart":
        """Return the chart about the attitude in a state's coordinates Q (nq,) of a robot with n velocities."""
        return cls(Q[ATTITUDE] / np.linalg.norm(Q[ATTITUDE]) if len(Q) > n else np.zeros(0))

    @property
    def spatial(self) -> bool:
        """Whether it changes anything."""
        return len(self.anchor) > 0

    def enter(self, Q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the states x = [Q; Qdot] (K, 2n) in the chart at coordinates Q (K, nq) and velocities v (K, n)."""
        if not self.spatial:
            return np.hstack([Q, v])
        turned = product(conjugate(list(self.anchor)), list(Q[:, ATTITUDE].T))
        sign = np.where(turned[0] < 0, -1.0, 1.0)
        phi = log([sign * part for part in turned])
        rate = chart_rate(phi, list(v[:, TURN].T))
        return np.column_stack([Q[:, :3], *phi, Q[:, 7:], v[:, :3], *rate, v[:, 6:]])

    def leave(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates Q (K, nq) and velocities v (K, n) at states X (K, 2n) in the chart."""
        n = X.shape[1] // 2
        if not self.spatial:
            return X[:, :n], X[:, n:]
        phi, rate = list(X[:, TURN].T), list(X[:, n + 3 : n + 6].T)
        attitude = np.column_stack(product(list(self.anchor), exp(phi)))
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        omega = np.column_stack(body_rate(phi, rate))
        return np.hstack([X[:, :3], attitude, X[:, 6:n]]), np.hstack([X[:, n : n + 3], omega, X[:, n + 6 :]])

    def moved(self, X: np.ndarray, to: "Chart") -> np.ndarray:
        """Return states X (K, 2n) in another chart (K, 2n)."""
        return to.enter(*self.leave(X)) if self.spatial else X

    def rate_shift(self, X: np.ndarray) -> np.ndarray:
        """Return Qdot - v (K, n) at states X (K, 2n): by how much limits of v lie elsewhere in the chart's rates.

        It is (I - J_r(phi)) phidot in the rows of attitude, and 0 in all others.
        """
        n = X.shape[1] // 2
        return np.asarray(X[:, n:] - self.leave(X)[1])


PLANAR = Chart(np.zeros(0))
"""The chart of every planar robot."""
