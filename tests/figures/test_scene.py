from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from psmpc_cli.figures.object_motion import object_pose
from psmpc_cli.figures.robot_drawing import View
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.scene import ELEVATION, FIELD_OF_VIEW, camera_on, scene_of
from psmpc_cli.robot.mujoco_model import mujoco_spec

Load = Callable[..., Run]


@pytest.mark.parametrize("view", [View((-4, 2), (-1, 3)), View((100, 101), (-3, -2)), View((0, 2000), (0, 500))])
def test_the_camera_sees_the_whole_view_and_hardly_more(view: View) -> None:
    size = (400, 640)
    *place, distance, azimuth, elevation = camera_on(view, size)
    assert (azimuth, elevation) == (90, -ELEVATION)
    c, s = np.cos(np.radians(ELEVATION)), np.sin(np.radians(ELEVATION))
    corners = np.array([[x, y, 0] for x in view.x for y in view.y])
    seen = corners - (np.array(place) - distance * np.array([0, c, -s]))
    depth = seen @ [0, c, -s]
    tall = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    beside, above = seen[:, 0] / depth / (tall * size[1] / size[0]), seen @ [0, s, c] / depth / tall
    assert max(np.abs(beside).max(), np.abs(above).max()) == pytest.approx(1)


def test_what_is_seen_is_what_ran(run: Run) -> None:
    times = np.array([0.0, 12.0, 20.0])
    scene = scene_of(run, times)
    np.testing.assert_array_equal(scene.qpos, [run.coordinates_at(time) for time in times])
    np.testing.assert_array_equal(scene.mocap, [object_pose(run, time) for time in times])
    assert (scene.size[0] % 2, scene.size[1] % 2) == (0, 0)


def test_bodies_to_look_at_leave_the_physics_alone(run: Run) -> None:
    plain = mujoco_spec(run.model.spec).compile()
    dressed = mujoco.MjModel.from_xml_string(scene_of(run, run.time).mjcf)
    for name in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(dressed, name)[: plain.nbody])
    assert dressed.ngeom > plain.ngeom == 0
    assert dressed.opt.disableflags == plain.opt.disableflags


def test_a_run_without_an_object_has_none(load: Load, one_arm: dict[str, object]) -> None:
    scene = scene_of(load(**one_arm), np.array([0.0, 3.0]))
    assert scene.mocap.shape == (2, 0)
    assert mujoco.MjModel.from_xml_string(scene.mjcf).nmocap == 0
