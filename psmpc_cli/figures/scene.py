"""Where robot, object and targets of a run or a task are, and what happens when; nothing here draws."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike

from psmpc_cli.figures.style import readable
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.logs.verdicts import judge_monitor
from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.robot.geometry import Piece
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.geometry import ObstacleSpec, Shape
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import BASE
from psmpc_cli.specs.task import MonitorSpec

OBSTACLE_ROOM = 0.25
"""How far an obstacle may widen the view on either side, in sizes of what else is in it."""


@dataclass(frozen=True)
class Camera:
    """Where a drawing is seen from, in parallel projection.

    Attributes:
        azimuth, elevation: Direction from the scene to the viewer, from x towards y and from there towards z [deg].
        labels: Labels of the axes of the drawing: x, y or z, or the directions in it, from the origin as it is seen.
    """

    azimuth: float
    elevation: float
    labels: tuple[str, str] = ("to the right (m)", "upwards (m)")

    @property
    def axes(self) -> np.ndarray:
        """Directions in the inertial frame that are drawn to the right, up, and towards the viewer (3, 3)."""
        (ca, ce), (sa, se) = (np.round(f(np.radians([self.azimuth, self.elevation])), 15) for f in (np.cos, np.sin))
        return np.array([[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])

    def project(self, points: ArrayLike) -> np.ndarray:
        """Project points (..., 3) onto the drawing (..., 2) [m]."""
        return np.asarray(points @ self.axes[:2].T)

    def depth(self, points: np.ndarray) -> float:
        """Return how near to the viewer points (., 3) are on average [m]."""
        return float(np.mean(points @ self.axes[2]))

    def view(self, points: np.ndarray) -> Bbox:
        """Return the smallest part of the drawing, with a margin, that shows these points (., 3) [m]."""
        seen = self.project(points)
        low = seen.min(axis=0)
        high = seen.max(axis=0)
        size = (high - low) + 0.08 * float(np.max(high - low))
        size = np.maximum(size, [size[1] / 1.6, size[0] * 0.45])
        return Bbox([(low + high - size) / 2, (low + high + size) / 2])


PLAN = Camera(-90, 90, ("x (m)", "y (m)"))
OBLIQUE = Camera(-60, 25)
FRONT = Camera(-90, 0, ("x (m)", "z (m)"))
SIDE = Camera(0, 0, ("y (m)", "z (m)"))

CAMERAS = {2: PLAN, 3: OBLIQUE}
"""From where scenes of robots of each dimension are seen."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A run as a moving picture: where robot, object and targets are at any time.

    The log has the pose of an object with mass. One without mass rests at the pose the task gives until the stage that
    takes it ends. From then on it moves rigidly with the grippers: with their midpoint and the line from the first to
    the second, or with the one gripper. Once the stage that lets it go begins, or it is lost, it is drawn where it was.

    Attributes:
        run: The run.
        taken_at, released_at: When the object is taken, and when it is let go or lost [s]; infinite if never.
        lost: Whether it is lost: a monitor of the distance of two grippers finds them too far apart while they hold it.
    """

    run: Run
    taken_at: float
    released_at: float
    lost: bool

    @property
    def camera(self) -> Camera:
        """From where it is seen."""
        return CAMERAS[self.run.problem.model.dimension]

    @property
    def obstacles(self) -> Sequence[ObstacleSpec]:
        """What the robot does not touch."""
        return self.run.task.spec.obstacles

    @property
    def object_half_edges(self) -> np.ndarray:
        """Half the edges of the object (3,) [m]; 0 where the task has none."""
        spec = self.run.task.spec.object
        return half_edges(spec.shape if spec else ())

    def object_frame(self, time: float) -> np.ndarray | None:
        """Return the object's frame (4, 4) [m] at a time [s]; None where the task has no object."""
        spec = self.run.task.spec.object
        if spec is None:
            return None
        if "object/pose" in self.run:
            sample = int(np.searchsorted(self.run.time, time, side="right")) - 1
            return pose_frames(self.run["object/pose"][max(0, sample)])
        if time <= self.taken_at:
            return pose_frames(spec.pose)
        before, now = map(self.run.motion.coordinates_at, (self.taken_at, min(time, self.released_at)))
        return carried_frame(self.run.problem.model, pose_frames(spec.pose), before, now)

    def acting_stages(self, time: float) -> list[int]:
        """Return the stages that act from a time [s] on: the current one and those that start early."""
        spans = self.run.spans
        begun = [span for span in spans if (span.start if span.early is None else span.early) <= time]
        return [span.index for span in begun if time < span.end] or [begun[-1].index]

    def target_frames(self, stage: int, time: float) -> np.ndarray:
        """Compute the frames of base and end-effectors that a stage aims at, to draw them as targets.

        Args:
            stage: Index of the stage.
            time: When [s]: targets that are trajectories or relative to moving objects change with time.

        Returns:
            Homogeneous transforms (1 + arms, 4, 4) [m], base first. The position of a frame is NaN where the stage asks
            for no position of it, and its rotation is NaN where the stage asks for no attitude.
        """
        model = self.run.problem.model
        span = self._span_of(stage, time)
        placed_stage = self.run.problem_at(time).stages[stage] if span is None else self.run.followed(span)
        skill = skill_in(placed_stage.space)
        aim = placed_stage.wanted(0.0 if span is None else time - span.start)  # the target at this time
        # a target of joints says where a frame is only with the rest of the robot's posture
        posture_now = Posture(self.run.motion.coordinates_at(time), self.run.motion.poses_at(np.array([time]))[0])
        frames = pose_frames(skill.posture_after(model, posture_now, aim).xi.reshape(len(model.pose_rows), -1))
        frames[:, : model.dimension, 3] = skill.aims(model, aim)  # positions as the target has them
        positions, attitudes = frames_with_targets(model, placed_stage)
        frames[~positions, :3, 3] = np.nan
        frames[~attitudes, :3, :3] = np.nan
        return frames

    def _span_of(self, stage: int, time: float) -> Span | None:
        """Return the last span of a stage that has begun at a time [s], else its first; None of one never reached."""
        spans = [span for span in self.run.spans if span.index == stage]
        begun = [span for span in spans if span.start <= time]
        return begun[-1] if begun else spans[0] if spans else None

    def paths(self, since: float, time: float) -> np.ndarray:
        """Return the paths of base and end-effectors (1 + arms, ., 3) [m] between two times [s]."""
        motion = self.run.motion
        model = self.run.problem.model
        xi = motion.poses_at(np.r_[since, motion.time[(motion.time > since) & (motion.time < time)], time])
        frames = pose_frames(xi.reshape(len(xi), len(model.pose_rows), -1))
        return np.asarray(frames[..., :3, 3].swapaxes(0, 1))

    def points(self, time: float) -> np.ndarray:
        """Return points (., 3) [m] whose hull holds robot and object at a time [s]."""
        robot = points_around_robot(self.run.problem.model, self.run.motion.coordinates_at(time))
        frame = self.object_frame(time)
        return robot if frame is None else np.vstack([robot, box_corners(frame, self.object_half_edges)])

    def extent(self, times: Iterable[float]) -> np.ndarray:
        """Return points (., 3) [m] whose hull holds all that is drawn up to and at these times [s], shadows too."""
        all_times = list(times)
        tracks = self.paths(float(self.run.motion.time[0]), max(all_times))
        aims = [self.target_frames(stage, time)[:, :3, 3] for time in all_times for stage in self.acting_stages(time)]
        return points_with_shadows([*map(self.points, all_times)], [*tracks, *aims], self.obstacles, all_times)

    def events(self, time: float) -> list[str]:
        """Return what is on at a time [s]: the current stage, those that already act, whether the object is lost."""
        spans = self.run.spans
        current = [span for span in spans if span.start <= time]
        early = [span for span in spans if span.early is not None and span.early <= time < span.start]
        events = [readable(current[-1].name), *(f"{readable(span.name)} already acts" for span in early)]
        return events + ["object lost"] * bool(self.lost and time >= self.released_at)

    def switches(self) -> list[tuple[float, str]]:
        """Return when stages ended [s], and what to call that."""
        names = self.run.stage_names
        return [(time, f"{readable(names[index])} ends") for index, time in self.run.switches]

    def key_instants(self) -> list[tuple[float, str]]:
        """List the times at which a picture of the run is worth drawing, to choose the panels of snapshots.

        They are its start and end, early starts, switches, and the loss of the object. Those of them that are at most a
        sample apart are merged: one picture, with all their names.

        Returns:
            Pairs of a time [s] and what happens then, as a text for a title, by rising time.
        """
        start = float(self.run.motion.time[0])
        end = self.run.motion.end
        early = [(span.early, f"{readable(span.name)} starts") for span in self.run.spans if span.early is not None]
        instants = [(start, "start"), *early, *self.switches(), *[(self.released_at, "object lost")] * self.lost]
        # the end of the run, if nothing else on the list is at the same time
        instants += [(end, "end of the run")] * all(abs(time - end) > 1e-6 for time, _ in instants)
        merged: list[tuple[float, str]] = []
        for time, event in sorted(instants, key=lambda instant: instant[0]):
            if merged and time <= merged[-1][0] + self.run.task.spec.controller.sample_time:
                merged[-1] = merged[-1][0], f"{merged[-1][1]}, {event}"
            else:
                merged.append((time, event))
        return merged


def points_with_shadows(
    bodies: Sequence[np.ndarray],
    others: Sequence[np.ndarray],
    obstacles: Sequence[ObstacleSpec] = (),
    times: Sequence[float] = (0.0,),
) -> np.ndarray:
    """Collect the points that a view of a scene has to contain: of bodies, their shadows, paths and near obstacles.

    Shadows are straight below the bodies, on a floor at the height of the lowest of all points. Obstacles count as far
    as they are near the other points, see `nearby_points_of_obstacle`.

    Args:
        bodies: Points of bodies that cast shadows, arrays (., 3) [m].
        others: Points of what casts no shadow, such as paths, arrays (., 3) [m].
        obstacles: Obstacles; they may move.
        times: All times at which the obstacles are drawn in this view [s].

    Returns:
        The points (., 3) [m], without those of the arguments that are NaN.
    """
    body_points = _finite_points(np.vstack(bodies))
    # the empty array is for the case without others, which cannot be stacked
    points = np.vstack([body_points, _finite_points(np.vstack([*others, np.zeros((0, 3))]))])
    points = np.vstack(
        [points, *(nearby_points_of_obstacle(obstacle, time, points) for obstacle in obstacles for time in times)]
    )
    lowest = points[:, 2].min(initial=np.inf)
    return np.vstack([points, np.c_[body_points[:, :2], np.full(len(body_points), lowest)]])


def nearby_points_of_obstacle(obstacle: ObstacleSpec, time: float, points: np.ndarray) -> np.ndarray:
    """Return the points of an obstacle that a view should contain besides the other points that it shows.

    They are moved to within `OBSTACLE_ROOM` around the box of the other points, and there are none if the whole
    obstacle is farther away: to show all of an obstacle that is large or far would leave no room for the robot.

    Args:
        obstacle: The obstacle.
        time: When it is seen [s].
        points: The other points of the view (., 3) [m].

    Returns:
        Points (., 3) [m]; (0, 3) if the obstacle is not near.
    """
    low = points.min(axis=0)
    high = points.max(axis=0)
    room = OBSTACLE_ROOM * float(np.max(high - low))
    shape = obstacle.shape.shape
    frame = obstacle_frame(obstacle, time)
    if shape.kind == "box":
        obstacle_points = box_corners(frame, half_edges(shape.edges))
    elif shape.kind == "capsule":
        # the points of a sphere along the axes stand for each end
        around = shape.size[0] * np.vstack([np.eye(3), -np.eye(3)])
        obstacle_points = (in_inertial_frame(frame, capsule_ends(shape))[:, None] + around).reshape(-1, 3)
    else:  # of a half-space, the point of its face nearest to the middle of the others
        normal = frame[:3, :3] @ shape.size
        middle = (low + high) / 2
        obstacle_points = (middle - (middle - frame[:3, 3]) @ normal * normal)[None]
    is_near = (obstacle_points.min(axis=0) <= high + room).all() and (obstacle_points.max(axis=0) >= low - room).all()
    return np.clip(obstacle_points, low - room, high + room) if is_near else np.zeros((0, 3))


def obstacle_frame(obstacle: ObstacleSpec, time: float) -> np.ndarray:
    """Return the frame (4, 4) [m] of an obstacle at a time [s]."""
    frame = pose_frames(obstacle.pose)
    frame[: len(obstacle.velocity), 3] += time * np.array(obstacle.velocity)
    return frame


def capsule_ends(shape: Shape) -> np.ndarray:
    """Return the ends of the segment that a capsule is about (2, 3) [m], in its frame."""
    return np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * shape.size[1]


def capsules(model: RobotModel, pieces: Sequence[Piece], Q: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Return the segments (2, 3) and radii [m] of a robot's capsules at Q (nq,)."""
    frames = model.body_frames(Q)
    return [(in_inertial_frame(frames[piece.body], piece.ends), piece.shape.size[0]) for piece in pieces]


def _finite_points(points: np.ndarray) -> np.ndarray:
    """Return those of points (., 3) of which all coordinates are finite."""
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def frames_with_targets(model: RobotModel, stage: Stage) -> tuple[np.ndarray, np.ndarray]:
    """Tell for which frames of a robot a stage has a target position and for which a target attitude, to draw these.

    Targets of an arm's joints determine the pose of its end-effector only if the base has a target too. An arm that
    points at a point has this point as its position and no attitude.

    Args:
        model: The robot.
        stage: The stage.

    Returns:
        Two masks over the base and the end-effectors (1 + arms,): which have a position, and which an attitude.
    """
    # rows of the stage's error are relevant if they have a weight or are in its end condition
    asks_for_base = stage.relevant_rows[stage.parts[BASE].rows].all()
    positions = dict.fromkeys(model.pose_rows, False)
    attitudes = dict.fromkeys(model.pose_rows, False)
    for name in positions.keys() & stage.parts.keys():
        part_kind = stage.parts[name].kind  # whether the target is a pose, a point to look at, or joint coordinates
        relevant = stage.relevant_rows[stage.parts[name].rows]
        if part_kind.is_pose:
            positions[name] = bool(relevant[: model.dimension].any())
            attitudes[name] = bool(relevant[model.dimension :].any())
        else:
            positions[name] = bool(relevant.any() and (part_kind.is_point or asks_for_base))
            attitudes[name] = positions[name] and not part_kind.is_point
    return np.array(list(positions.values())), np.array(list(attitudes.values()))


def pointing_targets(model: RobotModel, stage: Stage) -> np.ndarray:
    """Return the points (arms, 3) [m] that a stage points at, none if it does not point; NaN of an arm without one."""
    aims = dict(zip(model.pose_rows, skill_in(stage.space).aims(model, stage.target), strict=True))
    points = [aims[name] for name, part in stage.parts.items() if part.kind.is_point]
    return np.pad(np.reshape(points, (-1, model.dimension)), ((0, 0), (0, 3 - model.dimension)))


def scene_of(run: Run) -> Scene:
    """Find when the object of a run is taken and let go or lost, and return the run as a scene."""
    spec = run.task.spec.object
    if spec is None:
        return Scene(run, np.inf, np.inf, False)
    ends = np.append(np.nan_to_num(run.stages["switch_time"], nan=np.inf), np.inf)  # [-1] is never
    # the stages in which the grippers hold the object: from when the stage before them ends until the last of them ends
    holding = run.task.spec.held_stages
    taken_at = float(ends[holding.start - 1])
    released_at = float(ends[holding.stop - 1])
    if "grasp/lost" in run:
        lost_at = run["grasp/opened_at"][run["grasp/lost"] == 1]
        end_of_hold = float(lost_at.min()) if len(lost_at) else released_at
        return Scene(run, taken_at, end_of_hold, lost=len(lost_at) > 0)
    parted_at = min((_time_grippers_parted(run, monitor) for monitor in run.task.spec.monitors), default=np.inf)
    lost = taken_at < parted_at < released_at
    return Scene(run, taken_at, parted_at if lost else released_at, lost)


def _time_grippers_parted(run: Run, monitor: MonitorSpec) -> float:
    """Find when a monitor first sees two grippers too far apart [s]; infinite if it does not."""
    if monitor.quantity != "distance" or len(monitor.of) != 2 or "base" in monitor.of:
        return np.inf
    upper = monitor.model_copy(update={"below_start_at_most": None, "at_least": None})
    verdict = judge_monitor(upper, run.arrays)
    return verdict.broken_at if np.isfinite(verdict.broken_at) else np.inf


def carried_frame(model: RobotModel, frame: np.ndarray, taken: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Compute the frame (4, 4) of an object at `now` (nq,), which the robot took at `taken` (nq,) in this frame."""
    return np.asarray(grasp_frame(model, now) @ np.linalg.inv(grasp_frame(model, taken)) @ frame)


def grasp_frame(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Compute the frame in which the object is held (4, 4) [m] at Q (nq,), with which it moves."""
    first, *others = pose_frames(model.poses(Q)[1:])
    if others:
        line = others[0][:3, 3] - first[:3, 3]
        planar = model.dimension == 2
        first = pose_frames([0, 0, np.arctan2(line[1], line[0])]) if planar else first.copy()
        first[:3, 3] = np.mean(pose_frames(model.poses(Q)[1:])[:, :3, 3], axis=0)
    return np.asarray(first)


def points_around_robot(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return points (., 3) [m] whose hull holds the robot at Q (nq,)."""
    shape = model.shape
    frames = model.body_frames(Q)
    parts = [(tool.body, shape.grippers[arm]) for arm, tool in model.spec.tools.items()]
    parts += [(body, ends.reshape(-1, 3)) for body, ends in enumerate(shape.capsules)]
    box = box_corners(frames[0] @ shape.box_frame, base_half_edges(model))
    return np.vstack([box, *(in_inertial_frame(frames[body], points) for body, points in parts)])


def in_inertial_frame(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Express points (..., 3) of a frame (4, 4) in the inertial frame."""
    return np.asarray(points @ frame[:3, :3].T + frame[:3, 3])


def base_half_edges(model: RobotModel) -> np.ndarray:
    """Return half the edges of the base's box as it is drawn (3,) [m]: flat in the plane."""
    return model.shape.box * [1, 1, model.dimension == 3]


def half_edges(shape: Sequence[float]) -> np.ndarray:
    """Return half the edges of an object (3,) [m]; one of length and width is flat."""
    return np.array([*shape, 0.0, 0.0, 0.0][:3]) / 2


def box_corners(frame: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the corners (8, 3) [m] of a box with half edges (3,) in a frame (4, 4)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return in_inertial_frame(frame, signs * half)


def object_frames(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the object's frame (4, 4) in each stage's panel: at rest, carried to the stage's target, or left there."""
    spec = task.spec.object
    if spec is None:
        return []
    holding = task.spec.held_stages
    taken = holding.start
    frame = pose_frames(spec.pose)
    ends = (min(panel, holding.stop) for panel in range(1, len(task.spec.stages) + 1))
    return [frame if end <= taken else carried_frame(model, frame, stops[taken], stops[end]) for end in ends]
