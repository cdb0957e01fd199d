"""Files of URDF: what is wrong with them, and what is assumed of them."""

from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import kind_of_reference, load_robot, load_task
from psmpc_cli.specs.parts import MOBILITIES
from psmpc_cli.specs.robots.covers import Mesh, cover_box, cover_mesh
from psmpc_cli.specs.robots.robot import RobotSpec, SpatialRobot
from psmpc_cli.specs.robots.urdf import read_urdf

Array = NDArray[np.float64]

PARTS = {
    "base": '<link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
    "link": '<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
    "joint": '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1"/></joint>',
}


def part(name: str, right: str, wrong: str) -> dict[str, str]:
    """One part with something replaced."""
    assert right in PARTS[name]
    return {name: PARTS[name].replace(right, wrong)}


def of_links(number: int) -> str:
    """A robot of so many links without joints."""
    return "<robot name='r'>" + "".join(f"<link name='l{i}'/>" for i in range(number)) + "</robot>"


CIRCLE = '<joint name="k" type="fixed"><parent link="arm"/><child link="base"/></joint>'


def written(folder: Path, **changed: str) -> Path:
    """A robot of two links in a file, some parts of it replaced."""
    path = folder / "robot.urdf"
    path.write_text(
        "<robot name='r'>\n" + "\n".join(part for part in {**PARTS, **changed}.values() if part) + "\n</robot>\n"
    )
    return path


@pytest.mark.parametrize(
    ("changed", "line", "words"),
    [
        ({"joint": PARTS["joint"].replace('"arm"', '"arn"')}, 4, ("unknown link", "arn", "arm")),
        ({"joint": PARTS["joint"].replace("revolute", "ball")}, 4, ("ball", "revolute", "fixed")),
        ({"joint": PARTS["joint"].replace("0 0 1", "0 0 0")}, 4, ("axis", "length 0")),
        ({"joint": PARTS["joint"].replace("0 0 1", "0 1")}, 4, ("0 1", "3 numbers")),
        ({"joint": PARTS["joint"].replace('lower="-1"', 'lower="2"')}, 4, ("limits", "lower one first")),
        ({"joint": PARTS["joint"].replace('<parent link="base"/>', "")}, 4, ("no parent",)),
        ({"joint": ""}, 1, ("2 links that no joint carries", "base, arm")),
        ({"more": PARTS["joint"].replace('"j"', '"k"')}, 5, ("carried by two joints", "j", "k")),
        ({"more": CIRCLE}, 1, ("circle",)),
        ({"link": PARTS["link"].replace('value="1"', 'value="0"')}, 3, ("no mass", "arm")),
        ({"link": PARTS["link"].replace('value="1"', 'value="-1"')}, 3, ("mass of -1",)),
        ({"link": PARTS["link"].replace('value="1"', 'value="one"')}, 3, ("one", "number")),
        ({"link": PARTS["link"].replace('ixx="1"', 'ixx="-1"')}, 3, ("principal moments", "-1")),
        ({"link": PARTS["link"].replace('ixx="1"', "")}, 3, ("ixx",)),
        ({"link": PARTS["base"]}, 3, ("second link", "base", "line 2")),
        ({"link": PARTS["link"].replace('name="arm"', "")}, 3, ("without a name",)),
        ({"base": ""}, 3, ("unknown link", "base", "arm")),
        (
            part("joint", "<limit", '<axis xyz="1 0 0"/><limit'),
            4,
            ("second <axis>", '"j"', "line 4"),
        ),
        (part("joint", "<parent", '<parent link="arm"/><parent'), 4, ("second <parent>", '"j"')),
        (part("joint", "<limit", "<limit/><limit"), 4, ("second <limit>", '"j"', "one at most")),
        (part("link", "<mass", '<mass value="2"/><mass'), 3, ("second <mass>", '"arm"')),
        (part("link", "</link>", "<inertial/></link>"), 3, ("second <inertial>", '"arm"')),
        (part("link", 'value="1"', 'value="1_0"'), 3, ("1_0", 'link "arm"', "number")),
        (part("link", 'value="1"', 'value="\uff11"'), 3, ("mass value", "number")),
        (part("link", 'value="1"', 'value="1e13"'), 3, ("1e13", 'link "arm"', "at most 1e+12")),
        (part("joint", "0 0 1", "0 1e300 1e300"), 4, ("axis", "1e300", 'joint "j"', "at most 1e+12")),
        (
            part("joint", "<axis", '<origin xyz="1e300 0 0"/><axis'),
            4,
            ("origin xyz", "at most 1e+12"),
        ),
        (
            part("joint", "<axis", '<origin rpy="0 1e300 0"/><axis'),
            4,
            ("origin rpy", "at most 1e+12"),
        ),
        (part("joint", 'lower="-1"', 'lower="1"'), 4, ("limits 1, 1", '"j"', 'type="fixed"')),
        (
            part("joint", 'upper="1"', 'upper="1e16"'),
            4,
            ("limits -1, 1e+16", '"j"', "within 1e+12"),
        ),
        (part("joint", 'upper="1"', 'upper="inf"'), 4, ("limit upper", "inf", "number")),
        (part("joint", "<limit", '<limit effort="-4"'), 4, ("effort -4", '"j"', "positive")),
        (part("joint", "<limit", '<limit effort="4 N m"'), 4, ("limit effort", "4 N m", "number")),
        # what only the robot as a whole shows
        (part("link", 'ixx="1"', 'ixx="5"'), 3, ('link "arm"', "inertia", "sum of the others")),
        (part("link", 'value="1"', 'value="1e-13"'), 3, ('link "arm"', "mass", "1e-12")),
        (part("base", 'ixx="1"', 'ixx="5"'), 2, ('link "base"', "inertia", "sum of the others")),
        (
            part("joint", "<limit", '<limit velocity="-1"'),
            4,
            ('joint "j"', "velocity", "at least 0"),
        ),
        (
            {key: part.replace('"arm"', '"arm.0"') for key, part in PARTS.items()},
            3,
            ('leaf "arm.0"', "no arm may have", "arms: {NAME: {tip: arm.0}}"),
        ),
        (
            {key: part.replace('"arm"', '"arms"') for key, part in PARTS.items()},
            3,
            ('leaf "arms"', "no arm may have", "arms: {NAME: {tip: arms}}"),
        ),
    ],
)
def test_a_bad_urdf_names_line_and_what_would_be_right(
    tmp_path: Path, changed: dict[str, str], line: int, words: tuple[str, ...]
) -> None:
    with pytest.raises(SpecError) as caught:
        load_robot(written(tmp_path, **changed))
    assert f"robot.urdf:{line}:" in str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='r'><link", ("no XML", "1:")),
        ("<sdf version='1.7'/>", ("<sdf>", "<robot>")),
        (
            "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='x'/></robot>",
            ("xacro",),
        ),
        *(
            (f"<robot name='r' xmlns:{prefix}='{space}'><{prefix}:include filename='x'/></robot>", ("run xacro",))
            for prefix, space in (
                ("xacro", "http://ros.org/wiki/xacro"),
                ("xacro", "http://wiki.ros.org/xacro"),
                ("xacro", "http://example.org"),
                ("x", "http://ros.org/wiki/xacro"),
            )
        ),
        ("<robot name='r'><xacro:include filename='x'/></robot>", ("run xacro",)),
        ("<robot name='$(arg name)'><link name='base'/></robot>", ("run xacro",)),
        ("<robot name='r'>\n<link name='${prefix}base'/></robot>", ("robot.urdf:2:", "run xacro")),
        (
            of_links(8001),
            ("8001 links", "at most 1000"),
        ),
        (
            of_links(900),
            ("900 links", "l0, l1", "..."),
        ),
        ("<robot name='r'/>", ("without links",)),
        ("not xml", ("no XML",)),
    ],
)
def test_a_file_that_is_no_robot_is_one_error(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    (tmp_path / "robot.urdf").write_text(text)
    with pytest.raises(SpecError) as caught:
        read_urdf(tmp_path / "robot.urdf")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert all(word in str(caught.value) for word in words), str(caught.value)


SRDF = "<robot name='r'><group name='arm'><chain base_link='a' tip_link='b'/></group></robot>"


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("r.sdf", "<sdf version='1.7'/>", "an SDF file (<sdf>)"),
        ("r.srdf", SRDF, "an SRDF file (<robot> without links)"),
        ("r.mjcf", "<mujoco model='r'/>", "a MuJoCo model (<mujoco>)"),
        ("r.xml", "<mujoco model='r'/>", "a MuJoCo model (<mujoco>)"),
        ("r.XML", "<COLLADA/>", "the element <COLLADA>"),
        ("r.urdf", SRDF, "an SRDF file (<robot> without links)"),
        ("r", "\ufeff<?xml version='1.0'?>\n<sdf/>", "an SDF file (<sdf>)"),
        ("r.yaml", "<sdf/>", "an SDF file (<sdf>)"),
    ],
)
def test_other_xml_files_are_called_what_they_are(tmp_path: Path, name: str, text: str, found: str) -> None:
    """Wherever a robot or a task is expected: the outermost element says it, not the ending."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    assert kind_of_reference(path) == "robot"
    (tmp_path / "mine.yaml").write_text(f"urdf: {name}\n")
    for reference in (path, tmp_path / "mine.yaml"):
        with pytest.raises(
            SpecError, match=r"found .*, expected a URDF file \(<robot> with links and joints\)"
        ) as caught:
            load_robot(reference)
        assert f"found {found}, expected" in str(caught.value)
    with pytest.raises(SpecError, match="expected a task: a YAML file with the keys robot, ") as caught:
        load_task(path)
    assert f"found {found}, expected" in str(caught.value)


@pytest.mark.parametrize("name", ["robot.URDF", "robot.xml", "robot"])
def test_a_urdf_is_one_whatever_its_name(tmp_path: Path, name: str) -> None:
    path = written(tmp_path).rename(tmp_path / name)
    assert kind_of_reference(path) == "robot"
    assert load_robot(path).parts == {"base": 6, "arm": 1}


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [("iso-8859-1", "ISO-8859-1"), ("utf-16", "UTF-16"), ("utf-8-sig", "UTF-8"), ("cp1252", "windows-1252")],
)
def test_a_urdf_is_read_in_the_encoding_that_it_declares(tmp_path: Path, encoding: str, declared: str) -> None:
    path = written(tmp_path, **{key: text.replace('"arm"', '"bras_plié"') for key, text in PARTS.items()})
    text = path.read_text(encoding="utf-8")
    path.write_bytes(f'<?xml version="1.0" encoding="{declared}"?>\n{text}'.encode(encoding))
    assert load_robot(path).parts == {"base": 6, "bras_plié": 1}


@pytest.mark.parametrize("mobility", [*MOBILITIES])
@pytest.mark.parametrize("in_task", [False, True])
def test_only_a_fixed_base_may_have_no_mass(tmp_path: Path, mobility: str, in_task: bool) -> None:
    written(tmp_path, base='<link name="base"/>')
    own = "" if in_task else f"mobility: {mobility}\n"
    (tmp_path / "robot.yaml").write_text(f"urdf: robot.urdf\n{own}")
    task = {
        "robot": str(tmp_path / "robot.yaml"),
        **({"mobility": mobility} if in_task else {}),
        "initial": {"base": [0, 0, 0, 1, 0, 0, 0], "arm": [0.1]},
        "skills": {"move": {"space": "joint", "weights": {"arm": [1], "base": [1] * 6, "control": 1}}},
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"base": [0, 0, 0, 1, 0, 0, 0], "arm": [0.2]},
                "ends_when": {"coordinates": "arm"},
            }
        ],
    }
    if mobility == "fixed":
        robot = load_task(task).robot
        assert (robot.base.mass, robot.mobility) == (0, "fixed")
        assert isinstance(robot, SpatialRobot) and any("has no mass" in note for note in robot.assumed)
        return
    with pytest.raises(SpecError, match=f'link "base": base.mass: found 0.0, .* a {mobility} base moves'):
        load_task(task)


def test_the_link_whose_inertia_is_impossible_is_blamed(tmp_path: Path) -> None:
    """Not the one that carries it."""
    fixed = '<joint name="k" type="fixed"><parent link="arm"/><child link="tip"/></joint>'
    for wrong, words in (('ixx="9"', "sum of the others"), ('ixx="-9"', "found principal moments")):
        tip = PARTS["link"].replace('"arm"', '"tip"').replace('ixx="1"', wrong)
        with pytest.raises(SpecError, match=words) as caught:
            load_robot(written(tmp_path, tip=tip, k=fixed))
        assert "robot.urdf:5: " in str(caught.value)
        assert '"tip"' in str(caught.value)


def test_efforts_of_0_are_assumed_to_be_none(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, **part("joint", "<limit", '<limit effort="0"')))
    assert robot.limits["arm"].force is None
    assert any('the effort of joint "j" is 0' in note for note in robot.assumed)


def test_a_file_with_many_errors_names_the_first(tmp_path: Path) -> None:
    joints = (f'<joint name="k{i}" type="fixed"><parent link="m"/><child link="m"/></joint>' for i in range(900))
    with pytest.raises(SpecError, match='unknown link "m" of joint "k0"') as caught:
        read_urdf(written(tmp_path, more="\n".join(joints)))
    assert "more problems" in str(caught.value)
    assert len(str(caught.value).splitlines()) < 100


def test_a_file_of_xacro_is_told_by_its_name_too(tmp_path: Path) -> None:
    path = written(tmp_path, link=PARTS["link"].replace('value="1"', 'value="${mass}"'))
    with pytest.raises(SpecError, match=r"robot.urdf.xacro:3: .*run xacro"):
        load_robot(path.rename(tmp_path / "robot.urdf.xacro"))


def test_a_file_that_xacro_wrote_may_still_name_its_namespace(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("<robot ", "<robot xmlns:xacro='http://www.ros.org/wiki/xacro' "))
    assert load_robot(path).parts == {"base": 6, "arm": 1}


def test_errors_of_arms_that_a_file_names_are_at_their_link(tmp_path: Path) -> None:
    written(tmp_path, **part("link", 'ixx="1"', 'ixx="5"'))
    (tmp_path / "robot.yaml").write_text("urdf: robot.urdf\narms: {left: {tip: arm}}\n")
    with pytest.raises(SpecError, match=r'robot.urdf:3: link "arm": arms.left.links\[0\].inertia: found'):
        load_robot(tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    ("written_limit", "position", "velocity", "words"),
    [
        ('lower="-1" upper="1" velocity="0"', ((-1, 1),), None, ("velocity", "is 0", "without a limit")),
        ('lower="-1" upper="1"', ((-1, 1),), None, ("velocity", "not given", "without a limit")),
        ('lower="-1" upper="1" velocity="1e16"', ((-1, 1),), None, ("velocity", "beyond 1e+12", "without a limit")),
        ('lower="0" upper="0" velocity="2"', None, ((-2, 2),), ("limits", "both 0", "without limits")),
        ('velocity="2"', None, ((-2, 2),), ("limits", "not given", "without limits")),
        ('lower="-1e16" upper="1e16" velocity="2"', None, ((-2, 2),), ("limits", "beyond 1e+12", "without limits")),
    ],
)
def test_limits_that_say_nothing_are_assumed_to_be_none(
    tmp_path: Path, written_limit: str, position: object, velocity: object, words: tuple[str, ...]
) -> None:
    """Exporters write 0 for what they do not know, or 1e16."""
    robot = load_robot(written(tmp_path, joint=PARTS["joint"].replace('lower="-1" upper="1"', written_limit)))
    assert any(all(word in note for word in ('joint "j"', *words)) for note in robot.assumed), robot.assumed
    assert (robot.limits["arm"].position, robot.limits["arm"].velocity) == (position, velocity)


def test_a_long_axis_is_scaled(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, joint=PARTS["joint"].replace("0 0 1", "0 3e11 4e11")))
    np.testing.assert_allclose(robot.joints[0].axis, (0, 0.6, 0.8))
    assert any("length 5e+11: scaled to 1" in note for note in robot.assumed)


def test_what_is_assumed_is_noted(tmp_path: Path) -> None:
    joint = PARTS["joint"].replace('<limit lower="-1" upper="1"/>', "").replace("0 0 1", "0 0 2")
    fixed = '<joint name="k" type="fixed"><parent link="arm"/><child link="tip"/></joint>'
    tip = '<link name="tip"><odd/><visual><geometry><mesh filename="no.stl"/></geometry></visual></link>'
    notes = "\n".join(load_robot(written(tmp_path, joint=joint, tip=tip, k=fixed)).assumed)
    for word in ("no <limit>", "length 2", "no <inertial>", "<odd>", "visual mesh"):
        assert word in notes
    fast = PARTS["joint"].replace("<limit", '<origin rpy="90 0 0"/><limit velocity="120"')
    notes = "\n".join(load_robot(written(tmp_path, joint=fast)).assumed)
    assert "120 rad/s" in notes
    assert 'rpy="90 0 0"' in notes
    floating = load_robot(written(tmp_path, joint=PARTS["joint"].replace("revolute", "floating")))
    assert any("floating: taken as fixed" in note for note in floating.assumed)
    turned = PARTS["joint"].replace('lower="-1" upper="1"', 'lower="-90" upper="90"')
    robot = load_robot(written(tmp_path, joint=turned))
    assert any("limits -90, 90 rad" in note and "degrees" in note for note in robot.assumed)
    assert robot.limits["arm"].position == ((-90, 90),)


def test_locked_and_fixed_joints_leave_their_bodies_mass(tmp_path: Path) -> None:
    """A locked joint turns what it carries: the base's centre of mass is where the arm's is."""
    arm = PARTS["link"].replace("<mass", '<origin xyz="0.5 0 0"/><mass')
    written(tmp_path, link=arm)
    (tmp_path / "robot.yaml").write_text("urdf: robot.urdf\nlocked: {j: 90 deg}\n")
    robot = load_robot(tmp_path / "robot.yaml")
    assert robot.base.mass == 10
    np.testing.assert_allclose(robot.base.centre_of_mass, [0, 0.05, 0], atol=1e-15)
    assert any("locked" in note for note in robot.assumed)


def colliding(shape: str, origin: str = "") -> str:
    """The link of the arm with a collision shape."""
    return PARTS["link"].replace("</link>", f"<collision>{origin}<geometry>{shape}</geometry></collision></link>")


def points_in(robot: RobotSpec, body: str, points: Array) -> Array:
    """How deep points (K, 3) in a body's frame are in its capsules and spheres (K,)."""
    found = []
    for each in robot.geometry[body]:
        assert each.pose is not None
        local = Rotation.from_quat(each.pose[3:], scalar_first=True).inv().apply(points - each.pose[:3])
        radius, length = each.shape.shape.size
        local[:, 0] -= np.clip(local[:, 0], -length / 2, length / 2)
        found.append(radius - np.linalg.norm(local, axis=1))
    return np.max(found, axis=0)


def test_spheres_and_boxes_are_taken_as_they_are(tmp_path: Path) -> None:
    origin = '<origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/>'
    robot = load_robot(written(tmp_path, link=colliding('<sphere radius="0.2"/>', origin)))
    (placed,) = robot.geometry["arm.1"]
    assert placed.shape.sphere == 0.2
    assert placed.pose is not None
    np.testing.assert_allclose(placed.pose, [1, 2, 3, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-12)
    assert not any("covered" in note for note in robot.assumed)
    robot = load_robot(written(tmp_path, link=colliding('<box size="0.2 0.4 0.1"/>')))
    assert [placed.shape.box for placed in robot.geometry["arm.1"]] == [(0.2, 0.4, 0.1)]
    cover = cover_box((0.2, 0.4, 0.1))
    wanted = f'link "arm" is covered: a box by {len(cover.ends)} capsules, up to {cover.excess:.2g} m beyond it'
    assert any(wanted in note for note in robot.assumed)


def test_a_cylinder_is_covered_by_the_capsule_about_it(tmp_path: Path) -> None:
    """It is along z; its origin turns z to x."""
    link = colliding('<cylinder radius="0.1" length="1"/>', '<origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>')
    robot = load_robot(written(tmp_path, link=link))
    (placed,) = robot.geometry["arm.1"]
    assert placed.shape.capsule == pytest.approx((0.1, 1.0))
    rim = np.array([[x, 0.1 * np.cos(a), 0.1 * np.sin(a)] for x in (0, 0.5, 1) for a in np.arange(12)])
    np.testing.assert_allclose(points_in(robot, "arm.1", rim), 0, atol=1e-9)
    assert any("a cylinder by 1 capsule, up to 0.1 m beyond it" in note for note in robot.assumed)


def test_shapes_of_links_that_do_not_move_are_on_the_body_they_are_part_of(tmp_path: Path) -> None:
    fixed = '<joint name="k" type="fixed"><origin xyz="0 0 2"/><parent link="arm"/><child link="tip"/></joint>'
    sphere = '<collision><origin xyz="0 1 0"/><geometry><sphere radius="0.3"/></geometry></collision>'
    tip = f'<link name="tip">{sphere}</link>'
    robot = load_robot(written(tmp_path, tip=tip, k=fixed))
    (body,) = robot.geometry
    assert body == "tip.1"
    assert robot.geometry[body][0].pose == (0, 1, 2, 1, 0, 0, 0)


@pytest.mark.parametrize("reference", ["arm.stl", "meshes/arm.stl", "package://my_robot/meshes/arm.stl", "file://{}"])
def test_the_hull_of_a_mesh_is_covered(tmp_path: Path, reference: str) -> None:
    """Wherever its file is: beside the URDF, or in a package that the URDF's folder is in."""
    folder = tmp_path / "my_robot" / "urdf"
    inside = reference.format(folder / "arm.stl").removeprefix("file://")
    path = tmp_path / inside.removeprefix("package://") if "package" in inside else folder / inside
    path.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    rod = trimesh.creation.cylinder(50, 800)  # [mm]
    rod.export(path)
    mesh = f'<mesh filename="{reference.format(folder / "arm.stl")}" scale="0.001 0.001 0.001"/>'
    robot = load_robot(written(folder, link=colliding(mesh, '<origin xyz="0 0 0.4"/>')))
    vertices = np.asarray(rod.vertices) / 1000 + [0, 0, 0.4]
    assert points_in(robot, "arm.1", vertices).min() > -1e-6
    excess = cover_mesh(vertices).excess
    wanted = f'link "arm" is covered: the convex hull of "arm.stl" by 1 capsule, up to {excess:.2g} m beyond it'
    assert any(wanted in note for note in robot.assumed), robot.assumed


def test_meshes_of_visuals_are_not_read_and_an_open_one_is_noted(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 2, 3))
    box.update_faces(np.arange(len(box.faces)) > 0)
    box.export(tmp_path / "open.stl")
    seen = '<visual><geometry><mesh filename="missing.stl"/></geometry></visual></link>'
    link = colliding('<mesh filename="open.stl"/>').replace("</link>", seen)
    robot = load_robot(written(tmp_path, link=link))
    assert any("1 visual mesh is not read" in note for note in robot.assumed)
    assert any('the convex hull of the open mesh "open.stl"' in note for note in robot.assumed)
    assert not any("missing.stl" in note for note in robot.assumed)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<mesh filename="no.stl"/>', ("no readable file", "no.stl", 'left out of link "arm"')),
        ('<mesh filename="package://other/no.stl"/>', ("package://other/no.stl", "other", 'left out of link "arm"')),
        ('<mesh filename="arm.dae"/>', ("arm.dae", ".stl or .obj", 'left out of link "arm"')),
        ('<sphere radius="0"/>', ("a sphere", '"arm"', "size of 0", "left out")),
        ('<box size="0.1 -0.1 0.1"/>', ("a box", "size of -0.1", "left out")),
        ("<torus/>", ("<torus>", '"arm"', "left out")),
        ("", ("nothing", '"arm"', "left out")),
        ('<mesh filename="ball.obj" scale="1e12 1e12 1e12"/>', ("reaches to 1e+12 m", "at most 2.5e+11 m", "left out")),
        ('<mesh filename="far.obj"/>', ("a vertex at inf", "far.obj", "left out")),
    ],
)
def test_shapes_that_cannot_be_taken_are_left_out_and_noted(tmp_path: Path, shape: str, words: tuple[str, ...]) -> None:
    trimesh.creation.icosphere(1).export(tmp_path / "ball.obj")
    (tmp_path / "far.obj").write_text("v 0 0 0\nv 1e999 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 4\nf 1 2 3\n")
    robot = load_robot(written(tmp_path, link=colliding(shape)))
    (note,) = [note for note in robot.assumed if "left out" in note]
    assert note.startswith("robot.urdf, line 3: ") and all(word in note for word in words), note
    assert not robot.geometry


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<sphere radius="big"/>', ("sphere radius", "big", 'link "arm"')),
        ('<cylinder radius="1"/>', ("no cylinder length", 'link "arm"')),
        ('<box size="1 1"/>', ("box size", "3 numbers", 'link "arm"')),
        ("<mesh/>", ("without a file", 'link "arm"', "filename")),
        ('<mesh filename="a.stl" scale="1"/>', ("mesh scale", "3 numbers", 'link "arm"')),
    ],
)
def test_bad_shapes_are_named_with_line_and_link(tmp_path: Path, shape: str, words: tuple[str, ...]) -> None:
    with pytest.raises(SpecError) as caught:
        load_robot(written(tmp_path, link=colliding(shape)))
    assert ":3: found" in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)


def test_the_file_says_more_than_the_urdf_of_a_body(tmp_path: Path) -> None:
    """Its shapes replace those of the body, whose meshes are then not even read."""
    written(
        tmp_path,
        base=PARTS["base"].replace(
            "</link>", '<collision><geometry><sphere radius="1"/></geometry></collision></link>'
        ),
        link=colliding('<mesh filename="no.stl"/>'),
    )
    (tmp_path / "robot.yaml").write_text("urdf: robot.urdf\ngeometry: {arm.1: [{shape: {sphere: 0.5}}]}\n")
    robot = load_robot(tmp_path / "robot.yaml")
    assert {body: shapes[0].shape.sphere for body, shapes in robot.geometry.items()} == {"base": 1, "arm.1": 0.5}
    assert not any("no.stl" in note for note in robot.assumed)


def test_a_urdf_without_collision_shapes_has_no_geometry(tmp_path: Path) -> None:
    assert load_robot(written(tmp_path)).geometry == {}
    assert "geometry" not in load_robot("dual_arm_servicer").model_dump(mode="json")


REJECTED = {
    "allegro_hand_description/urdf/allegro_left_hand.urdf": "whose name no arm may have",
    "allegro_hand_description/urdf/allegro_right_hand.urdf": "whose name no arm may have",
    "human_description/robots/human.urdf": "found no mass of",
    "icub_description/robots/icub.urdf": "expected positive ones",
    "icub_description/robots/icub_reduced.urdf": "expected positive ones",
    "romeo_description/urdf/romeo.urdf": "found no mass of",
    "romeo_description/urdf/romeo_laas_small.urdf": "expected positive ones",
    "romeo_description/urdf/romeo_small.urdf": "no principal moment above the sum of the others",
    "ur_description/urdf/ur3.urdf": "a robot without links",
}
"""Files whose links cannot move on their own, or cannot be told apart by names."""


@pytest.mark.slow
def test_published_robots_are_read_or_rejected_for_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every URDF of a collection of robots, without their meshes."""
    monkeypatch.setattr("psmpc_cli.specs.robots.urdf.read_mesh", _no_mesh)
    package = distribution("example-robot-data")
    found = [file for file in package.files or () if file.suffix == ".urdf"]
    reasons = {}
    for file in found:
        try:
            load_robot(Path(str(file.locate())))
        except SpecError as error:
            reasons[str(file).partition("/robots/")[2]] = str(error)
    assert len(found) > 60
    assert reasons.keys() == REJECTED.keys()
    assert all(REJECTED[file] in reason for file, reason in reasons.items()), reasons


def _no_mesh(path: Path) -> Mesh:
    raise SpecError(f"found {path.name}, which this test does not read")
