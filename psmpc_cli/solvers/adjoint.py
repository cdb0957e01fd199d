"""Windows by single shooting: the variables are controls and switch times, the gradient of J is that of costates.

The states of a window are simulated from its measured one. What it costs and what bounds it is that of the NLP of the
window (`nlp`), whose decision variables x are functions x(z) of the variables z that are left: its gaps are closed, and
bounds of its states are rows. Of the program in z IPOPT gets

    dJ/dz by the costates of `ocp.gradient`: by the exact discrete adjoint, or with (26) as printed,
    the Jacobian of the rows g by algorithmic differentiation, g_x x_z,
    the Hessian of the Lagrangian L = J + y'g, x_z' L_xx x_z + sum_i (L_x)_i d2x_i/dz2.

Without this Hessian IPOPT takes hundreds of iterations (docs/formulation.md). Switch times are variables as the
durations between them, as in the NLP.
"""

from collections.abc import Mapping
from functools import cached_property
from itertools import accumulate
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.gradient import Shooting, by_switch_times
from psmpc_cli.ocp.window import Parameters, WindowShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.nlp import Nlp, NlpSolver


class ShootingNlp(Nlp):
    """The NLP of a window whose states are simulated: min J(x(z, p), p) subject to bounds on z and g(x(z, p), p).

    The variables z are those of x that are not states, with the durations once: inputs, durations, and what soft limits
    are violated by.

    Args:
        model: The robot.
        shape: The shape of the windows.
        numbers: The parameters of one window of this shape.
        has_all_rows: It has the rows that are rarely active too.
        printed: Derivatives by the switch times are those of (26) as printed.
    """

    def __init__(
        self,
        model: RobotModel,
        shape: WindowShape,
        parameters: Parameters[np.ndarray],
        has_all_rows: bool,
        printed: bool,
    ) -> None:
        """Turn the multiple-shooting NLP in x into one by single shooting, whose variables z are fewer.

        z has what the states of x do not determine: inputs, durations (which x repeats at each node: here once) and
        violations of soft limits. The states are simulated from the measured one, which gives x(z); so the rows of x
        that close the gaps between nodes are left out.

        Args:
            model: The robot.
            shape: The structure of the windows: stages, numbers of intervals, which constraints there are.
            parameters: The numbers of one window of this shape, for their sizes.
            has_all_rows: It has the rows that are rarely active too.
            printed: Derivatives by switch times are those of eq. (26) as printed, not those of the discrete adjoint.
        """
        super().__init__(model, shape, parameters, has_all_rows)
        self._printed = printed
        K = self.grid.K
        S = self.grid.switches
        # Where states and z stand in the decision vector x of the multiple-shooting NLP: pack ones into x, at these.
        # The arguments of `pack` are states, durations, sums of costs, accelerations before, violations of limits and
        # of soft rows, then the inputs of each stage.
        no_inputs = [0] * (S + 1)
        is_later = np.tile(np.arange(K + 1) > 0, (2 * model.n, 1))
        is_first = np.tile(np.arange(K + 1) == 0, (S, 1))
        all_inputs = [1] * (S + 1)
        self._later_states = np.flatnonzero(np.asarray(self.pack(is_later, 0, 0, 0, 0, 0, *no_inputs)))
        self._free = np.flatnonzero(np.asarray(self.pack(0, is_first, 0, 0, 1, 1, *all_inputs)))
        # At each node rows of the gap to the next one come first, which simulating closes; then its path rows.
        gap_sizes = [*self.sizes["nx"][1:], 0]
        is_path_row = [np.arange(gap + path) >= gap for gap, path in zip(gap_sizes, self.sizes["ng"], strict=True)]
        self._path_row_indices = np.flatnonzero(np.concatenate(is_path_row))

        # Simulate the states from the measured one as expressions in z, and write x(z).
        x = ca.SX.zeros(self.problem["x"].numel())
        self._z = ca.SX.sym("z", len(self._free))
        x[self._free] = self._z
        _, tau, _, _, e, row_e, *inputs = self.unpack(x)
        self._tau = ca.vertcat(tau[:, 0], self._p.horizon - ca.sum1(tau[:, 0]))
        self._U = [ca.horzsplit(of_stage) for of_stage in inputs]
        self._shooting = Shooting(model, shape, self._p)
        X = ca.horzcat(*self._shooting.states(self._tau, self._U))
        u_before = ca.SX(0)
        if shape.has_rates:
            u_before = ca.horzcat(self._applied, *(u for of_stage in self._U for u in of_stage))
        self._x = self.pack(X, ca.repmat(tau[:, 0], 1, K + 1), 0, u_before, e, row_e, *inputs)

    @cached_property
    def program(self) -> Mapping[str, Any]:
        """The program in z; its rows are the states after the measured one, then the path rows of all nodes."""
        z = ca.MX.sym("z", self._z.numel())
        p = ca.MX.sym("p", self.problem["p"].numel())
        J, _ = self._objective(z, p)
        x, _ = self._simulation(z, p)
        return {"x": z, "p": p, "f": J, "g": ca.vertcat(x[self._later_states], self._path_rows(x, p)[0])}

    @property
    def derivatives(self) -> Mapping[str, ca.Function]:
        """Gradient, Jacobian and Hessian of the program in z, for IPOPT, by the names CasADi has for them.

        With x(z) the decision variables of the multiple-shooting NLP, states simulated, L = sigma J + y'g, and
        subscripts for derivatives,

            Jacobian   g_x x_z,      Hessian   x_z' L_xx x_z + sum_i (L_x)_i d2x_i/dz2.

        The states after the first are rows of the program themselves: their multipliers are added to L_x.
        """
        z = self.program["x"]
        p = self.program["p"]
        g = self.program["g"]
        x, x_z = self._simulation(z, p)
        _, path_rows_by_x = self._path_rows(x, p)
        jacobian = ca.vertcat(x_z[self._later_states, :], path_rows_by_x @ x_z)  # rows: states, then path rows

        sigma = ca.MX.sym("sigma")
        y = ca.MX.sym("y", g.numel())
        y_states, y_path_rows = ca.vertsplit(y, [0, len(self._later_states), y.numel()])
        L_xx, L_x = self._lagrangian(x, p, sigma, y_path_rows)
        L_x[self._later_states] += y_states
        hessian = x_z.T @ L_xx @ x_z + self._curvature(z, p, L_x)
        return {
            "grad_f": ca.Function("gradient", [z, p], self._objective(z, p)),
            "jac_g": ca.Function("jacobian", [z, p], [g, jacobian]),
            "hess_lag": ca.Function("hessian", [z, p, sigma, y], [ca.triu(hessian)]),
        }

    @cached_property
    def _simulation(self) -> ca.Function:
        """z, p -> x, dx/dz."""
        return ca.Function("x", [self._z, self.problem["p"]], [self._x, ca.jacobian(self._x, self._z)])

    @cached_property
    def _curvature(self) -> ca.Function:
        """z, p, v -> sum_i v_i d2x_i/dz2."""
        v = ca.SX.sym("v", self._x.numel())
        hessian, _ = ca.hessian(ca.dot(v, self._x), self._z)
        return ca.Function("curvature", [self._z, self.problem["p"], v], [hessian])

    @cached_property
    def _path_rows(self) -> ca.Function:
        """x, p -> the path rows, their Jacobian by x."""
        x = self.problem["x"]
        rows = self.problem["g"][self._path_row_indices]
        return ca.Function("path_rows", [x, self.problem["p"]], [rows, ca.jacobian(rows, x)])

    @cached_property
    def _lagrangian(self) -> ca.Function:
        """x, p, sigma, multipliers y of the path rows -> second and first derivatives of sigma J + y'g by x."""
        x = self.problem["x"]
        sigma = ca.SX.sym("sigma")
        y = ca.SX.sym("y", len(self._path_row_indices))
        L = sigma * self.problem["f"] + ca.dot(y, self.problem["g"][self._path_row_indices])
        return ca.Function("lagrangian", [x, self.problem["p"], sigma, y], ca.hessian(L, x))

    @cached_property
    def _objective(self) -> ca.Function:
        """z, p -> J and its gradient: by costates; of violated soft limits and of rates by differentiation."""
        J = self._shooting.objective(self._tau, self._U)
        by_duration, by_input = self._shooting.adjoint(self._tau, self._U)
        by_switch_time = by_switch_times(by_duration)
        if self._printed:
            by_switch_time = self._shooting.by_costate(self._tau, self._U, printed=True)
        by_free_duration = [*accumulate(reversed(by_switch_time))][::-1]  # a duration moves all switch times after it
        by_tau = ca.horzcat(ca.vertcat(*by_free_duration), ca.SX(self.grid.switches, self.grid.K))
        inputs = [ca.horzcat(*of_stage) for of_stage in by_input]
        gradient = self.pack(0, by_tau, 0, 0, 0, 0, *inputs)[self._free]
        other_costs = ca.substitute(self._soft_cost + self._rate_cost_of_all, self.problem["x"], self._x)
        results = [J + other_costs, gradient + ca.gradient(other_costs, self._z)]
        return ca.Function("objective", [self._z, self.problem["p"]], results)

    def arguments(self, x: np.ndarray, p: np.ndarray, bounds: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the arguments of IPOPT, to start from the inputs and durations in x."""
        return {
            "x0": x[self._free],
            "p": p,
            "lbx": bounds["lbx"][self._free],
            "ubx": bounds["ubx"][self._free],
            "lbg": np.concatenate([bounds["lbx"][self._later_states], bounds["lbg"][self._path_row_indices]]),
            "ubg": np.concatenate([bounds["ubx"][self._later_states], bounds["ubg"][self._path_row_indices]]),
        }

    def point(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the decision variables x of a solution z, its states simulated."""
        x, _ = self._simulation(z, p)
        return np.asarray(x).ravel()


class AdjointSolver(NlpSolver):
    """Windows by single shooting and IPOPT; arguments are those of `NlpSolver`."""

    def _transcribe(self, shape: WindowShape, parameters: Parameters[np.ndarray], has_all_rows: bool) -> Nlp:
        printed = self._spec.gradient == "printed"
        return ShootingNlp(self._problem.model, shape, parameters, has_all_rows, printed)
