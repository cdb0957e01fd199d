"""The robot on its routes: which stages have one, and the point of it that their cost follows.

Where the straight motion to a stage's target is blocked, a route leads round. The stage's cost follows the farthest
point of the route that a clear straight motion from the robot reaches, never moving back; from where that is the
target on, the stage is as ever. Until then its end is not detected, and the next stage does not enter the window.
"""

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from psmpc_cli.control.identification.tracking import ObjectEstimate
from psmpc_cli.control.interface import State
from psmpc_cli.control.routes.route import Route, StraightMotions, find_route
from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.ocp.constraints.clearance import distances_on_arrays, groups_to_clear, poses_at, poses_at_sample
from psmpc_cli.ocp.feasibility.postures import configurations_at_stops, held_pose, reasons_unforeseen
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.progress import Work
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.specs.parts import has_posture

logger = logging.getLogger(__name__)

UNLIMITED = 0.2
"""Rate by which motions are measured where a coordinate has no limit [m/s, rad/s]."""

STEP = 0.1
"""Time at the limits of rates between configurations that are tested along a motion [s]."""

FOLLOWED_SHARE = 0.5
"""Part of the margin that is enough to follow a route: plans come as near as the margin, and a little nearer."""


@dataclass(frozen=True, eq=False)
class PlannedRoute:
    """A route of a stage.

    Attributes:
        route: Configurations in a chart.
        chart: The chart.
    """

    route: Route
    chart: Chart


@dataclass(frozen=True, eq=False)
class RouteProgress:
    """How far the robot has come on its routes.

    Attributes:
        progress: Share of the length of each stage's route, by stage index; 1 and no entry: the target itself counts.
        waypoints: Numbers of the targets there, by stage index, where the target itself does not count yet.
    """

    progress: Mapping[int, float] = field(default_factory=dict)
    waypoints: Mapping[int, np.ndarray] = field(default_factory=dict)


class Guide(ABC):
    """Says which points the costs of stages follow on the way to their targets."""

    @abstractmethod
    def updated_progress(
        self, before: RouteProgress, first: int, time: float, state: State, target_object: ObjectEstimate
    ) -> RouteProgress:
        """Return how far a robot has come on the routes of the current stage and those after it.

        Args:
            before: How far it had come at the sample before.
            first: Index of the current stage.
            time: Of the sample [s].
            state: The robot's.
            target_object: What is known of the object.
        """


class DirectGuide(Guide):
    """Guides the robot of a task without routes: straight to the targets."""

    def updated_progress(
        self, before: RouteProgress, first: int, time: float, state: State, target_object: ObjectEstimate
    ) -> RouteProgress:
        """Return the progress as it was: there is no route to follow."""
        return before


class RouteGuide(Guide):
    """Plans the routes of a task, and says where on them the robot is.

    Attributes:
        routes: By stage index; stages whose straight motion is clear have none, nor those whose places are not known
            before the run since something moves.
        blocked: Stages for which no route was found.
    """

    def __init__(self, problem: Problem) -> None:
        """Plan a route to the target of each stage whose straight motion is blocked, if the task asks for routes.

        Routes are planned once, before the run. A stage has none if something moves that it has to clear, or moves its
        target, so that places are not known before the run; this is logged as a warning.
        """
        self._problem = problem
        self.routes: dict[int, PlannedRoute] = {}
        self.blocked: list[int] = []
        self._groups = [groups_to_clear(problem.spec, problem.model, stage) for stage in range(len(problem.stages))]
        # where the robot is at the start, and at the end of each stage
        stops = configurations_at_stops(problem.task, problem.model, problem.stages)
        reasons = reasons_unforeseen(problem.spec, problem.stages) if problem.spec.routes else {}
        planned = len(problem.stages) if problem.spec.routes else 0
        work = Work("stages", planned, title="planning routes", small_parts=True)
        for stage in range(len(problem.stages)):
            if stage in reasons:
                logger.warning("no route to the target of %s: %s", problem.stages[stage].name, reasons[stage])
            else:
                self._plan_route(stage, stops[stage], stops[stage + 1])
            work.advance()

    def _plan_route(self, stage: int, start: np.ndarray, goal: np.ndarray) -> None:
        """Plan a route for a stage, and add it to `routes`; to `blocked` if the planner has found none.

        Nothing is added if the stage has nothing to clear, if a straight motion is clear, or if its target fixes no
        configuration of the robot or moves.

        Args:
            stage: Index of the stage.
            start: Coordinates with which it begins (nq,).
            goal: Coordinates with which it ends (nq,).
        """
        spec = self._problem.spec
        clearance = spec.clearance_of(stage)
        placed = self._problem.stages[stage]
        can_be_routed = has_posture(self._problem.model.spec.arms, placed.space) and not placed.reference.moves
        if clearance is None or spec.routes is None or not can_be_routed:
            return
        space = self._problem.model.space
        n = self._problem.model.n
        chart = space.chart_at(start)
        ends = np.asarray(chart.to_chart(np.array([start, goal]), np.zeros((2, n))))[:, :n]
        held = stage in self._problem.held_stages
        limits = placed.limits
        moves = self._problem.model.spec.moved_by.moves
        # robot and held object move as one body; a fixed base does not move
        free = np.arange(n)[space.base] if held else np.arange(0 if moves else space.n_twist, n)
        sample = SampleContext(
            time=0.0,
            x=np.append(ends[0], np.zeros(n)),
            anchor=chart.anchor,
            object_state=self._object_state_during(stage, start),
        )
        margin = clearance.margin + spec.routes.spare  # more than the stage keeps, so that it can follow the route
        motions = self._straight_motions(stage, chart, sample, margin)
        # coordinates that do not move keep their values
        ends[1] = np.where(np.isin(np.arange(n), free), ends[1], ends[0])
        if motions is None or motions.is_clear(ends[0], ends[1]):
            return
        route = find_route(
            ends[0],
            ends[1],
            low=limits.position_low,
            high=limits.position_high,
            free=free.tolist(),
            motions=motions,
            seed=spec.seed,
            iterations=spec.routes.iterations,
            slack=margin,
        )
        if route is None:
            logger.warning("found no route to the target of %s: the stage is as without routes", placed.name)
            self.blocked.append(stage)
        elif len(route.waypoints) > 2:  # not a straight motion
            self.routes[stage] = PlannedRoute(route, chart)

    def _object_state_during(self, stage: int, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the object's pose during a stage that begins at coordinates Q (nq,), and its velocity, 0.

        None of a task without an object that has a mass.
        """
        body = self._problem.body
        if body.mass == 0.0:
            return None
        held = self._problem.held_stages
        pose = np.array(body.pose)
        if stage in held:
            pose = held_pose(self._problem.model, body, Q)
        elif stage >= held.stop:
            pose = np.array(body.pose_after_release)
        return pose, np.zeros(self._problem.model.space.n_twist)

    def _straight_motions(
        self, stage: int, chart: Chart, sample: SampleContext, margin: float
    ) -> StraightMotions | None:
        """Return tests of straight motions for collisions, of which the planner of routes makes a route.

        Obstacles and the object are where they are at the sample, and stay there.

        Args:
            stage: Index of the stage, which says what has to keep clear of what.
            chart: The chart in which motions are straight.
            sample: Says where moving obstacles and the object are.
            margin: Distance that bodies have to keep from all of these [m].

        Returns:
            Tests of motions, whose lengths are times at the limits of velocity [s]; None if there is nothing to clear.
        """
        model = self._problem.model
        evaluated = list[tuple[BatchFunction, np.ndarray]]()
        # pairs of bodies that share an obstacle or an object form a group
        for group in self._groups[stage].values():
            argument = poses_at_sample(group, model, sample)
            if argument is not None:
                poses_now = poses_at(group.pairs, model, argument, np.zeros(1))[0]
                distances = distances_on_arrays(model, group.pairs)
                evaluated.append((distances, np.concatenate([chart.anchor, poses_now])))
        if not evaluated:
            return None

        def clearance(Q: np.ndarray) -> np.ndarray:
            X = np.hstack([Q, np.zeros_like(Q)])  # states at rest
            nearest = [distances(X, argument, rows=len(X))[0].min(axis=1) for distances, argument in evaluated]
            return np.asarray(np.min(nearest, axis=0) - margin)

        limits = self._problem.stages[stage].limits
        rates = np.minimum(-limits.velocity_low, limits.velocity_high)
        scale = 1 / np.where(np.isfinite(rates) & (rates > 0), rates, UNLIMITED)
        return StraightMotions(clearance, scale, STEP)

    def updated_progress(
        self, before: RouteProgress, first: int, time: float, state: State, target_object: ObjectEstimate
    ) -> RouteProgress:
        """Return how far the robot has come on its routes, and the points that the costs of stages follow there.

        The cost of the current stage follows the farthest point of its route that a clear straight motion from the
        robot reaches, and never one before the last. The routes of later stages are looked at from their first
        waypoint. Once the end of a route is in sight the target itself counts.

        Args:
            before: How far it had come at the sample before.
            first: Index of the current stage.
            time: Of the sample [s].
            state: The robot's.
            target_object: What is known of the object.
        """
        progress = dict(before.progress)
        waypoints = dict[int, np.ndarray]()
        n = self._problem.model.n
        for stage, planned in self.routes.items():
            route = planned.route
            if stage < first or progress.get(stage, 0.0) >= 1.0:
                continue
            Q = route.waypoints[0]
            if stage == first and np.isfinite(state.Q).all():
                Q = np.asarray(planned.chart.to_chart(state.Q[None], np.zeros((1, n))))[0, :n]
            object_state = target_object.at(time)
            at_rest = np.append(Q, np.zeros(n))
            sample = SampleContext(time, at_rest, planned.chart.anchor, object_state=object_state)
            clearance = self._problem.spec.clearance_of(stage)
            if clearance is None:
                continue
            motions = self._straight_motions(stage, planned.chart, sample, FOLLOWED_SHARE * clearance.margin)
            if motions is None:
                continue
            reached, point = route.farthest_clear(Q, motions, progress.get(stage, 0.0))
            if stage == first:
                progress[stage] = reached
            if reached < 1.0:
                waypoints[stage] = self._target_numbers_at(stage, planned.chart, point)
        return RouteProgress(progress, waypoints)

    def _target_numbers_at(self, stage: int, chart: Chart, point: np.ndarray) -> np.ndarray:
        """Return the numbers that the target of a stage would have to lead to a configuration (n,) in a chart."""
        model = self._problem.model
        Q, _ = chart.from_chart(np.append(point, np.zeros(model.n))[None])
        posture = Posture(Q[0], np.asarray(model.g(Q[0])).ravel())
        return skill_in(self._problem.stages[stage].space).numbers_at(model, posture)


def build_guide(problem: Problem) -> Guide:
    """Return what guides the robot of a problem, with routes if the task asks for them."""
    return RouteGuide(problem) if problem.spec.routes is not None else DirectGuide()
