"""The viewer: runs as one interactive page with a scene in three dimensions, a time line and linked plots.

What the page draws is decided here as data: the robot as a tree of bodies with coordinates over time, from which the
page computes the poses, plans, stages, targets, the object, and the curves of the plots. `view.js` draws it.
"""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from scipy.spatial.transform import Rotation

from psmpc_cli.figures import style
from psmpc_cli.figures.coordinates import (
    SMALLEST_ERROR,
    along_base_axes,
    coordinate_panels,
    error_curves,
    error_parts,
    limits_base_force,
    limits_in_view,
    panels_that_vary,
)
from psmpc_cli.figures.instants import has_distances, name_of_pair, nearest_pairs
from psmpc_cli.figures.scene import Scene, capsule_ends, nearby_points_of_obstacle, obstacle_frame, scene_of
from psmpc_cli.figures.solids import WALL_OPACITY
from psmpc_cli.logs.run import Run, RunOrPath, resolve_runs
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.report.pages import Page, render
from psmpc_cli.report.texts import describe_forces, describe_mission
from psmpc_cli.robot.actuators.plumes import Plumes
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.geometry import Piece, pieces_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.specs.geometry import Shape
from psmpc_cli.specs.object import GRASP_LOADS
from psmpc_cli.specs.parts import ANGLE, LENGTH
from psmpc_cli.specs.robots.robot import Attachment, Joint

MAX_FRAMES = 3000
"""Most times at which a run is shown."""

MAX_PLANS = 750
"""Most plans that are shown of a run."""

MAX_VIEWS = 20
"""Most times whose views tell how large a scene is."""

MAX_NODES = 24
"""Most nodes that are shown of a plan, besides those at its switches."""

STAGE_COLORS = ("#9B87D0", "#8FA860", "#A58868", "#D3CBEE", "#CBDAB0")
"""Colours of the stages in turn, below dark text: of hues that no part of the robot has."""

BASE_COLOR = "#6E6E6E"
OBJECT_COLOR = "#B59B00"
"""Colours of the curves of base and object, whose bodies are paler."""

SHADES: Mapping[int, Sequence[float]] = {
    1: (-0.4,),
    2: (-0.5, 0.3),
    3: (-0.65, -0.3, 0.3),
    4: (-0.7, -0.45, -0.2, 0.3),
}
"""Shades of the coordinates of a part in its colour, by their number: how far to black if negative, else to white."""

INK = "#1b1f24"
"""Colour of curves that belong to nothing in the scene."""

Json = dict[str, Any]
Curve = tuple[str, np.ndarray, str]
"""Label, values (T,) and colour of a curve."""


def view(runs: RunOrPath | Mapping[str, RunOrPath]) -> Page:
    """Make an interactive page of a run, or of several by name: the robot in motion, its plans, and curves over time.

    A notebook shows the page in place; `save` writes it into a file that a browser opens without a server or a network.

    Args:
        runs: A run, or several by name, such as the result of `compare`; the path of a log or of a comparison stands
            for its runs.

    Raises:
        LogError: A run has no samples, its log holds another task than it says, or a path leads to no log.
        InputError: There is no run.
    """
    resolved = resolve_runs(runs)
    by_name = (
        {style.title_of(str(resolved.attributes["controller"])): resolved} if isinstance(resolved, Run) else resolved
    )
    tasks = dict.fromkeys(style.words_of(str(run.attributes["task_name"])) for run in by_name.values())
    data_of_runs = [_run_data(style.title_of(name), run) for name, run in by_name.items()]
    return render("view.html.j2", title=", ".join(tasks), runs=data_of_runs)


def _run_data(name: str, run: Run) -> Json:
    """Collect all that the interactive page shows of a run, as JSON data for its script.

    Long runs are thinned out to at most `MAX_FRAMES` states and `MAX_PLANS` plans.

    Args:
        name: Name of the run on the page.
        run: The run.

    Returns:
        The data by the names that the script reads. Lengths are in m, angles in rad, times in s. What the run does not
        have is None. Arrays are packed as by `_packed`.
    """
    scene = scene_of(run)
    model = run.problem.model
    motion = run.motion
    # indices of the states of the motion, and of the samples with their plans
    frames = _evenly_spaced_indices(len(motion.time), MAX_FRAMES)
    samples = _evenly_spaced_indices(len(run.time), MAX_PLANS)
    time = motion.time[frames]
    stages = [
        {"name": style.words_of(stage), "color": stage_color(number)} for number, stage in enumerate(run.stage_names)
    ]
    return {
        "name": name,
        "mission": describe_mission(run.summary()),
        "notes": list(_notes(run)),
        "robot": _robot_data(model, pieces_of(model.spec) if run.task.spec.keeps_clear else ()),
        "time": _packed(time, "f8"),
        "Q": _packed(motion.Q[frames], "f8"),
        "stages": stages,
        "spans": [
            {**stages[span.index], "start": span.start, "end": span.end, "early": span.early} for span in run.spans
        ],
        "samples": _packed(run.time[samples], "f8"),
        "instants": _packed(run["window/instants"][samples]),
        "plans": _plan_data(run, samples) if run.has_plans else None,
        "targets": _packed(_target_poses(scene, time)),
        "object": _object_data(scene, time),
        "obstacles": list(_obstacle_data(scene, time)),
        "nearest": _nearest_parts_data(run) if "clearance/distance" in run else None,
        "thrusters": _thruster_data(run) if "thrusters/impulse" in run else None,
        "wheels": _wheel_data(run) if "wheels/momentum" in run else None,
        "plots": list(_plot_tabs(run, frames)),
    }


def _notes(run: Run) -> Iterator[str]:
    """List what a log lacks, how it is to be read, and how near forces come to their limits."""
    if run.interrupted:
        yield "The log is unfinished: the run is shown up to its last sample."
    if forces := describe_forces(run.summary()):
        yield f"{forces[0].upper()}{forces[1:]}."
    if not run.has_plans:
        yield "The log holds no plans (log.plans is false), so no plan is drawn."
    elif "levels/solved" in run:
        yield "The plan drawn is that of the first level, which is all that the log holds of HTMPC."
    if len(run.time) > MAX_PLANS:
        yield f"Plans are drawn at {MAX_PLANS} of the {len(run.time)} samples."


def _robot_data(model: RobotModel, pieces: Sequence[Piece]) -> Json:
    """Describe a robot as JSON data for the page's script, which draws it: a tree of bodies.

    Each body has the frame of its joint on the body that carries it; the links to draw, as capsules (cylinders with
    round ends); and `covers`, the capsules that stand for the body where the task keeps parts clear of each other. Each
    body belongs to a part: the base or an arm. Parts have names and colours, in the order of `model.parts`. `box` is
    that of the base.

    Args:
        model: The robot.
        pieces: The capsules that cover its bodies for clearance; empty where they are not shown.

    Returns:
        The data by the names that the script reads. Lengths are in m, quaternions x, y, z, w.
    """
    spec = model.spec
    shape = model.shape
    box_quaternion = Rotation.from_matrix(shape.box_frame[:3, :3]).as_quat()
    part_names = list(model.parts)
    zeros = (0.0, 0.0, 0.0)
    # so that all bodies are treated alike, the base has a joint too, on body -1, which the script takes for none
    joints = [Joint(Attachment(-1, zeros, zeros), zeros), *spec.joints]
    bodies = [
        {
            **_frame_data(joint.at),
            # the bodies of an arm have names such as arm_1.2
            "part": part_names.index(body.name.rpartition(".")[0] or "base"),
            "axis": joint.axis,
            "prismatic": joint.prismatic,
            "capsules": links.tolist(),
            "covers": [
                {"ends": piece.ends.tolist(), "radius": piece.shape.size[0]} for piece in pieces if piece.body == number
            ],
        }
        for number, (body, joint, links) in enumerate(zip(spec.bodies, joints, shape.capsules, strict=True))
    ]
    return {
        "spatial": model.dimension == 3,
        "bodies": bodies,
        "tools": [
            {**_frame_data(tool_frame), "gripper": shape.grippers[arm].tolist()}
            for arm, tool_frame in spec.tools.items()
        ],
        "box": {
            "half": shape.box.tolist(),
            "position": shape.box_frame[:3, 3].tolist(),
            "quaternion": box_quaternion.tolist(),
        },
        "parts": [style.words_of(part) for part in part_names],
        "colors": [style.BODY, *(style.line_look(number)["color"] for number in range(len(spec.arms)))],
        "objectColor": style.OBJECT,
        "baseColor": BASE_COLOR,
        "obstacleColor": style.OBSTACLE,
        "coverColor": style.CAPSULE,
        "radius": shape.radius,
    }


def _frame_data(at: Attachment) -> Json:
    """Describe a frame on a body for the page's script: the body, and the pose on it [m], quaternion x, y, z, w."""
    quaternion = Rotation.from_rotvec(at.rotation).as_quat().tolist()
    return {"body": at.body, "position": at.position, "quaternion": quaternion}


def _plan_data(run: Run, samples: np.ndarray) -> Json:
    """Collect the plans of a run at some samples, which the page draws as paths ahead of the robot.

    Of each plan at most `MAX_NODES` nodes and those at the ends of stages are kept. At a sample whose solve failed the
    plan of the sample before is repeated. Plans with fewer nodes repeat their last one, so that all fit in one array.

    Args:
        run: The run, with its plans.
        samples: Numbers of the K samples.

    Returns:
        `time`, the times of the nodes (K, nodes) [s], and `Q`, the coordinates at them (K, nodes, nq), both packed.
    """
    plans: list[tuple[Plan, np.ndarray]] = []  # with each plan the nodes that are kept
    for sample in samples:
        if not (plans and run["events/solve_failed"][sample]):
            solve = logged_solve(run, int(sample))
            stage_end_nodes = np.cumsum(solve.window.nodes)
            last_node = stage_end_nodes[-1]
            evenly = np.linspace(0, last_node, min(last_node, MAX_NODES) + 1).astype(int)
            nodes = np.union1d(evenly, stage_end_nodes)
        # after a failed solve `solve` and `nodes` are still those before
        plans.append((solve.plan, nodes))

    most_nodes = max((len(nodes) for _, nodes in plans), default=0)
    padded = [(plan, np.pad(nodes, (0, most_nodes - len(nodes)), mode="edge")) for plan, nodes in plans]
    time = [plan.times[nodes] for plan, nodes in padded]
    Q = [plan.chart.from_chart(plan.X[nodes])[0] for plan, nodes in padded]
    return {"time": _packed(np.array(time)), "Q": _packed(np.array(Q))}


def _target_poses(scene: Scene, time: np.ndarray) -> np.ndarray:
    """Compute the frames at which the acting stages aim (T, S, frames, 7): position [m] and quaternion x, y, z, w.

    NaN of stages that do not act, and where a stage asks for no position or attitude.
    """
    poses = np.full((len(time), len(scene.run.stage_names), len(scene.run.problem.model.pose_rows), 7), np.nan)
    for row, t in enumerate(time):
        for stage in scene.acting_stages(float(t)):
            frames = scene.target_frames(stage, float(t))
            known = np.isfinite(frames).all(axis=(1, 2))
            poses[row, stage, :, :3] = frames[:, :3, 3]
            poses[row, stage, known, 3:] = Rotation.from_matrix(frames[known, :3, :3]).as_quat()
    return poses


def _object_data(scene: Scene, time: np.ndarray) -> Json | None:
    """Collect size (3,) [m] and poses (T, 7) of the object: position [m] and quaternion x, y, z, w."""
    spec = scene.run.task.spec.object
    frames = [scene.object_frame(float(t)) for t in time]
    if spec is None:
        return None
    known = np.array([frame for frame in frames if frame is not None])
    poses = np.hstack([known[:, :3, 3], Rotation.from_matrix(known[:, :3, :3]).as_quat()])
    size = [*spec.shape, *(2.6 * scene.run.problem.model.shape.radius for _ in range(3 - len(spec.shape)))]
    return {"size": size, "pose": _packed(poses, "f8"), "lost": scene.released_at if scene.lost else None}


def _obstacle_data(scene: Scene, time: np.ndarray) -> Iterator[Json]:
    """Describe the obstacles of a run as JSON data for the page's script, which draws and moves them.

    They are boxes and capsules, with their poses at time 0 and their velocities [m/s]. A half-space is shown as a box
    that is larger than the scene: in the plane a block of the same depth, in space a thin transparent wall.

    Args:
        scene: The run with what stands around the robot.
        time: Times that are shown [s].

    Yields:
        The data of each obstacle by the names that the script reads. `box` or `ends` and `radius` are its shape, the
        other is None. `around` are points that a view should contain, at the first and the last time [m].
    """
    if not scene.obstacles:
        return
    extent = scene.extent(time[_evenly_spaced_indices(len(time), MAX_VIEWS)].tolist())
    model = scene.run.problem.model
    planar = model.dimension == 2
    thickness = 2.6 * model.shape.radius  # of what is flat in the plane [m]
    for obstacle in scene.obstacles:
        shape = obstacle.shape.shape
        frame = obstacle_frame(obstacle, 0.0)
        opacity = 1.0
        if shape.kind == "half_space":
            width = 1.5 * float(np.linalg.norm(np.ptp(extent, axis=0)))
            depth = width if planar else 0.01 * width
            normal = frame[:3, :3] @ shape.size
            middle = (extent.min(axis=0) + extent.max(axis=0)) / 2
            # its centre is half its depth behind the point of the face that is nearest to the middle of the scene, so
            # that its own face, normal to its x axis, is the face of the half-space
            distance_from_face = (middle - frame[:3, 3]) @ normal
            frame[:3, 3] = middle - (distance_from_face + depth / 2) * normal
            frame[:3, :3] = Rotation.align_vectors([normal], [[1, 0, 0]])[0].as_matrix()
            shape = Shape("box", (depth, width) if planar else (depth, width, width))
            opacity = 1.0 if planar else WALL_OPACITY
        yield {
            "name": style.words_of(obstacle.name),
            "position": frame[:3, 3].tolist(),
            "quaternion": Rotation.from_matrix(frame[:3, :3]).as_quat().tolist(),
            "velocity": [*obstacle.velocity, 0.0, 0.0, 0.0][:3],
            "box": [*shape.edges, thickness][:3] if shape.kind == "box" else None,
            "ends": capsule_ends(shape).tolist() if shape.kind == "capsule" else None,
            "radius": shape.size[0] if shape.kind == "capsule" else None,
            "opacity": opacity,
            "around": [
                nearby_points_of_obstacle(obstacle, float(instant), extent).tolist() for instant in time[[0, -1]]
            ],
        }


def _nearest_parts_data(run: Run) -> Json:
    """Collect the smallest of all distances over each sample [m], whose it is, and the points of both parts then."""
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    distances = np.where(np.isnan(run["clearance/distance"]), np.inf, run["clearance/distance"])[samples]
    pair = distances.argmin(axis=1)
    rows = np.arange(len(samples))
    return {
        "time": _packed(run.time[samples], "f8"),
        "distance": _packed(np.where(np.isinf(distances[rows, pair]), np.nan, distances[rows, pair])),
        "points": _packed(run["clearance/points"][samples][rows, pair]),
        "pair": pair.tolist(),
        "names": [name_of_pair(name.split(" - ")) for name in run["clearance/pair"].tolist()],
    }


def _thruster_data(run: Run) -> Json:
    """Collect what the page shows of thrusters: the plume of each while it fires, and when it is shut.

    Returns:
        `nozzles`, the positions of the nozzles [m], and `axes`, the unit vectors along the plumes, both in the base's
        frame (thrusters, 3); `time`, of the samples [s]; `share`, the mean thrust over each sample over the largest
        thrust (samples, thrusters); and `shut`, the part of each sample for which each thruster is shut because of its
        plume, None where none ever is.
    """
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    thrusters = run.problem.model.spec.thrusters
    plumes = Plumes.of(thrusters)
    largest_impulse = run.task.spec.controller.sample_time * np.array([thruster.force for thruster in thrusters])
    return {
        "nozzles": plumes.nozzles.tolist(),
        "axes": plumes.axes.tolist(),
        "time": _packed(run.time[samples], "f8"),
        "share": _packed(run["thrusters/impulse"][samples] / largest_impulse),
        "shut": _packed(run["thrusters/shut"][samples]) if "thrusters/shut" in run else None,
    }


def _wheel_data(run: Run) -> Json:
    """Collect the axes of reaction wheels in the base frame (3,), and what they store at samples, of what they may."""
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    wheels = Wheels.of(run.problem.model.spec)
    return {
        "axes": [[0.0, 0.0, 1.0] if len(axis) == 1 else axis.tolist() for axis in wheels.axes.T],
        "time": _packed(run.time[samples], "f8"),
        "share": _packed(run["wheels/momentum"][samples] / wheels.momentum),
    }


def _plot_tabs(run: Run, frames: np.ndarray) -> Iterator[Json]:
    """Yield the tabs with plots that the page has beside the moving robot.

    Panels without curves are left out, and so are tabs without panels.

    Args:
        run: The run.
        frames: Indices of the states of its motion that are shown: at samples and at the end of the run. Tabs with data
            of samples alone, which have no row for the end of the run, choose samples of their own.

    Yields:
        The name of a tab and the data of its panels, by the names that the page's script reads.
    """
    motion = run.motion
    model = run.problem.model
    time = motion.time[frames]
    # controls are accelerations, one for each sample. The end of the run has none of its own: the last one is repeated
    u = np.vstack([run.u, run.u[-1:]])[np.minimum(frames, len(run.u))]
    tabs = {
        "Velocities": _coordinate_panels(model, time, motion.v[frames], "velocity"),
        "Controls": _coordinate_panels(model, time, u, "acceleration", stepped=True),
        "Forces": _force_panels(run, frames),
        "Errors": _error_panels(run, frames),
        "Coordinates": _coordinate_panels(model, time, _with_attitude_as_angles(model, motion.Q[frames]), "position"),
        "Stages": _stage_panels(run),
        "Grasp": _grasp_panels(run) if "grasp/pull" in run else (),
        "Clearance": _clearance_panels(run) if has_distances(run) else (),
    }
    for name, panels in tabs.items():
        if with_curves := [panel for panel in panels if panel["series"]]:
            yield {"name": name, "panels": with_curves}


def _with_attitude_as_angles(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Convert coordinates to (T, n), with the attitude of a spatial base as unwrapped angles about z, y and x [rad]."""
    if model.dimension == 2:
        return Q
    turns = Rotation.from_quat(Q[:, [4, 5, 6, 3]]).as_euler("ZYX")
    return np.hstack([Q[:, :3], np.unwrap(turns, axis=0), Q[:, 7:]])


def _coordinate_panels(
    model: RobotModel,
    time: np.ndarray,
    values: np.ndarray,
    quantity: str,
    stepped: bool = False,
    limits: Sequence[np.ndarray] = (),
    base_unit_note: str = "",
) -> Iterator[Json]:
    """Yield the panels of a quantity of all generalized coordinates, as JSON data for the page's script.

    There is a panel of the base's position, one of its angles, and one of each arm. An arm with joints that slide has a
    panel of these besides. Curves of one part are shades of the colour that the part has in the scene.

    Args:
        model: The robot.
        time: Times (T,) [s].
        values: Values of the quantity (T, n).
        quantity: Name of the quantity: the field of `CoordinateUnits` that has its unit, such as velocity.
        stepped: Whether a value is held until the next one.
        limits: Lower and upper limits of the values, two arrays (T, n), infinite where there are none; or nothing.
        base_unit_note: What is added to the unit of the base's linear coordinates.
    """
    linear, angular = (getattr(kind_of_unit, quantity).replace("^2", "²") for kind_of_unit in (LENGTH, ANGLE))
    of_angles = "angle" if quantity == "position" else quantity
    panels = coordinate_panels(model, (quantity, linear), (of_angles, angular), base_unit_note)
    colors = part_colors(model)
    for panel in panels_that_vary(model, panels, [values]):
        rows = list(panel.rows)
        # the base or arm that the coordinates belong to
        part = next(
            name
            for name, coordinates_of_part in model.parts.items()
            if coordinates_of_part.start <= rows[0] < coordinates_of_part.stop
        )
        # the attitude of a base in space is drawn as its angles about z, y and x
        labels = ("yaw", "pitch", "roll") if panel.quantity == "attitude" else panel.labels
        shades = shades_of(colors[part], len(rows))
        curves = list(zip(labels, values[:, rows].T, shades, strict=True))
        in_view = limits_in_view([side[:, rows] for side in limits], values[:, rows])
        limits_of_curves = [(limit, shades[curve]) for limit, bounded_curves in in_view for curve in bounded_curves]
        bounds = _shared_bounds("limit", limits_of_curves)
        yield _panel_data(f"{style.words_of(part)} ({panel.unit})", time, curves, bounds, stepped=stepped)


def _shared_bounds(name: str, of_lines: Iterable[tuple[np.ndarray, str]]) -> list[Curve]:
    """List the bounds of lines as curves, equal bounds of several lines once.

    Args:
        name: Label of the curves, such as limit.
        of_lines: Pairs of a bound over time (T,) and the colour of the line that it bounds.

    Returns:
        Label, values (T,) and colour of each bound: the colour of its line, or grey if it bounds lines of several.
    """
    curves: dict[bytes, Curve] = {}  # equal bounds have equal bytes
    for values, color in of_lines:
        _, _, first_color = curves.setdefault(values.tobytes(), (name, values, color))
        if first_color != color:
            curves[values.tobytes()] = (name, values, style.EDGE)
    return list(curves.values())


def part_colors(model: RobotModel) -> dict[str, str]:
    """Return the colours of base and arms by name; arms have those of the figures."""
    arms = (name for name in model.parts if name != "base")
    return {"base": BASE_COLOR, **{name: style.line_look(number)["color"] for number, name in enumerate(arms)}}


def shades_of(color: str, count: int) -> list[str]:
    """Return so many shades of a colour, none of which is the colour itself, those of a panel at most."""
    rgb = np.array(to_rgb(color))
    return [to_hex(tuple((rgb + abs(shade) * (float(shade > 0) - rgb)).tolist())) for shade in SHADES[count]]


def stage_color(number: int) -> str:
    """Return the colour of the stage of a number, in the scene, on the time line and of its curves."""
    return STAGE_COLORS[number % len(STAGE_COLORS)]


def _force_panels(run: Run, frames: np.ndarray) -> Iterator[Json]:
    """Yield the forces at the samples, with their limits; on a base whose force has limits, along its own axes."""
    model = run.problem.model
    samples = frames[frames < len(run.time)]
    F = run["force/F"][samples]
    note = ""
    if limits_base_force(run):
        note = ", own axes"
        F = along_base_axes(model, run.Q[samples], F)
    of_samples = [run.problem.stages[stage].limits for stage in run["window/first"][samples]]
    limits = [np.array([getattr(each, f"force_{side}") for each in of_samples]) for side in ("low", "high")]
    if np.isfinite(F).any():
        yield from _coordinate_panels(model, run.time[samples], F, "force", limits=limits, base_unit_note=note)


def _error_panels(run: Run, frames: np.ndarray) -> Iterator[Json]:
    """Yield two panels of how far parts of the robot are from the current stage's target: of lengths, and of angles.

    A curve shows the largest error of the coordinates of one part (base or arm). The tolerances of the stage's end
    condition are dashed lines. Axes are logarithmic, so errors below `SMALLEST_ERROR` are left out.

    Args:
        run: The run.
        frames: Indices of the T states of its motion that are shown.
    """
    time = run.motion.time[frames]
    parts = error_parts(run)
    error = np.full((2, len(parts), len(time)), np.nan)  # error[0] are lengths [m], error[1] angles [rad]
    tolerance = np.full((2, len(parts), len(time)), np.nan)
    for curve in error_curves(run):
        in_span = (time >= curve.span.start - 1e-9) & (time <= curve.span.end + 1e-9)  # while the stage was current
        index = (int(curve.angular), parts.index(curve.part), in_span)
        error[index] = np.interp(time[in_span], curve.time, curve.error)
        tolerance[index] = curve.tolerance
    error = np.where(error > SMALLEST_ERROR, error, np.nan)
    names = [style.words_of(part) for part in parts]
    color_of_part = part_colors(run.problem.model)
    colors = [color_of_part.get(part, OBJECT_COLOR) for part in parts]  # what only a skill has is an object's
    for angular, label in enumerate(("largest coordinate (m)", "largest angle (rad)")):
        curves = zip(names, error[angular], colors, strict=True)
        bounds = _shared_bounds("tolerance", zip(tolerance[angular], colors, strict=True))
        yield _panel_data(label, time, curves, bounds, log=True)


def _stage_panels(run: Run) -> Iterator[Json]:
    """Yield planned switch times, shares of the stages in the control if logged, and the wall times of the solves."""
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    names = [style.words_of(name) for name in run.stage_names]
    time = run.time[samples]
    colors = [stage_color(number) for number in range(len(names))]
    for label, path in (("planned switch time (s)", "window/instants"), ("share in control (1)", "window/share")):
        yield _panel_data(label, time, zip(names, run[path][samples].T, colors, strict=True))
    yield _panel_data("solve time (ms)", time, [("solve", 1e3 * run["solver/wall_time"][samples], INK)], log=True)


def _grasp_panels(run: Run) -> Iterator[Json]:
    """Yield the panels of the tab about grasps: the loads on each gripper, and the velocities of the object.

    There is a panel for each load: pull [N], shear [N] and moment [N m]. They are filtered, as they are when the plant
    judges whether a grasp holds, and a dashed line shows the strength, the load at which a grasp is lost.
    """
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    names = [style.words_of(name) for name in run["gripper"].tolist()]
    colors = [part_colors(run.problem.model)[name] for name in run["gripper"].tolist()]
    time = run.time[samples]
    strengths = run.task.spec.body.grasp.largest_loads
    for (load, unit), strength in zip(GRASP_LOADS.items(), strengths, strict=True):
        limits = [("strength", np.full(len(time), strength), style.EDGE)] if np.isfinite(strength) else []
        curves = zip(names, run[f"grasp/{load}"][samples].T, colors, strict=True)
        yield _panel_data(f"{load} on grasp ({unit})", time, curves, limits)
    axes = list(zip(run["object_axis"].tolist(), run["object/velocity"][samples].T, strict=True))
    # 3 axes in the plane, two of them linear; 6 in space, three of them linear
    n_linear = len(axes) // 3 + 1
    for unit, velocity_axes in (("m/s", axes[:n_linear]), ("rad/s", axes[n_linear:])):
        shades = shades_of(OBJECT_COLOR, len(velocity_axes))
        # an axis is its name and its velocities; with a colour it is a curve
        velocities = [(*axis, shade) for axis, shade in zip(velocity_axes, shades, strict=True)]
        yield _panel_data(f"object ({unit})", time, velocities)


def _clearance_panels(run: Run) -> Iterator[Json]:
    """Yield the smallest distances of the nearest parts, as far as they are worth looking at, with the margin."""
    samples = _evenly_spaced_indices(len(run.time), MAX_FRAMES)
    pairs = nearest_pairs(run)
    seen = 1e3 * np.where(pairs.distances <= pairs.top, pairs.distances, np.nan)[samples].T
    margin = [("margin", 1e3 * pairs.margin[samples], style.EDGE)]
    colors = part_colors(run.problem.model)
    parts = [next((name for name in names if name.partition(".")[0] in colors), "") for names in pairs.names]
    of_pairs = [colors.get(part.partition(".")[0], OBJECT_COLOR) for part in parts]
    curves = zip(map(name_of_pair, pairs.names), seen, of_pairs, strict=True)
    yield _panel_data("distance (mm)", run.time[samples], curves, margin)


def _panel_data(
    label: str,
    time: np.ndarray,
    curves: Iterable[Curve],
    limits: Iterable[Curve] = (),
    log: bool = False,
    stepped: bool = False,
) -> Json:
    """Describe a panel of curves over time as JSON data for the page's script; curves without any value are left out.

    Args:
        label: Label of the panel, with its unit.
        time: Times of all curves (T,) [s].
        curves: Label, values (T,) and colour of each curve.
        limits: The same of each limit, which is drawn as a dashed curve.
        log: Whether the vertical axis is logarithmic.
        stepped: Whether a value is held until the next one.

    Returns:
        The panel by the names that the script reads. `repeats` of a curve says how many curves of the same colour come
        before it, by which the script gives each of them another pattern of dots.
    """
    all_curves = [(curve, False) for curve in curves] + [(curve, True) for curve in limits]
    known_curves = [(curve, is_limit) for curve, is_limit in all_curves if np.isfinite(curve[1]).any()]
    colors = [(color, is_limit) for (_, _, color), is_limit in known_curves]
    series = [
        {
            "label": name,
            "color": color,
            "limit": is_limit,
            "repeats": colors[:number].count((color, is_limit)),
            "values": _packed(values),
        }
        for number, ((name, values, color), is_limit) in enumerate(known_curves)
    ]
    return {"label": label, "time": _packed(time, "f8"), "series": series, "log": log, "stepped": stepped}


def _evenly_spaced_indices(count: int, most: int) -> np.ndarray:
    """Return all indices below `count`, or `most` of them at even distances if there are more than that."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _packed(values: np.ndarray, dtype: str = "f4") -> Json:
    """Pack an array as its type, shape and bytes in base64, which is smaller and exacter than decimal numbers."""
    array = np.ascontiguousarray(values, f"<{dtype}")
    return {"type": dtype, "shape": array.shape, "data": b64encode(array.tobytes()).decode("ascii")}
