"""The robot moving: an animated drawing, and a film in three dimensions by MuJoCo's offscreen renderer."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from loky import ProcessPoolExecutor
from matplotlib.animation import FFMpegWriter, FuncAnimation
from matplotlib.artist import Artist
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from psmpc_cli.errors import InputError, RunError, begin_worker
from psmpc_cli.figures import style
from psmpc_cli.figures.scene import Camera, Scene, capsule_ends, half_edges, obstacle_frame, scene_of
from psmpc_cli.figures.snapshots import describe_view, draw_scene, set_view
from psmpc_cli.figures.solids import WALL_OPACITY
from psmpc_cli.logs.files import replacing
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.specs.geometry import Shape

FRAME_RATE = 15
"""Frames a second."""

MAX_FRAMES = 150
"""Most frames of motion."""

PATH_DURATION = 3.0
"""How long the paths of the end-effectors behind a robot in motion are [s]."""

WIDTH = style.COLUMN
"""Width of a frame [in]."""

TITLE_HEIGHT = 0.3
"""Height of the title above a frame of the film [in]."""

DPI = 144
"""Resolution of a frame [1/in]."""

WALL_DEPTH = 100.0
"""Half the edges of the box that stands for a half-plane [m]: beyond every view."""

SURROUNDINGS = """
<mujoco>
  <option gravity="0 0 0"><flag contact="disable"/></option>
  <visual>
    <global orthographic="true" fovy="{tall}" azimuth="{azimuth}" elevation="{elevation}" offheight="{height}"
            offwidth="{width}"/>
    <headlight ambient="0.5 0.5 0.5" diffuse="0.45 0.45 0.45" specular="0 0 0"/>
  </visual>
  <statistic extent="{span}" center="{x} {y} {z}"/>
  <asset>
    <texture name="squares" type="2d" builtin="flat" mark="edge" width="256" height="256" rgb1="0.97 0.98 0.99"
             markrgb="0.7 0.7 0.72"/>
    <material name="squares" texture="squares" texuniform="true" texrepeat="2 2" specular="0"/>
  </asset>
  <worldbody><geom type="plane" size="0 0 1" pos="0 0 {floor}" material="squares"/></worldbody>
</mujoco>
"""
"""A camera that sees a whole view, and a floor of squares with edges of 1 m."""


def mp4_possible() -> bool:
    """Return whether an MP4 can be written: whether ffmpeg is there."""
    return bool(FFMpegWriter.isAvailable())


def write_animation(run: Run, paths: Iterable[Path]) -> None:
    """Write a run as an animated line drawing: robot, targets, obstacles and the paths of the last seconds.

    Args:
        run: The run.
        paths: The files to write, each with the whole animation: GIF or MP4, by its ending.

    Raises:
        RunError: A file could not be encoded or written.
    """
    scene, times, extent = _scene_times_and_extent(run)
    figure = style.new_figure(WIDTH)
    axes = figure.add_subplot()

    def draw_frame(number: int) -> list[Artist]:
        for artist in (*axes.lines, *axes.patches, *axes.collections, *axes.texts):
            artist.remove()  # clear() would put the labels of the axes out of view
        since = max(times[number] - PATH_DURATION, times[0])
        draw_scene(axes, scene, times[number], since, extent)
        set_view(axes, scene.camera, scene.camera.view(extent))
        return [axes.set_title(_frame_title(scene, times[number]))]

    # start and end are drawn over each other, so that the legend of all frames has what is there at either
    draw_frame(0)
    draw_scene(axes, scene, times[-1], times[0], extent)
    style.finish(figure, describe_view(scene.camera, extent))
    _write_frames(figure, draw_frame, len(times), paths)


def write_film(run: Run, paths: Iterable[Path]) -> None:
    """Render a run in three dimensions with MuJoCo, and write it as a film.

    MuJoCo renders in a process of its own, because a graphics driver that fails may kill its process.

    Args:
        run: The run.
        paths: The files to write, each with the whole film: GIF or MP4, by its ending.

    Raises:
        InputError: There is no offscreen renderer here.
        RunError: Rendering failed, or a film could not be encoded or written.
    """
    scene, times, extent = _scene_times_and_extent(run)
    # all that MuJoCo needs, as plain data that can be sent to another process
    Q = [run.motion.coordinates_at(time) for time in times]
    joints = [body.name for body in run.problem.model.spec.bodies[1:]]
    mocap_frames = [_mocap_frames(scene, time) for time in times]
    frames = _call_in_own_process(offscreen_driver(), render, film_model(scene, extent), Q, mocap_frames, joints)
    picture_height = frames.shape[1] / DPI
    figure = Figure(figsize=(WIDTH, picture_height + TITLE_HEIGHT))
    picture = figure.add_axes((0, 0, 1, picture_height / (picture_height + TITLE_HEIGHT))).imshow(
        frames[0], aspect="auto"
    )
    picture.axes.set_axis_off()

    def draw_frame(number: int) -> list[Artist]:
        picture.set_data(frames[number])
        return [picture.axes.set_title(_frame_title(scene, times[number]), x=0.02)]

    _write_frames(figure, draw_frame, len(times), paths)


def _scene_times_and_extent(run: Run) -> tuple[Scene, list[float], np.ndarray]:
    """Return a run as a scene, the time of each frame [s], and points (., 3) to show."""
    times = np.linspace(run.motion.time[0], run.motion.end, min(MAX_FRAMES, len(run.motion.time))).tolist()
    return scene_of(run), times, scene_of(run).extent(times)


def _frame_title(scene: Scene, time: float) -> str:
    """Return the title of the frame at a time [s]: this time, and what goes on then."""
    return f"t = {time:.1f} s: {', '.join(scene.events(time))}"


def _write_frames(
    figure: Figure, draw_frame: Callable[[int], Iterable[Artist]], count: int, paths: Iterable[Path]
) -> None:
    """Write an animation of `count` frames into files, GIF or MP4 by their endings; the last frame stays for a second.

    Args:
        figure: The figure that the frames are drawn in.
        draw_frame: Draws the frame of a number from 0, and returns what it has changed.
        count: Number of frames.
        paths: The files, each with the whole animation.

    Raises:
        RunError: A file could not be encoded or written.
    """
    figure.set_figheight(round(figure.get_figheight() * DPI / 2) * 2 / DPI)  # even in pixels, for video encoders
    figure.draw_without_rendering()
    for path in paths:
        frames = [*range(count), *[count - 1] * FRAME_RATE]
        writer = "pillow" if path.suffix == ".gif" else "ffmpeg"
        try:
            with replacing(path) as part:
                FuncAnimation(figure, draw_frame, frames, cache_frame_data=False).save(part, writer, FRAME_RATE, DPI)
        except (OSError, subprocess.CalledProcessError) as error:
            raise RunError(f"{path} could not be written: {error}") from None


def film_model(scene: Scene, extent: np.ndarray) -> str:
    """Describe robot, object, obstacles, floor and camera for MuJoCo's renderer.

    Object and obstacles are mocap bodies, which the film places at every frame, in this order.

    Args:
        scene: The run with what stands around the robot.
        extent: Points that the camera sees (., 3) [m].

    Returns:
        The model as MJCF.
    """
    import mujoco

    model = scene.run.problem.model
    spec = scene.run.task.spec.object
    width = round(WIDTH * DPI)
    shape = model.shape
    planar = model.dimension == 2
    camera = Camera(-90, 60) if planar else scene.camera
    view = camera.view(extent)
    floor = float(extent[:, 2].min()) - 1.5 * shape.box[2]
    x, y, z = np.mean(view.get_points(), axis=0) @ camera.axes[:2]
    world = mujoco.MjSpec.from_string(
        SURROUNDINGS.format(
            width=width,
            height=2 * round(width * view.height / view.width / 2),
            tall=view.height,
            azimuth=camera.azimuth + 180,
            elevation=-camera.elevation,
            x=x,
            y=y,
            z=z,
            span=2 * np.ptp(extent, axis=0).max(),
            floor=floor,
        )
    )
    robot = mujoco_spec(model.spec)
    base = robot.body("base")
    box = shape.box_frame
    quat = Rotation.from_matrix(box[:3, :3]).as_quat(scalar_first=True)
    base.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=shape.box, pos=box[:3, 3], quat=quat, rgba=_opaque_rgba(style.BODY)
    )
    colors = {name: _opaque_rgba(style.PALETTE[i % len(style.PALETTE)]) for i, name in enumerate(model.spec.arms)}
    grippers = {tool.body: shape.grippers[name] for name, tool in model.spec.tools.items()}
    for number, (body, capsules) in enumerate(zip(model.spec.bodies, shape.capsules, strict=True)):
        body_spec = robot.body(body.name)
        color = colors.get(body.name.rpartition(".")[0], _opaque_rgba(style.BODY))
        fingers = grippers.get(number, np.zeros((0, 3)))
        for size, segments in ((shape.radius, capsules), (0.4 * shape.radius, pairwise(fingers))):
            for start, end in segments:
                body_spec.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[size, 0, 0], fromto=[*start, *end], rgba=color
                )
    for body, joint in zip(model.spec.bodies[1:], model.spec.joints, strict=True):
        if not joint.prismatic:
            half_axis = 1.6 * shape.radius * np.array(joint.axis)
            disc: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [1.4 * shape.radius, 0, 0]}
            robot.body(body.name).add_geom(fromto=[*-half_axis, *half_axis], rgba=_opaque_rgba("white"), **disc)
    half_thickness = 1.3 * shape.radius
    if spec is not None:
        object_body = world.worldbody.add_body(name="object", mocap=True)
        object_body.add_geom(
            **_geom_of_shape(Shape("box", spec.shape), planar, half_thickness), rgba=_opaque_rgba(style.OBJECT)
        )
    for number, obstacle in enumerate(scene.obstacles):
        obstacle_body = world.worldbody.add_body(name=f"obstacle.{number}", mocap=True)
        opacity = WALL_OPACITY if obstacle.shape.half_space and not planar else 1.0
        obstacle_body.add_geom(
            **_geom_of_shape(obstacle.shape.shape, planar, half_thickness), rgba=[*to_rgb(style.OBSTACLE), opacity]
        )
    world.attach(robot, prefix="robot.", frame=world.worldbody.add_frame())
    world.compile()
    return str(world.to_xml())


def _geom_of_shape(shape: Shape, planar: bool, half_thickness: float) -> dict[str, Any]:
    """Describe an object or obstacle as a geom of MuJoCo (a shape that it renders), in the frame of its body.

    Args:
        shape: A box; a half-space, whose `size` is the outward normal of its face; or a capsule, whose `size` is radius
            and length, and which is a sphere where the length is 0.
        planar: Whether the robot is planar: the film then looks down on the plane, in which a half-space is a wall.
        half_thickness: How far boxes and walls reach above and below the plane, at least [m].

    Returns:
        The arguments of MuJoCo's `add_geom`, but for the colour.
    """
    import mujoco

    if shape.kind == "box":
        return {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": np.maximum(half_edges(shape.edges), [0, 0, half_thickness])}
    if shape.kind == "half_space" and planar:
        # a large box whose face x = WALL_DEPTH is turned to the normal and moved back to the origin of the frame;
        # MuJoCo's own plane would be seen edge-on
        rotation, _ = Rotation.align_vectors([shape.size], [[1, 0, 0]])
        pos = -WALL_DEPTH * np.array(shape.size)
        box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [WALL_DEPTH, WALL_DEPTH, half_thickness]}
        return {**box, "pos": pos, "quat": rotation.as_quat(scalar_first=True)}
    if shape.kind == "half_space":
        rotation, _ = Rotation.align_vectors([shape.size], [[0, 0, 1]])
        size = [0, 0, 1]  # two zeros make the plane infinite; the third number is the distance of its grid lines
        return {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": size, "quat": rotation.as_quat(scalar_first=True)}
    radius, length = shape.size
    if not length:
        return {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [radius, 0, 0]}
    return {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "size": [radius, 0, 0], "fromto": capsule_ends(shape).ravel()}


def _mocap_frames(scene: Scene, time: float) -> np.ndarray:
    """Return the frames (., 4, 4) [m] of the mocap bodies of a scene at a time [s], in the order of `film_model`."""
    held = scene.object_frame(time)
    of_object = [] if held is None else [held]
    return np.reshape([*of_object, *(obstacle_frame(each, time) for each in scene.obstacles)], (-1, 4, 4))


def _opaque_rgba(color: str) -> list[float]:
    """Return a colour of Matplotlib as red, green, blue and opacity, each in [0, 1], as MuJoCo takes it."""
    return [*to_rgb(color), 1.0]


def render(
    description: str, Q: Sequence[np.ndarray], mocap_frames: Sequence[np.ndarray], joints: Sequence[str] = ()
) -> np.ndarray:
    """Render K pictures of a robot with object and obstacles by MuJoCo, off screen.

    Args:
        description: The model as MJCF, from `film_model`.
        Q: Coordinates of the robot in each picture (K, nq): its base, then its joints.
        mocap_frames: For each picture the frames of the mocap bodies (object and obstacles), which are placed and not
            simulated (bodies, 4, 4) [m].
        joints: Names of the bodies whose joints are the last coordinates of Q, in their order.

    Returns:
        The pictures (K, height, width, 3), 8 bits a colour.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(description)
    data = mujoco.MjData(model)
    frames = []
    with mujoco.Renderer(model, model.vis.global_.offheight, model.vis.global_.offwidth) as renderer:
        first_joint = len(Q[0]) - len(joints)
        # where MuJoCo has each coordinate of Q: the base comes first, but joints are in the order of MuJoCo's tree
        qpos_indices = [*range(first_joint), *(int(model.joint(f"robot.{name}").qposadr[0]) for name in joints)]
        for coordinates, bodies in zip(Q, mocap_frames, strict=True):
            data.qpos[qpos_indices] = coordinates
            for number, frame in enumerate(bodies):
                data.mocap_pos[number] = frame[:3, 3]
                data.mocap_quat[number] = Rotation.from_matrix(frame[:3, :3]).as_quat(scalar_first=True)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data)
            frames.append(renderer.render())
    return np.array(frames)


@cache
def offscreen_driver() -> str:
    """Return the graphics driver with which MuJoCo renders off screen here, after a test that it does.

    It is the one that the environment variable MUJOCO_GL names, by default EGL on Linux. An empty model is rendered
    with it once, so that a user learns before a long drawing that no film can be made.

    Returns:
        A value for MUJOCO_GL; empty for MuJoCo's own choice.

    Raises:
        InputError: The driver does not render, or MuJoCo is not installed.
    """
    if find_spec("mujoco") is None:
        raise InputError("--render: found no package mujoco; install it with pip install 'psmpc[mujoco]'")
    driver = os.environ.get("MUJOCO_GL") or ("egl" if sys.platform == "linux" else "")
    try:
        _call_in_own_process(
            driver, render, "<mujoco/>", [np.zeros(0)], [np.zeros((0, 4, 4))]
        )  # no coordinates, no bodies
    except RunError as error:
        raise InputError(
            f"--render: found no driver with which MuJoCo draws off screen ({driver or 'default'}: {error}); install "
            "EGL, name a driver that works, such as osmesa, in MUJOCO_GL, or leave --render out"
        ) from None
    return driver


def _call_in_own_process(driver: str, call: Callable[..., Any], *arguments: object) -> Any:
    """Make a call in a process of its own: MuJoCo chooses its driver once, when it is imported, and it may crash.

    Raises:
        RunError: The call failed; the message has the last line of what MuJoCo or the driver said.
    """
    environment = {"MUJOCO_GL": driver}
    with ProcessPoolExecutor(1, env=environment, initializer=begin_worker, initargs=(os.getpid(),)) as pool:
        try:
            return pool.submit(call, *arguments).result()
        except Exception as error:
            said = str(error).strip().splitlines() or [type(error).__name__]
            raise RunError(f"MuJoCo's renderer failed: {said[-1]}") from None
