"""A task made computable: the robot's model, the stages as numbers, the functions of the skills on arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import RowFunction
from psmpc_cli.ocp.objective import StageFunctions, StageShape, stage_functions
from psmpc_cli.ocp.skills import SKILLS, Posture
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.object import ObjectSpec, OnObject
from psmpc_cli.specs.parts import Space
from psmpc_cli.specs.robot import Limits, RobotSpec, resolve_limits, rows, stack
from psmpc_cli.specs.task import SkillSpec, StageSpec, TaskSpec, TrajectorySpec

POSTURE = 1e-3
"""Weight of a redundant arm's posture, over the largest of its pose."""

FOLLOWED = 41
"""Points of the object's predicted motion that a cost follows: at 10 deg/s over 4 s straight to 0.03 mm at 0.6 m."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A desired trajectory: values (T, rows) at times (T,) [s] since the stage began.

    Between them numbers change at a constant rate, and attitudes turn at one about an axis (Shoemake: Animating
    rotation with quaternion curves, 1985).

    Attributes:
        attitudes: First columns of unit quaternions; from row to row each is the nearer one of the two for an attitude.
    """

    times: np.ndarray
    values: np.ndarray
    attitudes: tuple[int, ...] = ()

    @cached_property
    def _angles(self) -> np.ndarray:
        """Angle by which the quaternion of each column turns from row to row (T - 1, rows) [rad]; 0 of a number."""
        angles = np.zeros((len(self.times) - 1, self.values.shape[1]))
        for at in self.attitudes:
            q = self.values[:, at : at + 4]
            apart, near = (np.linalg.norm(q[1:] + sign * q[:-1], axis=1) for sign in (-1, 1))
            angles[:, at : at + 4] = 2 * np.arctan2(apart, near)[:, None]
        return angles

    def at(self, since: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return the values at times since the stage began (...,) [s], and their rates just after, (..., rows) each."""
        k = np.clip(self.times.searchsorted(since, side="right") - 1, 0, len(self.times) - 2)
        steps = np.diff(self.times)[k][..., None]
        angles = self._angles[k]
        inside = np.asarray((since >= self.times[0]) & (since < self.times[-1]))
        s = np.clip((since - self.times[k])[..., None] / steps, 0.0, 1.0)
        before = self.values[k]
        after = self.values[k + 1]
        whole = _sinc(angles)
        values = ((1 - s) * _sinc((1 - s) * angles) * before + s * _sinc(s * angles) * after) / whole
        rates = (np.cos(s * angles) * after - np.cos((1 - s) * angles) * before) / whole / steps
        return values, rates * inside[..., None]


def _sinc(angle: np.ndarray) -> np.ndarray:
    """Return sin(angle) / angle."""
    return np.asarray(np.sinc(angle / np.pi))


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of the task, resolved for one robot.

    Attributes:
        target: Target in the order of Q (n,) or xi (m,) [m, rad]; of a trajectory, its last value.
        trajectory: The desired trajectory the cost follows, or None where it is the target throughout.
        weights: Diagonal of W_q or W_p, as `target`.
        control_weights: Diagonal of W_r, one per input.
        end_rows: Rows of the error on which the end condition (18) stands; empty where `at` is given.
        tolerance: Its tolerance, one per end row [m, rad].
        end_velocity: Bound on the rate of those rows [m/s, rad/s], or None.
        hold: How long the end condition must be met without a break [s].
        at: Fixed switching time [s], or None.
        dwell: Minimum duration [s], that of the trajectory at least.
        onset_rows: Rows of the control whose norm marks the actual start.
        attitudes: Of a spatial robot, the first of the target's numbers of each quaternion, by frame.
        signs: In a chart, by which each of these quaternions was multiplied.
        on_object: By frame, the pose in the object's frame at which its target is; the target follows the object.
        drift: Rate of the target's rows of error that this makes (rows,) [m/s, rad/s]; 0 of a target at rest.
        object_state: Pose and velocity of the object that the target is for, (6,) or (13,); empty if it is for none.
    """

    index: int
    name: str
    space: Space
    input: str
    priority: float
    target: np.ndarray
    trajectory: Trajectory | None
    weights: np.ndarray
    control_weights: np.ndarray
    end_rows: tuple[int, ...]
    tolerance: np.ndarray
    end_velocity: float | None
    hold: float
    at: float | None
    dwell: float
    limits: Limits
    onset_rows: tuple[int, ...]
    attitudes: Mapping[str, int] = field(default_factory=dict)
    signs: tuple[float, ...] = ()
    on_object: Mapping[str, np.ndarray] = field(default_factory=dict)
    drift: np.ndarray | float = 0.0
    object_state: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def at_object(self, pose_rows: Mapping[str, slice], pose: np.ndarray, v: np.ndarray) -> "Stage":
        """Return the stage with its target where an object of a pose and a velocity has it.

        The angular rate of an error is that near the target, where alone end conditions look at it.
        """
        space = space_of_pose(len(pose))
        target = self.target.copy()
        drift = np.zeros(len(self.weights))
        for frame, inside in self.on_object.items():
            rate = space.carried_rate(pose, v, inside)
            number = list(pose_rows).index(frame)
            target[pose_rows[frame]] = space.composed(pose, inside)
            drift[len(rate) * number : len(rate) * (number + 1)] = rate
        return replace(self, target=target, drift=drift, object_state=np.concatenate([pose, v]))

    def following(
        self, pose_rows: Mapping[str, slice], body: FreeBody, state: np.ndarray, elapsed: float, horizon: float
    ) -> "Stage":
        """Return the stage with a cost that follows the object's free motion over the horizon, its target where it is.

        Args:
            pose_rows: Rows of each frame's pose in xi.
            body: The object.
            state: Its pose and velocity now, (6,) or (13,).
            elapsed: Time since the stage began [s].
            horizon: How far ahead the cost looks [s].
        """
        pose, v = np.split(state, [body.space.n_pose])
        ahead = np.linspace(0.0, horizon, FOLLOWED)
        placed = [self.at_object(pose_rows, *body.predicted(pose, v, each)) for each in ahead]
        values = np.array([stage.target for stage in placed])
        return replace(placed[0], trajectory=Trajectory(elapsed + ahead, values, tuple(self.attitudes.values())))

    def in_chart(self, anchor: np.ndarray, joints: np.ndarray, signs: Mapping[str, float]) -> "Stage":
        """Return the stage of a spatial robot with the numbers of its target that a sample sets.

        Args:
            anchor: Attitude about which the chart is (4,).
            joints: Posture to which redundant joints are drawn (joints,) [rad, m].
            signs: Of the target's quaternions, by frame: of the two for one attitude the one meant.
        """

        def placed(numbers: np.ndarray) -> np.ndarray:
            numbers = numbers.copy()
            for frame, at in self.attitudes.items():
                numbers[..., at : at + 4] *= signs[frame]
            more = np.broadcast_to(of_sample, (*numbers.shape[:-1], len(of_sample)))
            return np.concatenate([numbers, more], axis=-1)

        of_sample = np.concatenate([anchor, joints])
        if not self.attitudes and not len(of_sample):
            return self
        path = self.trajectory and replace(self.trajectory, values=placed(self.trajectory.values))
        taken = tuple(signs[frame] for frame in self.attitudes)
        return replace(self, target=placed(self.target), trajectory=path, signs=taken)

    @cached_property
    def end_tolerance(self) -> np.ndarray:
        """Tolerance of each end row, positions first, then rates where they count. Paper eq. (18)."""
        if self.end_velocity is None:
            return self.tolerance
        return np.concatenate([self.tolerance, np.full(len(self.end_rows), self.end_velocity)])

    @cached_property
    def end_drift(self) -> np.ndarray:
        """About what each end row is bounded: 0, or the rate that a moving target gives its error."""
        rows = list(self.end_rows)
        counts = self.end_velocity is not None
        drift = np.broadcast_to(self.drift, self.weights.shape)[rows]
        return np.concatenate([np.zeros(len(rows)), drift[: len(rows) * counts]])

    @cached_property
    def end_numbers(self) -> np.ndarray:
        """Target, drift and tolerance, as `StageFunctions.met` takes them."""
        return np.concatenate([self.target, self.end_drift, self.end_tolerance])

    @property
    def waypoints(self) -> np.ndarray:
        """What the target leads through (T, rows) [m, rad]: the rows of the trajectory, or the target alone."""
        return self.target[None] if self.trajectory is None else self.trajectory.values

    def reference(self, since: np.ndarray | float | None) -> np.ndarray:
        """Return what the cost follows at times since the stage began (...,) [s], (..., rows).

        The target alone (rows,) where it stands still, or without times.
        """
        return self.target if self.trajectory is None or since is None else self.trajectory.at(since)[0]


class StageCosts:
    """Errors, costs and end conditions of one robot's stages on arrays of states; `native`, as compiled C."""

    def __init__(self, model: RobotModel, native: bool = False) -> None:
        self.model = model
        self._native = native
        self._functions: dict[tuple[str, str, tuple[int, ...], bool], StageFunctions] = {}

    def _of(self, stage: Stage, end_rows: tuple[int, ...] = ()) -> StageFunctions:
        key = (stage.space, stage.input, end_rows, bool(end_rows) and stage.end_velocity is not None)
        if key not in self._functions:
            self._functions[key] = stage_functions(self.model, StageShape(*key), self._native)
        return self._functions[key]

    def errors(self, stage: Stage, X: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return the stage's error at each state (K, rows) [m, rad]; X is (K, 2n).

        Against what its cost follows at times `since` its start (K,) [s]; without them against its target.
        """
        return self._of(stage).error(X[:, : self.model.n], stage.reference(since), rows=len(X))[0]

    def ends(self, stage: Stage, X: np.ndarray) -> np.ndarray:
        """Return the rows of the end condition (18) at each state (K, rows), rates relative to its target's."""
        return np.asarray(self._of(stage, stage.end_rows).end.value(X, stage.target, rows=len(X))[0] - stage.end_drift)

    def at(self, stage: Stage, X: np.ndarray, u: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return Lbar (K,) at states X (K, 2n) under accelerations u (K, n). Paper eq. (10)."""
        W = stage.weights
        W_r = stage.control_weights
        u = self.inputs(stage, X, u)
        return self._of(stage).cost(X, u, stage.reference(since), W, W_r, rows=len(X))[0][:, 0]

    def of_states(self, stage: Stage, X: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """Return the part of Lbar (K,) that the states X (K, 2n) make, without the control's."""
        return self._of(stage).cost(X, 0.0, stage.reference(since), stage.weights, 0.0, rows=len(X))[0][:, 0]

    def inputs(self, stage: Stage, X: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the inputs of a stage at Qddot = u: u (K, n), or the acceleration of xi (K, m), J_C u + Jdot_C v."""
        n = self.model.n
        return u if stage.input == "joint" else self._pose_acceleration(X[:, :n], X[:, n:], u, rows=len(X))[0]

    @cached_property
    def _pose_acceleration(self) -> RowFunction:
        Q, Qdot, u = (ca.SX.sym(name, self.model.n) for name in ("Q", "Qdot", "u"))
        acceleration = self.model.J_C(Q) @ u + self.model.Jdot_Qdot(Q, Qdot)
        return RowFunction(ca.Function("a", [Q, Qdot, u], [ca.densify(acceleration)]))

    def met(self, stage: Stage, X: np.ndarray, margin: float = 1.0) -> np.ndarray:
        """Return whether the end condition (18) holds at each state (K,), its tolerances widened by `margin`."""
        if not stage.end_rows:
            return np.zeros(len(X), bool)
        return np.asarray(self._of(stage, stage.end_rows).met(X, stage.end_numbers, margin, rows=len(X))[0][:, 0] > 0)

    def end_error(self, stage: Stage, x: np.ndarray, allowance: np.ndarray | float = 0.0) -> float:
        """Compute the largest error of a stage's end condition (18) at x (2n,) over its tolerance; NaN without one.

        Args:
            stage: The stage.
            x: The state.
            allowance: What is added to the tolerance of each row, (rows,) or () [m, rad, m/s, rad/s].
        """
        if not stage.end_rows:
            return np.nan
        return float(np.max(np.abs(self.ends(stage, x[None])) / (stage.end_tolerance + allowance)))

    def end_deviations(self, stage: Stage, x: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """Return the standard deviations of the rows of an end condition (rows,), measured at x (2n,).

        Those of the measured state's errors, (2n,) and independent, through the rows' derivatives: sqrt(J^2 sigma^2).
        """
        _, J = self._of(stage, stage.end_rows).end.with_jacobian(x, stage.target)
        return np.asarray(np.sqrt(J.reshape(-1, len(x)) ** 2 @ deviations**2))


def in_own_chart(
    model: RobotModel, stage: Stage, Q: np.ndarray, v: np.ndarray, since: float | None = None
) -> tuple[Stage, np.ndarray]:
    """Return a stage of a problem and a state (2n,), both in the chart about the attitude in Q (nq,).

    Of the two quaternions for an attitude of the target it has the nearer one; of a trajectory the target is that at a
    time `since` the stage began [s], its end without one.
    """
    chart = model.space.chart_at(Q)
    x = np.asarray(chart.enter(Q[None], v[None])[0])
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    target = stage.reference(since)
    nearer = {frame: float(target[at : at + 4] @ poses[frame][3:]) for frame, at in stage.attitudes.items()}
    signs = {frame: np.sign(w) or 1.0 for frame, w in nearer.items()}
    return stage.in_chart(chart.anchor, model.space.posture(Q[model.space.joint_coordinates]), signs), x


@dataclass(frozen=True, eq=False)
class Problem:
    """What controllers and solvers need of a task.

    Attributes:
        task: The task.
        model: Its robot as CasADi functions.
        stages: Its stages, resolved for the robot.
        costs: Errors, costs and end conditions of the stages on arrays.
    """

    task: Task
    model: RobotModel
    stages: tuple[Stage, ...]
    costs: StageCosts

    @property
    def spec(self) -> TaskSpec:
        """The task as validated data."""
        return self.task.spec


def build_problem(task: Task) -> Problem:
    """Build the problem of a task."""
    model = RobotModel(task.robot)
    solver = task.spec.solver
    costs = StageCosts(model, solver.compiled and solver.kind == "sqp")
    return Problem(task, model, build_stages(task.spec, task.robot, model), costs)


def build_stages(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> tuple[Stage, ...]:
    """Return the task's stages, resolved; target angles become the nearest equivalent ones along the sequence."""
    waypoints = _unwrapped_waypoints(task, robot, model)
    stages = (_stage(i, task, robot, model, values) for i, values in enumerate(waypoints))
    return tuple(_on_object(stage, task, model) for stage in stages)


def _on_object(stage: Stage, task: TaskSpec, model: RobotModel) -> Stage:
    """Return a stage with the poses of its target that are relative to the object, and their number of turns."""
    target = task.stages[stage.index].target
    target_object = task.object
    if target_object is None or isinstance(target, TrajectorySpec):
        return stage
    frames = [frame for frame, aim in target.items() if isinstance(aim, OnObject)]
    targets = {frame: stage.target[model.pose_rows[frame]] for frame in frames}
    inside = {frame: model.space.relative(target, target_object.pose) for frame, target in targets.items()}
    return replace(stage, on_object=inside)


def _stage(index: int, task: TaskSpec, robot: RobotSpec, model: RobotModel, waypoints: np.ndarray) -> Stage:
    spec = task.stages[index]
    skill = task.skills[spec.skill]
    trajectory = None
    attitudes = SKILLS[skill.space].attitudes(model)
    if isinstance(spec.target, TrajectorySpec):
        trajectory = Trajectory(np.array(spec.target.times), waypoints, tuple(attitudes.values()))
    end = spec.ends_when if spec.at is None else None
    control = skill.weights.control
    if isinstance(control, float | int):
        control_weights = np.full(model.n if skill.input == "joint" else model.m, float(control))
    else:
        control_weights = stack(control, robot, skill.input, of_error=True)
    return Stage(
        index=index,
        name=spec.name,
        space=skill.space,
        input=skill.input,
        priority=spec.priority,
        target=waypoints[-1],
        trajectory=trajectory,
        weights=_weights(skill, robot, model),
        control_weights=control_weights,
        end_rows=() if end is None else rows(end.coordinates, robot, skill.space),
        tolerance=np.zeros(0) if end is None else end.tolerances(robot, skill.space),
        end_velocity=None if end is None else end.velocity,
        hold=0.0 if end is None else end.hold,
        at=spec.at,
        dwell=spec.dwell if trajectory is None else max(spec.dwell, float(trajectory.times[-1])),
        limits=resolve_limits(robot, task.limits, skill.limits),
        onset_rows=rows(spec.onset if spec.onset is not None else ("all",), robot, "joint"),
        attitudes=attitudes,
    )


def _weights(skill: SkillSpec, robot: RobotSpec, model: RobotModel) -> np.ndarray:
    """Return the weights of the rows of the error; those of the posture of redundant arms follow from the poses'."""
    weights = stack(skill.weights.parts, robot, skill.space, missing=0.0, of_error=True)
    if SKILLS[skill.space].rows(model) == len(weights):
        return weights
    posture = []
    size = model.space.n_twist
    for number, arm in enumerate(robot.arms, start=1):
        own = weights[size * number : size * (number + 1)]
        links = robot.parts[arm]
        free = links > np.count_nonzero(own)
        posture.append(np.full(links, POSTURE * own.max() if free else 0.0))
    return np.concatenate([weights, *posture])


def _unwrapped_waypoints(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> list[np.ndarray]:
    """Return what every stage's target leads through, (T, numbers) each.

    Each angle is moved to the equivalent nearest to where the sequence is before: for the first row that is where
    the stage before leads to, for every other row it is the row before. Of an attitude's two quaternions each row has
    the one nearer to the row before.
    """
    Q = stack(task.initial, robot, "joint")
    posture = Posture(Q, np.asarray(model.g(Q)).ravel())
    found = []
    for spec in task.stages:
        space = task.skills[spec.skill].space
        skill = SKILLS[space]
        waypoints = _waypoints(spec, robot, space, task.object)
        turning = skill.angles(model)
        if spec.angles == "nearest":
            waypoints[:, turning] = np.unwrap(np.vstack([posture.xi[turning], waypoints[:, turning]]), axis=0)[1:]
        for at in skill.attitudes(model).values():
            q = waypoints[:, at : at + 4]  # a view
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0))[:, None]
        found.append(waypoints)
        posture = skill.after(model, posture, waypoints[-1])
    return found


def _waypoints(spec: StageSpec, robot: RobotSpec, space: Space, target_object: ObjectSpec | None) -> np.ndarray:
    """Return the rows of a stage's target as given, (T, rows); those relative to the object where it is first."""
    if isinstance(spec.target, TrajectorySpec):
        values = spec.target.stacked(robot, space)
    else:
        parts = {part: _placed(aim, target_object) for part, aim in spec.target.items()}
        values = stack(parts, robot, space)[None]
    return np.where(np.isnan(values), SKILLS[space].absent, values)


def _placed(aim: tuple[float, ...] | OnObject, target_object: ObjectSpec | None) -> tuple[float, ...]:
    """Return the numbers of a part of a target, the object being where it is at the start."""
    if not isinstance(aim, OnObject) or target_object is None:
        return () if isinstance(aim, OnObject) else aim
    at = (
        aim.object
        if not isinstance(aim.object, str)
        else target_object.grasp.at[aim.object]
        if target_object.grasp
        else ()
    )
    return tuple(space_of_pose(len(at)).composed(target_object.pose, at).tolist())
