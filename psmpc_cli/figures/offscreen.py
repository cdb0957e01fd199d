"""Draws bodies with MuJoCo off screen: a program of its own, for the driver behind it is chosen once, and may crash.

Usage: offscreen.py SCENE.npz FRAMES.npy, with the driver in MUJOCO_GL. Imports nothing of the package. The scene holds

- `kinds` (B,), box, capsule or cylinder; `sizes` (B, 3) [m]: half edges of a box, radius and length of a capsule along
  x, radius and half height of a cylinder; `colors` (B, 3); `poses` (K, B, 3) in the plane [m, m, rad];
- `view` (left, right, bottom, top) [m], `floor` (its height [m]), `size` (height, width) [px];
- `camera`: x, y, z of what it looks at, distance, azimuth, elevation, angle of view [m, deg].
"""

import sys
from collections.abc import Mapping

import mujoco
import numpy as np

SQUARE = 1.0
"""Edge of a square of the floor [m]."""

SURROUNDINGS = """
<mujoco>
  <visual>
    <global offheight="{height}" offwidth="{width}" fovy="{fovy}"/>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.15 0.15 0.15" specular="0 0 0"/>
    <map zfar="50" znear="0.01"/>
  </visual>
  <statistic extent="{span}" center="{x} {y} 0"/>
  <asset>
    <texture name="squares" type="2d" builtin="flat" mark="edge" width="256" height="256" rgb1="0.97 0.98 0.99"
             markrgb="0.7 0.7 0.72"/>
    <material name="squares" texture="squares" texrepeat="{squares} {squares}" specular="0"/>
  </asset>
  <worldbody>
    <geom type="plane" size="{half} {half} 1" pos="{floor_x} {floor_y} {floor}" material="squares"/>
    <light directional="true" castshadow="false" dir="-0.4 0.3 -1" specular="0.1 0.1 0.1" diffuse="0.45 0.45 0.45"
           pos="{x} {y} {span}"/>
  </worldbody>
</mujoco>
"""


def main(scene_file: str, frames_file: str) -> None:
    """Draw every frame of a scene, (K, height, width, 3)."""
    mujoco.set_mju_user_warning(lambda message: None)  # instead of a file in the current directory
    with np.load(scene_file) as scene:
        model, poses, look = model_of(scene), scene["poses"], scene["camera"]
        height, width = map(int, scene["size"])
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    camera.lookat[:] = look[:3]
    camera.distance, camera.azimuth, camera.elevation = look[3:6]
    shape = (len(poses), height, width, 3)
    frames = np.lib.format.open_memmap(frames_file, mode="w+", dtype=np.uint8, shape=shape)
    with mujoco.Renderer(model, height, width) as renderer:
        for frame, places in zip(frames, poses, strict=True):
            data.mocap_pos[:, :2] = places[:, :2]
            data.mocap_quat[:, 0], data.mocap_quat[:, 3] = np.cos(places[:, 2] / 2), np.sin(places[:, 2] / 2)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frame[:] = renderer.render()
    frames.flush()


def model_of(scene: Mapping[str, np.ndarray]) -> "mujoco.MjModel":
    """Return the bodies of a scene on a floor of squares, as a model in which each is moved by its pose."""
    (left, right, bottom, top), (height, width) = scene["view"], map(int, scene["size"])
    x, y, span = (left + right) / 2, (bottom + top) / 2, max(right - left, top - bottom)
    squares = 2 * int(np.ceil(5 * span / SQUARE))
    numbers = {"height": height, "width": width, "fovy": scene["camera"][6], "span": span, "x": x, "y": y}
    numbers |= {"squares": squares, "half": squares * SQUARE / 2, "floor": float(scene["floor"])}
    numbers |= {"floor_x": round(x / SQUARE) * SQUARE, "floor_y": round(y / SQUARE) * SQUARE}
    spec = mujoco.MjSpec.from_string(SURROUNDINGS.format(**numbers))
    for kind, size, color in zip(scene["kinds"], scene["sizes"], scene["colors"], strict=True):
        body = spec.worldbody.add_body(mocap=True)
        geom = body.add_geom(rgba=[*color, 1], contype=0, conaffinity=0)
        geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{str(kind).upper()}")
        geom.size = size
        if kind == "capsule":
            geom.fromto = [-size[1] / 2, 0, 0, size[1] / 2, 0, 0]
    return spec.compile()


if __name__ == "__main__":
    main(*sys.argv[1:])
