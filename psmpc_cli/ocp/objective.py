"""What a stage is made of, as functions, and on arrays: the residual and its weights are stated once, here.

The running cost of a stage is Lbar = |e|^2_W + |u|^2_Wr with the residual e of its skill. Paper eq. (10). The objective
of the NLP, its Gauss-Newton model, stage costs on arrays and the audits of the gradient are derived from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.ocp.end import MEASURES, MOMENTA, component_counts
from psmpc_cli.ocp.loads import LoadKind, OwnMotion
from psmpc_cli.ocp.skills import skill_in
from psmpc_cli.ocp.stage import Stage, StageShape, cost_shape, end_shape, stage_shape
from psmpc_cli.robot import motion
from psmpc_cli.robot.kinematics import runge_kutta
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, product, rotate, scaled

SLACK = 1e-6
SLACK_SHARE = 1e-3
"""By how much an end condition's tolerances may be exceeded [m, rad, m/s, rad/s], and by what part of them at most.

Solvers stop at a tolerance of their own; but one of 1e-7 means that, not 1e-6."""


def weighted_square(r: ca.SX, weights: ca.SX) -> ca.SX:
    """Return |r|^2_W with the diagonal of W, a scalar."""
    return ca.dot(weights * r, r)


LONG = 200
"""Operations from which on a function of a constraint is evaluated as a tape, and its subexpressions are as they come.

In a large one looking for common subexpressions takes seconds and finds a few per cent."""


def _batch_function(name: str, arguments: list[ca.SX], outputs: list[ca.SX], at_many: bool = True) -> BatchFunction:
    """Return a function on rows of arrays; a long one that is evaluated at many of them as a tape."""
    function = ca.Function(name, arguments, outputs)
    if function.n_instructions() < LONG:
        return BatchFunction(ca.Function(name, arguments, ca.cse(outputs)))
    return BatchFunction(function, native=at_many)


class ConstraintFunctions:
    """Rows g(x, a) of the state at a node, and their derivatives, each written when it is first used.

    Args:
        x: The state [Q; Qdot], a symbol (2n,).
        argument: a, a symbol.
        rows: The rows as an expression of both.
        solved_for: Rates that the rows, equations, are solved for: the rows are linear in them and as many. None if
            there are none. `sqp` solves them at every iterate, and neglects their curvature.
        is_convex: They are bounded below and convex, as distances to convex bodies are: their curvature, which can only
            make programs non-convex, does not count. Such rows are many and long, and few of them count at a time.
        at_nodes: They stand at many nodes, and not only at the end of a stage.
        has_curvature: Their curvature counts. That of rows that are velocities need not: programs leave out its larger
            part, that by positions and velocities.
    """

    def __init__(
        self,
        x: ca.SX,
        argument: ca.SX,
        rows: ca.SX,
        solved_for: slice | None = None,
        is_convex: bool = False,
        at_nodes: bool = False,
        has_curvature: bool = True,
    ) -> None:
        """Take the rows g(x, a) of a constraint as an expression, and what decides how they are evaluated.

        Rows that are linear in rates which they determine are solved for these (`solved_for`), and convex ones need no
        curvature in a quadratic program. Functions of rows at many nodes are evaluated as a tape, a list of
        instructions that compiled code carries out for all nodes; rows at the end of a stage, one node, are not.

        Args:
            x: The state [Q; Qdot], a symbol (2n,).
            argument: a, a symbol.
            rows: The rows as an expression of both.
            solved_for: Entries of Qdot that the rows are solved for; None if there are none.
            is_convex: They are bounded below and convex.
            at_nodes: They stand at many nodes.
            has_curvature: Their second derivatives count.
        """
        self.solved_for = solved_for
        self._is_convex = is_convex
        self._has_curvature = has_curvature and solved_for is None and not is_convex
        self._at_many = at_nodes or solved_for is not None or is_convex
        self._x = x
        self._argument = argument
        self._rows = ca.densify(rows)
        self.count = int(rows.numel())

    @cached_property
    def value(self) -> BatchFunction:
        """x, a -> g (rows,)."""
        return _batch_function("h", [self._x, self._argument], [self._rows], self._at_many)

    @cached_property
    def with_jacobian(self) -> BatchFunction:
        """x, a -> g (rows,), dg/dx row by row (rows 2n,)."""
        outputs = [self._rows, _row_by_row(ca.jacobian(self._rows, self._x))]
        return _batch_function("end", [self._x, self._argument], outputs, self._at_many)

    @cached_property
    def _gradient(self) -> BatchFunction:
        """x, a, multipliers y (rows,) -> y' dg/dx (2n,)."""
        y = ca.SX.sym("y", self.count)
        gradient = ca.densify(ca.gradient(ca.dot(y, self._rows), self._x))
        return _batch_function("row_gradient", [self._x, self._argument, y], [gradient], self._at_many)

    def gradients(self, X: np.ndarray, argument: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Return the derivatives by x of some rows, each at a state of its own, (J, 2n).

        Args:
            X: The states, (J, 2n).
            argument: a of each, (J, numbers), or of all, (numbers,).
            row: Which row is wanted at each, (J,).
        """
        if not len(row):
            return np.empty(X.shape)
        return self._gradient(X, argument, np.eye(self.count)[row], rows=len(X))[0]

    @cached_property
    def curvature(self) -> BatchFunction | None:
        """x, a, multipliers y -> upper triangle of the second derivatives of y'g by Q, row by row (n n,).

        It is what a constraint adds to the Hessian of the Lagrangian. Q is the first half of x; by velocities no row is
        curved. None where there is nothing to add to the model of a program: g is linear in Q; it is solved for rates
        at each iterate instead; it is convex, and its curvature could only make the program non-convex; or it is a
        velocity.
        """
        if not (self.count and self._has_curvature):
            return None
        n = self._x.numel() // 2
        multipliers = ca.SX.sym("multipliers", self.count)
        hessian, _ = ca.hessian(ca.dot(multipliers, self._rows), self._x)
        upper = ca.triu(hessian[:n, :n])
        if not upper.nnz():
            return None
        arguments = [self._x, self._argument, multipliers]
        return _batch_function("end_curvature", arguments, [_row_by_row(upper)], self._at_many)

    @cached_property
    def by_solved_for(self) -> BatchFunction | None:
        """x, a -> g (rows,), its derivatives by the rates it is solved for, row by row (rows rows,); None if none."""
        if self.solved_for is None:
            return None
        n = self._x.numel() // 2
        jacobian = ca.jacobian(self._rows, self._x[n:][self.solved_for])
        return _batch_function("given", [self._x, self._argument], [self._rows, _row_by_row(jacobian)], self._at_many)

    def prepare(self) -> tuple[BatchFunction, ...]:
        """Write those that solves need and return them."""
        if self._is_convex:
            return self.value, self._gradient
        needed = self.value, self.with_jacobian, self.curvature, self.by_solved_for
        return tuple(function for function in needed if function is not None)


@dataclass(frozen=True)
class IntervalSymbols:
    """An interval as rows over it are written: expressions.

    Attributes:
        x, x_next: States at both ends (2n,).
        h: Its length.
        u: The acceleration over it (n,).
        u_before, h_before: Acceleration (n,) and length of the interval before; of the first one, of what was applied
            before. Empty where no row asks for them.
    """

    x: ca.SX
    x_next: ca.SX
    h: ca.SX
    u: ca.SX
    u_before: ca.SX
    h_before: ca.SX


@dataclass(frozen=True, eq=False)
class Intervals:
    """Some intervals of a motion, on arrays, as rows over them are evaluated.

    Attributes:
        X: States at all nodes of the motion (K + 1, 2n).
        lengths: Lengths of all its intervals (K, 1) [s].
        before: What was applied before it: an acceleration, and for how long (n + 1,); (0,) where no row asks for it.
        k: Which intervals, (J,).
    """

    X: np.ndarray
    lengths: np.ndarray
    before: np.ndarray
    k: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """States where they begin, (J, 2n)."""
        return np.asarray(self.X[self.k])

    @property
    def x_next(self) -> np.ndarray:
        """States where they end, (J, 2n)."""
        return np.asarray(self.X[self.k + 1])

    @property
    def h(self) -> np.ndarray:
        """Their lengths (J, 1) [s]."""
        return np.asarray(self.lengths[self.k])

    @property
    def u(self) -> np.ndarray:
        """Accelerations over them (J, n)."""
        return np.asarray(self._accelerations[self.k + 1])

    @property
    def u_before(self) -> np.ndarray:
        """Accelerations over the intervals before them (J, n)."""
        return np.asarray(self._accelerations[self.k])

    @property
    def h_before(self) -> np.ndarray:
        """Lengths of the intervals before them (J, 1) [s]."""
        return np.asarray(np.concatenate([self.before[None, -1:], self.lengths])[self.k])

    @cached_property
    def _accelerations(self) -> np.ndarray:
        """What was applied before, and the accelerations over all intervals (K + 1, n)."""
        n = self.X.shape[1] // 2
        return np.concatenate([self.before[None, :n], np.diff(self.X[:, n:], axis=0) / self.lengths])


class IntervalFunctions:
    """Rows over intervals, and their derivatives: r(x, dv, h, a) at one end of an interval, or at both.

    One function serves both ends, since its derivatives are long.

    Args:
        x: The state [Q; Qdot] at an end, a symbol (2n,).
        dv: The change of Qdot over the interval, a symbol (n,).
        h: The length of the interval, a symbol.
        argument: a, a symbol.
        rows: The rows at an end as an expression of all.
        ends: Where they stand: at the beginning, 0, the end, 1, or one after the other at both.
        jacobian: What derives the rows' derivatives by [x; dv; h] (rows, 3n + 1). By default CasADi does.

    Attributes:
        is_nearly_redundant: Neighbouring rows nearly say the same.
    """

    is_nearly_redundant = True

    def __init__(
        self,
        x: ca.SX,
        dv: ca.SX,
        h: ca.SX,
        argument: ca.SX,
        rows: ca.SX,
        ends: Sequence[int],
        jacobian: Callable[[], ca.SX] | None = None,
    ) -> None:
        """Take rows over an interval, r(x, dv, h, a), as an expression of the state x at one of its ends.

        Args:
            x: The state [Q; Qdot] at an end, a symbol (2n,).
            dv: The change of Qdot over the interval, a symbol (n,).
            h: The length of the interval, a symbol.
            argument: a, a symbol.
            rows: The rows.
            ends: At which ends they stand: at the beginning, 0, the end, 1, or one after the other at both.
            jacobian: Writes the derivatives of the rows by [x; dv; h] when they are needed; by default CasADi does.
        """
        self._arguments = [x, dv, h, argument]
        self._rows = ca.densify(rows)
        self._ends = ends
        self._derive = jacobian or (lambda: ca.jacobian(self._rows, ca.vertcat(x, dv, h)))
        self.count = int(rows.numel()) * len(ends)

    @cached_property
    def _value(self) -> BatchFunction:
        """x, dv, h, a -> r."""
        return _batch_function("interval_rows", self._arguments, [self._rows])

    @cached_property
    def _jacobian(self) -> BatchFunction:
        """x, dv, h, a -> the derivatives of r by [x; dv; h], row by row."""
        return _batch_function("interval_jacobian", self._arguments, [_row_by_row(self._derive())])

    def expression(self, interval: IntervalSymbols, argument: ca.SX) -> ca.SX:
        """Return the rows (rows,) of an interval."""
        n = interval.x.numel() // 2
        dv = interval.x_next[n:] - interval.x[n:]
        return ca.vertcat(
            *(self._value.function((interval.x, interval.x_next)[end], dv, interval.h, argument) for end in self._ends)
        )

    def values(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return the rows of J intervals (J, rows)."""
        X = intervals.x
        X_next = intervals.x_next
        h = intervals.h
        n = X.shape[1] // 2
        dv = X_next[:, n:] - X[:, n:]
        rows_at_ends = [self._value((X, X_next)[end], dv, h, argument, rows=len(X))[0] for end in self._ends]
        return np.hstack(rows_at_ends)

    def jacobian(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return the derivatives of the rows over J intervals by the states x, x+ at both ends and the length h.

        A row r(x, dv, h, a) at one end depends on the other one through dv = v+ - v alone: so its derivatives by dv are
        added to those by v+ and subtracted from those by v.

        Args:
            intervals: The intervals.
            argument: a, (numbers,).

        Returns:
            (J, rows, 4n + 1), rows at the beginning first, columns [Q, v, Q+, v+, h].
        """
        J, state_size = intervals.x.shape
        n = state_size // 2
        dv = intervals.x_next[:, n:] - intervals.x[:, n:]
        rows_at_end = self.count // len(self._ends)
        of_v = slice(n, 2 * n)
        of_v_next = slice(3 * n, 4 * n)
        derivatives = np.zeros((J, len(self._ends), rows_at_end, 4 * n + 1))
        for i, end in enumerate(self._ends):
            x = intervals.x_next if end else intervals.x
            of_x = slice(2 * n * end, 2 * n * (end + 1))
            (by_x_dv_h,) = self._jacobian(x, dv, intervals.h, argument, rows=J)
            by_x, by_dv, by_h = np.split(by_x_dv_h.reshape(J, rows_at_end, -1), [2 * n, 3 * n], axis=2)
            derivatives[:, i, :, of_x] = by_x
            derivatives[:, i, :, of_v] -= by_dv
            derivatives[:, i, :, of_v_next] += by_dv
            derivatives[:, i, :, -1] = by_h[..., 0]
        return derivatives.reshape(J, self.count, 4 * n + 1)

    def prepare(self) -> tuple[BatchFunction, ...]:
        """Write its functions and return them."""
        return self._value, self._jacobian


class RateFunctions:
    """Rows of the change of acceleration from the interval before, r(u-, u, h-, h) for each of some coordinates.

    Args:
        coordinates: Which.
        row: u-, u, h-, h, symbols, -> r.

    Attributes:
        is_nearly_redundant: Neighbouring rows nearly say the same.
    """

    is_nearly_redundant = False

    def __init__(self, coordinates: Sequence[int], row: Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]) -> None:
        self._coordinates = list(coordinates)
        self._arguments = [ca.SX.sym(name) for name in ("u_before", "u", "h_before", "h")]
        self._row = row(*self._arguments)
        self.count = len(self._coordinates)

    @cached_property
    def _value(self) -> BatchFunction:
        """u-, u, h-, h -> r."""
        return BatchFunction(ca.Function("rate", self._arguments, [self._row]))

    @cached_property
    def _gradient(self) -> BatchFunction:
        """u-, u, h-, h -> the derivatives of r by them (4,)."""
        gradient = ca.gradient(self._row, ca.vertcat(*self._arguments))
        return BatchFunction(ca.Function("rate_gradient", self._arguments, [ca.densify(gradient)]))

    def expression(self, interval: IntervalSymbols, argument: ca.SX) -> ca.SX:
        """Return the rows (rows,) of an interval."""
        function = self._value.function
        return ca.vertcat(
            *(function(interval.u_before[i], interval.u[i], interval.h_before, interval.h) for i in self._coordinates)
        )

    def _arguments_of_rows(self, intervals: Intervals) -> list[np.ndarray]:
        """Return u-, u, h-, h of each row of J intervals, (J rows, 1) each."""
        arguments = (
            intervals.u_before[:, self._coordinates],
            intervals.u[:, self._coordinates],
            intervals.h_before,
            intervals.h,
        )
        return [np.broadcast_to(argument, (len(intervals.k), self.count)).reshape(-1, 1) for argument in arguments]

    def values(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return the rows of J intervals (J, rows)."""
        (values,) = self._value(*self._arguments_of_rows(intervals), rows=len(intervals.k) * self.count)
        return np.asarray(values.reshape(len(intervals.k), self.count))

    def jacobian(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return the derivatives of the rows r(u-, u, h-, h) of J intervals by what accelerations are made of.

        With u = (v+ - v) / h and u- = (v - v-) / h-, what was applied before the first interval standing for u- there,

            r_v+ = r_u / h,   r_v = r_u- / h- - r_u / h,   r_v- = -r_u- / h-,   dr/dh = r_h - u r_u / h,   h- alike.

        Args:
            intervals: The intervals.
            argument: Not used: these rows take no numbers.

        Returns:
            (J, rows, 5n + 2): by the states at both ends, the length, the velocity where the interval before begins
            and the length of that interval, columns [Q, v, Q+, v+, h, v-, h-].
        """
        J = len(intervals.k)
        arguments = self._arguments_of_rows(intervals)
        u_before, u, h_before, h = (argument.reshape(J, self.count) for argument in arguments)
        (gradient,) = self._gradient(*arguments, rows=J * self.count)
        by_u_before, by_u, by_h_before, by_h = np.moveaxis(gradient.reshape(J, self.count, 4), -1, 0)
        by_v_next = by_u / h
        by_v_before = -by_u_before / h_before
        n = intervals.X.shape[1] // 2
        derivatives = np.zeros((J, self.count, 5 * n + 2))
        row = np.arange(self.count)
        coordinate = np.array(self._coordinates)
        derivatives[:, row, n + coordinate] = -by_v_before - by_v_next
        derivatives[:, row, 3 * n + coordinate] = by_v_next
        derivatives[:, row, 4 * n] = by_h - u * by_u / h
        derivatives[:, row, 4 * n + 1 + coordinate] = by_v_before
        derivatives[:, row, 5 * n + 1] = by_h_before - u_before * by_u_before / h_before
        return derivatives

    def prepare(self) -> tuple[BatchFunction, ...]:
        """Write its functions and return them."""
        return self._value, self._gradient


class ChangeFunctions:
    """Rows over intervals of what changes from the state at their beginning to that at their end, g(x+, a) - g(x, a).

    Args:
        at_node: The rows g.

    Attributes:
        is_nearly_redundant: Neighbouring rows nearly say the same.
    """

    is_nearly_redundant = False

    def __init__(self, at_node: ConstraintFunctions) -> None:
        self._at_node = at_node
        self.count = at_node.count

    def expression(self, interval: IntervalSymbols, argument: ca.SX) -> ca.SX:
        """Return the rows (rows,) of an interval."""
        function = self._at_node.value.function
        return ca.SX(function(interval.x_next, argument) - function(interval.x, argument))

    def values(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return the rows of J intervals (J, rows)."""
        nodes, ends = _nodes_of_intervals(intervals.k)
        (g,) = self._at_node.value(intervals.X[nodes], argument, rows=len(nodes))
        return np.asarray(g[ends[1]] - g[ends[0]])

    def jacobian(self, intervals: Intervals, argument: np.ndarray) -> np.ndarray:
        """Return their derivatives by both states and the length, (J, rows, 4n + 1)."""
        nodes, ends = _nodes_of_intervals(intervals.k)
        _, by_x = self._at_node.with_jacobian(intervals.X[nodes], argument, rows=len(nodes))
        by_x = by_x.reshape(len(nodes), self.count, -1)
        return np.concatenate([-by_x[ends[0]], by_x[ends[1]], np.zeros((len(intervals.k), self.count, 1))], axis=2)

    def with_dependent_rates(self, X: np.ndarray, argument: np.ndarray) -> np.ndarray:
        """Return states whose dependent rates are such that g(x, a) is the same at all nodes, that of the first one.

        The rows g (a momentum) are linear in as many rates y of x as there are rows, which they are solved for: with
        G = dg/dy at a node, y - G^-1 (g - g_first) is its new value. Without such rates the states stay.

        Args:
            X: States at successive nodes, (N + 1, 2n).
            argument: a, (numbers,).
        """
        if self._at_node.solved_for is None or self._at_node.by_solved_for is None:
            return X
        g, jacobian = self._at_node.by_solved_for(X, argument, rows=len(X))
        change = g[1:] - g[0]
        n = X.shape[1] // 2
        rates = slice(n + self._at_node.solved_for.start, n + self._at_node.solved_for.stop)
        by_rates = jacobian.reshape(len(X), self.count, -1)[1:]
        X = X.copy()
        X[1:, rates] -= np.linalg.solve(by_rates, change[..., None])[..., 0]
        return X

    def prepare(self) -> tuple[BatchFunction, ...]:
        """Write its functions and return them."""
        return self._at_node.prepare()


def _nodes_of_intervals(k: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the nodes at the ends of some intervals (J,), ascending, and where in them each begins and ends."""
    nodes = np.union1d(k, k + 1)
    return nodes, (np.searchsorted(nodes, k), np.searchsorted(nodes, k + 1))


class StageFunctions:
    """The functions of the stages of one shape for one robot, each written when it is first used.

    They are of SX and have no state, so they can be mapped over nodes, saved and compiled. At rows of arrays they are
    called, in expressions by their `function`.

    Args:
        model: The robot.
        shape: The shape.
    """

    def __init__(self, model: RobotModel, shape: StageShape) -> None:
        """Write the residual e of the stage's skill and its weighted square e' W e as expressions of symbols.

        Args:
            model: The robot.
            shape: What decides the expressions: the skill's space, what is controlled, the end condition, and the kind
                of load where force costs. All numbers are symbols.
        """
        skill = skill_in(shape.space)
        n = model.n
        self.model = model
        self.shape = shape
        self.rows = skill.rows(model)
        # A target has the skill's numbers, those that samples set (the chart's anchor), then those of object and load.
        self._numbers_of_skill = skill.numbers(model) + model.space.n_sample_numbers
        self._numbers_of_object = 2 * model.space.n_pose if shape.object_names else 0
        self.numbers = self._numbers_of_skill + self._numbers_of_object + shape.end_load.count(model)
        self.inputs = model.n_inputs(shape.input)
        self._Q = ca.SX.sym("Q", n)
        self._Qdot = ca.SX.sym("Qdot", n)
        self._u = ca.SX.sym("u", self.inputs)
        self._target = ca.SX.sym("target", self.numbers)
        self._x = ca.vertcat(self._Q, self._Qdot)
        self._W = ca.SX.sym("W", self.rows)
        self._W_r = ca.SX.sym("W_r", self.inputs)
        self._W_F = ca.SX.sym("W_F", shape.force_load.weighed_rows(model))
        self._load = ca.SX.sym("load", shape.force_load.count(model))
        self._e = ca.densify(skill.error(model, self._Q, self._target[: self._numbers_of_skill]))
        self._L = weighted_square(self._e, self._W)

    @property
    def anchor(self) -> slice:
        """The entries of a target that are the anchor of the chart."""
        first = self._numbers_of_skill - self.model.space.n_sample_numbers
        return slice(first, first + self.model.space.n_anchor)

    @cached_property
    def error(self) -> BatchFunction:
        """Q, target -> e (rows,)."""
        return BatchFunction(ca.Function("e", [self._Q, self._target], [self._e]))

    @property
    def _rate(self) -> ca.SX:
        return ca.jtimes(self._e, self._Q, self._Qdot)

    @cached_property
    def cost(self) -> BatchFunction:
        """x, u, target, W, [W_r; W_F], numbers of the load -> Lbar."""
        anchor = self._target[self.anchor]
        F = self.shape.force_load.weighed_force(self.model, self._Q, self._Qdot, self._u, anchor, self._load)
        L = self._L + weighted_square(self._u, self._W_r) + weighted_square(F, self._W_F)
        arguments = [self._x, self._u, self._target, self._W, ca.vertcat(self._W_r, self._W_F), self._load]
        return BatchFunction(ca.Function("Lbar", arguments, ca.cse([L])), native=True)

    @cached_property
    def gauss_newton(self) -> BatchFunction:
        """Q, W, target, slope -> what the Gauss-Newton model of the cost e'We at a node is made of.

        e is the residual of the stage's skill and W the diagonal of its weights. The results are e'We, e'We_tau,
        e_tau'We_tau, then E'We (n,), E'We_tau (n,) and triu(E'WE), row by row (n n,). E is the derivative of e by Q,
        and e_tau that by the stage's duration, with which the target moves by `slope`.
        """
        slope = ca.SX.sym("slope", self.numbers)
        e = self._e
        W = self._W
        E = ca.jacobian(self._e, self._Q)
        hessian = ca.triu(E.T @ (ca.diag(W) @ E))
        e_tau = ca.jtimes(e, self._target, slope)
        scalars = [self._L, ca.dot(W * e, e_tau), weighted_square(e_tau, W)]
        of_positions = [ca.densify(E.T @ (W * e)), ca.densify(E.T @ (W * e_tau)), _row_by_row(hessian)]
        outputs = ca.cse([*scalars, *of_positions])
        return BatchFunction(ca.Function("cost", [self._Q, W, self._target, slope], outputs), native=True)

    @cached_property
    def residual_curvature(self) -> BatchFunction:
        """Q, W, target -> upper triangle of sum_i W_i e_i d2e_i/dQ2 (n n): half of what e'We has besides E'WE."""
        e = self._e
        E = ca.jacobian(e, self._Q)
        hessian, _ = ca.hessian(self._L, self._Q)
        curvature = ca.triu(hessian / 2 - E.T @ (ca.diag(self._W) @ E))
        arguments = [self._Q, self._W, self._target]
        return BatchFunction(ca.Function("curvature", arguments, ca.cse([_row_by_row(curvature)])), native=True)

    @cached_property
    def _end(self) -> ca.SX:
        """Rows of the error the stage ends by, then of its rate where that counts, then of vectors. Eq. (18)."""
        end = self.shape.end
        rows = list(end.rows)
        if not rows:
            return self._bounded_vectors
        return ca.vertcat(self._e[rows], self._rate[rows] if end.has_rates else ca.SX(0, 1), self._bounded_vectors)

    @property
    def _bounded_vectors(self) -> ca.SX:
        """Components of the vectors d whose norms are bounded, of the object and of the momentum, one after the other.

        Windows bound each of c components by tolerance / sqrt(c), which keeps |d| within the tolerance: the rows of
        velocities and momenta then are linear in the rates.
        """
        measures = self.shape.end.measures
        if not measures:
            return ca.SX(0, 1)
        vectors = self._vectors_of_object if self.shape.object_names else {}
        if not vectors.keys() >= set(measures):
            vectors = {**vectors, **self._momenta}
        return ca.SX(ca.vertcat(*(component for measure in measures for component in vectors[measure])))

    @property
    def _momenta(self) -> dict[str, list[ca.SX]]:
        """Components of linear momentum, and of the angular one about the centre of mass, of robot and load.

        That of wheels is none of them: a robot whose wheels have taken its turn up is at rest.
        """
        d = self.model.space.dimension
        numbers = self._target[self._numbers_of_skill + self._numbers_of_object :]
        momentum = self.shape.end_load.momentum_about_centre(self.model)
        components = ca.vertsplit(momentum(self._x, self._target[self.anchor], numbers))
        return dict(zip(MOMENTA, (components[:d], components[d:]), strict=True))

    @property
    def _vectors_of_object(self) -> dict[str, list[ca.SX]]:
        """Components of what end conditions may bound of a held object: its offset, turn and velocities.

        The object moves rigidly with a gripper of pose (p, q): it is at p + q r, turned by q q_r, where (r, q_r) is its
        pose in the gripper's frame. A turn by an angle a from the destination counts as 2 sin(a / 2), the length of a
        quaternion's vector doubled.
        """
        space = self.model.space
        gripper = self.shape.object_names[0]
        anchor = self._target[: self._numbers_of_skill][self.anchor]
        of_object = self._target[self._numbers_of_skill :][: self._numbers_of_object]
        pose_in_gripper, destination = ca.vertsplit(of_object, space.n_pose)
        gripper_pose = self.model.charted(self._Q, anchor)[self.model.pose_rows[gripper]]
        p, q = space.to_3d(ca.vertsplit(gripper_pose))
        r, q_r = space.to_3d(ca.vertsplit(pose_in_gripper))
        wanted_position, wanted_attitude = space.to_3d(ca.vertsplit(destination))
        position = add(p, rotate(q, r))
        attitude = product(q, q_r)
        turned = product(conjugate(wanted_attitude), attitude)
        velocity = ca.jtimes(ca.vertcat(*position), self._Q, self._Qdot)
        quaternion_rate = ca.jtimes(ca.vertcat(*attitude), self._Q, self._Qdot)
        spin = product(ca.vertsplit(quaternion_rate), conjugate(attitude))
        offset = add(position, scaled(wanted_position, -1))
        offset_components, turn_components = self._components_in_space(offset, scaled(turned[1:], 2))
        velocity_components, spin_components = self._components_in_space(ca.vertsplit(velocity), scaled(spin[1:], 2))
        components = (offset_components, turn_components, velocity_components, spin_components)
        return dict(zip(MEASURES, components, strict=True))

    def _components_in_space(
        self, linear: Sequence[ca.SX], angular: Sequence[ca.SX]
    ) -> tuple[list[ca.SX], list[ca.SX]]:
        """Return the components of a linear and an angular vector (3,) that there are in the robot's space."""
        space = self.model.space
        components = space.twist(linear, angular)
        return components[: space.dimension], components[space.dimension :]

    @property
    def end_rows(self) -> int:
        """Number of rows of the end condition, rates and components of vectors included."""
        end = self.shape.end
        return len(end.rows) * (2 if end.has_rates else 1) + sum(self._component_counts)

    @property
    def _component_counts(self) -> tuple[int, ...]:
        """Number of components of each of the vectors whose norms are bounded."""
        return component_counts(self.shape.end.measures, self.model.space.dimension)

    @cached_property
    def end(self) -> "ConstraintFunctions":
        """x, target -> rows of the end condition."""
        return ConstraintFunctions(self._x, self._target, self._end)

    @cached_property
    def error_rows(self) -> "ConstraintFunctions":
        """x, target -> e (rows,)."""
        return ConstraintFunctions(self._x, self._target, self._e)

    @cached_property
    def met(self) -> BatchFunction:
        """x, [target; centers; half widths], margin -> 1 if the end condition (18) holds there, else 0.

        A row of the robot's error has to be within margin times its half width of its center. The components of a
        vector, of the object or of the momentum, count together, by their length. A little slack lets a solution at the
        edge count that a solver ended within its own tolerance.
        """
        sizes = np.cumsum([0, self.numbers, self.end_rows, self.end_rows])
        margin = ca.SX.sym("margin")
        end_numbers = ca.SX.sym("numbers", int(sizes[-1]))
        target, centers, half_widths = ca.vertsplit(end_numbers, sizes.tolist())
        rows = self.end.value.function(self._x, target) - centers
        counts = [1] * (self.end_rows - sum(self._component_counts)) + list(self._component_counts)
        first_rows = np.cumsum([0, *counts]).tolist()
        lengths = [ca.norm_2(error) for error in ca.vertsplit(rows, first_rows)]
        largest_lengths = [ca.norm_2(bound) for bound in ca.vertsplit(half_widths, first_rows)]
        allowed = ca.vertcat(*largest_lengths) * margin
        holds = ca.vertcat(*lengths) <= allowed + ca.fmin(SLACK, SLACK_SHARE * allowed)
        return BatchFunction(ca.Function("met", [self._x, end_numbers, margin], [ca.mmin(holds)]))

    def prepare(self) -> tuple[BatchFunction, ...]:
        """Build what `sqp` evaluates and return it: of the end condition, where there is one, else of the cost."""
        if self.end_rows:
            return self.met, *self.end.prepare()
        return self.error, self.cost, self.gauss_newton

    def step(self, discretization: str) -> ca.Function:
        """Return x (2n,), u, dt, anchor of the chart -> x after dt under a constant u."""
        of_input = self.shape.input
        return self.model.cached(
            ("step", of_input, discretization), lambda: _motion_over_interval(self.model, of_input, discretization)
        )


def force_residual(model: RobotModel, load: LoadKind) -> IntervalFunctions:
    """Return the residual of what force costs, rows over intervals sqrt(h) F (n,), of which the squares are integrals.

    F is the force of the low-level law at the beginning of an interval, along the base's own axes (paper eq. (7)). It
    is quadratic in velocities and linear in the acceleration, so that a time slowed down by sqrt(h) takes h out of it:

        sqrt(h) F(Q, v, u) = F(Q, sqrt(h) v, Qdot+ - Qdot) / sqrt(h).

    The argument of the rows is the anchor of the chart, then the numbers of the load.
    """
    return model.cached((force_residual, load), lambda: _force_residual(model, load))


def _force_residual(model: RobotModel, load: LoadKind) -> IntervalFunctions:
    """Write the residual of what force costs as an expression, F(Q, sqrt(h) v, dv) / sqrt(h) where an interval begins.

    F is the force of the low-level law; with dv = Qdot+ - Qdot and h the length of the interval this is sqrt(h) F of
    the motion itself, see `force_residual`.

    Args:
        model: The robot.
        load: The kind of load that the grippers hold, which decides the expression of F.
    """
    n = model.n
    x = ca.SX.sym("x", 2 * n)
    dv = ca.SX.sym("dv", n)
    h = ca.SX.sym("h")
    argument = ca.SX.sym("argument", model.space.n_anchor + load.count(model))
    # The anchor is the attitude about which the window's coordinates are a chart; numbers are those of the load.
    anchor, numbers = ca.vertsplit(argument, [0, model.space.n_anchor, argument.numel()])
    motion = OwnMotion.in_chart(model, x[:n], ca.sqrt(h) * x[n:], dv, anchor)
    F = load.own_force(model, motion, numbers)

    def jacobian() -> ca.SX:
        F_by = load.own_force_jacobian(model, motion, numbers, by=ca.vertcat(x, dv, h))
        scale_by = ca.jacobian(1 / ca.sqrt(h), ca.vertcat(x, dv, h))
        return ca.SX(F_by / ca.sqrt(h) + F @ scale_by)

    return IntervalFunctions(x, dv, h, argument, F / ca.sqrt(h), ends=(0,), jacobian=jacobian)


def rate_residual(model: RobotModel) -> RateFunctions:
    """Return the rows sqrt(d) du/d (n,): their squares are integrals of the squared jerk about an interval's beginning.

    The acceleration changes by du from the middle of the interval before to the middle of this one, in
    d = (h- + h) / 2.
    """

    def build() -> RateFunctions:
        return RateFunctions(
            range(model.n), lambda u_before, u, h_before, h: (u - u_before) / ca.sqrt((h_before + h) / 2)
        )

    return model.cached(rate_residual, build)


def stage_functions(model: RobotModel, shape: StageShape) -> StageFunctions:
    """Return the functions of the stages of a shape, the same ones for every call; the model owns them."""
    return model.cached((StageFunctions, shape), lambda: StageFunctions(model, shape))


class StageCosts:
    """Errors, costs and end conditions of one robot's stages on arrays of states."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model

    def _functions_of(self, stage: Stage, with_end: bool = False) -> StageFunctions:
        """Return the functions of a stage; without its end condition stages of one skill share them."""
        of_stage = stage_shape(stage)
        if with_end:
            return stage_functions(self.model, end_shape(of_stage))
        shape = replace(cost_shape(of_stage), input=of_stage.input, force_load=of_stage.force_load)
        return stage_functions(self.model, shape)

    def errors(self, stage: Stage, X: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return the stage's error at each state (K, rows) [m, rad]; X is (K, 2n).

        Against what its cost follows at times `since` its start (K,) [s]; without them against its target.
        """
        return self._functions_of(stage).error(X[:, : self.model.n], stage.wanted(since), rows=len(X))[0]

    def ends(self, stage: Stage, X: np.ndarray) -> np.ndarray:
        """Return the rows of the end condition (18) at each state (K, rows), rates relative to its target's."""
        return np.asarray(
            self._functions_of(stage, True).end.value(X, stage.target, rows=len(X))[0] - stage.end.centers
        )

    def at(self, stage: Stage, X: np.ndarray, u: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return Lbar (K,) at states X (K, 2n) under accelerations u (K, n). Paper eq. (10)."""
        W = stage.weights
        W_r = stage.control_weights
        u = self.inputs(stage, X, u)
        return self._functions_of(stage).cost(X, u, stage.wanted(since), W, W_r, stage.load_numbers, rows=len(X))[0][
            :, 0
        ]

    def of_states(self, stage: Stage, X: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return the part of Lbar (K,) that the states X (K, 2n) make, without the control's."""
        wanted = stage.wanted(since)
        return self._functions_of(stage).cost(X, 0.0, wanted, stage.weights, 0.0, stage.load_numbers, rows=len(X))[0][
            :, 0
        ]

    def inputs(self, stage: Stage, X: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the inputs of a stage at Qddot = u: u (K, n), or the rates of J_C v (K, n_twists)."""
        if stage.input == "joint":
            return u
        n = self.model.n
        anchor = stage.target[self._functions_of(stage).anchor]
        return self._twist_rates(X[:, :n], X[:, n:], u, anchor, rows=len(X))[0]

    @cached_property
    def _twist_rates(self) -> BatchFunction:
        """Q, Qdot, u, anchor -> J_C vdot + Jdot_C v (n_twists,)."""
        space = self.model.space
        Q, Qdot, u = (ca.SX.sym(name, self.model.n) for name in ("Q", "Qdot", "u"))
        anchor = ca.SX.sym("anchor", space.n_anchor)
        coordinates = space.charted_coordinates(Q, anchor)
        vdot = space.charted_acceleration(Q, Qdot, u)
        drift = self.model.Jdot_v(coordinates, space.charted_velocity(Q, Qdot))
        rates = self.model.J_C(coordinates) @ vdot + drift
        return BatchFunction(ca.Function("a", [Q, Qdot, u, anchor], [ca.densify(rates)]))

    def met(self, stage: Stage, X: np.ndarray, margin: float = 1.0) -> np.ndarray:
        """Return whether the end condition (18) holds at each state (K,), its tolerances widened by `margin`."""
        if not stage.end.has_condition:
            return np.zeros(len(X), bool)
        return np.asarray(self._functions_of(stage, True).met(X, stage.end_numbers, margin, rows=len(X))[0][:, 0] > 0)

    def end_error(self, stage: Stage, x: np.ndarray, allowance: np.ndarray | float = 0.0) -> float:
        """Compute how far a state is from meeting a stage's end condition (18): the largest error over its tolerance.

        At most 1 where the condition is met. Rows that are components of one measure (of an object's position, for
        example) count together, by their length.

        Args:
            stage: The stage.
            x: The state, (2n,).
            allowance: What is added to the tolerance of each row, (rows,) or () [m, rad, m/s, rad/s].

        Returns:
            The ratio; NaN for a stage without an end condition.
        """
        if not stage.end.has_condition:
            return np.nan
        first_rows = np.cumsum([0, *stage.end.component_numbers[:-1]])
        squares = np.square([self.ends(stage, x[None])[0], stage.end.half_widths + allowance])
        errors, tolerances = np.sqrt(np.add.reduceat(squares, first_rows, axis=1))
        return float(np.max(errors / tolerances))

    def end_deviations(self, stage: Stage, x: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """Return the standard deviations of the rows of an end condition (rows,), measured at x (2n,).

        Those of the measured state's errors, (2n,) and independent, through the rows' derivatives: sqrt(J^2 sigma^2).
        """
        _, J = self._functions_of(stage, True).end.with_jacobian(x, stage.target)
        return np.asarray(np.sqrt(J.reshape(-1, len(x)) ** 2 @ deviations**2))


def _row_by_row(matrix: ca.SX) -> ca.SX:
    """Return all entries of a matrix as a column."""
    return ca.vec(ca.densify(matrix.T))


def _motion_over_interval(model: RobotModel, stage_input: str, discretization: str) -> ca.Function:
    """Build the function x, u, dt, anchor of the chart -> the state after an interval dt under a constant u.

    For accelerations of Q it is the double integrator, exact (8), or by explicit Euler as printed (20). For those of
    poses (task-space input) it is one classical Runge-Kutta step of the kinematics, or Euler.

    Args:
        model: The robot.
        stage_input: What u accelerates, `joint` or `task`.
        discretization: `exact` or `euler`.
    """
    dt = ca.SX.sym("dt")
    x = ca.SX.sym("x", 2 * model.n)
    u = ca.SX.sym("u", model.n_inputs(stage_input))
    anchor = ca.SX.sym("anchor", model.space.n_anchor)
    if stage_input == "joint":
        x_next = motion.step(discretization)(x, u, dt)
    elif discretization == "euler":
        x_next = x + dt * model.f_2(x, u, anchor)
    else:
        x_next = runge_kutta(lambda x: model.f_2(x, u, anchor), x, dt)
    return ca.Function("F", [x, u, dt, anchor], [x_next], ["x", "u", "dt", "anchor"], ["x_next"])
