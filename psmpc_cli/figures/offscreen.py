"""Draws a MuJoCo scene off screen: a program of its own, for the driver behind it is chosen once, and may crash.

Usage: offscreen.py SCENE.npz FRAMES.npy, with MUJOCO_GL saying which driver. The scene holds `mjcf`, `qpos` (K, n),
`mocap` (K, 3) poses in the plane, no column without such a body, `camera` (x, y, z of what it looks at, distance,
azimuth, elevation [m, deg]) and `size` (height, width). Imports nothing of the package.
"""

import sys

import mujoco
import numpy as np


def main(scene_file: str, frames_file: str) -> None:
    """Draw every frame of a scene, (K, height, width, 3)."""
    mujoco.set_mju_user_warning(lambda message: None)  # instead of a file in the current directory
    with np.load(scene_file) as scene:
        qpos, mocap, size = scene["qpos"], scene["mocap"], scene["size"]
        model, camera = mujoco.MjModel.from_xml_string(str(scene["mjcf"])), mujoco.MjvCamera()
        camera.lookat[:] = scene["camera"][:3]
        camera.distance, camera.azimuth, camera.elevation = scene["camera"][3:]
    data, shape = mujoco.MjData(model), (len(qpos), *map(int, size), 3)
    frames = np.lib.format.open_memmap(frames_file, mode="w+", dtype=np.uint8, shape=shape)
    with mujoco.Renderer(model, *map(int, size)) as renderer:
        for frame, Q, pose in zip(frames, qpos, mocap, strict=True):
            data.qpos[:] = Q
            if len(pose):
                data.mocap_pos[0, :2] = pose[:2]
                data.mocap_quat[0] = np.cos(pose[2] / 2), 0, 0, np.sin(pose[2] / 2)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frame[:] = renderer.render()
    frames.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
