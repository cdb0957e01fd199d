"""Robots from URDF: links and joints read with their lines, merged into the bodies that move, as keys of our own files.

What a file leaves out is assumed and noted; what cannot be a robot is an error. URDF's frames: a joint's frame is that
of its child link, its `<origin>` is in the parent link's frame, rpy are angles about fixed axes.
"""

import codecs
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from psmpc_cli.errors import SpecError
from psmpc_cli.progress import Work
from psmpc_cli.specs.document import (
    DECIMAL,
    LARGEST,
    MOST_FAULTS,
    Location,
    choice,
    counted,
    printable,
    quoted,
    shortened,
)
from psmpc_cli.specs.files import read_bytes, shown
from psmpc_cli.specs.parts import ERROR_AXES
from psmpc_cli.specs.robots.covers import Cover, cover_box, cover_mesh, read_mesh
from psmpc_cli.specs.robots.robot import UrdfRobot, is_arm_name, limits_of_part

Matrix = NDArray[np.float64]

XML_ENDINGS = (".urdf", ".xacro", ".sdf", ".srdf", ".mjcf", ".xml")
"""Endings, in small letters, of files that are read as URDF, or rejected with what they are and what to do about it."""

URDF = "a URDF file (<robot> with links and joints)"

XML_KINDS = {
    "robot": URDF,
    "srdf": "an SRDF file (<robot> without links)",
    "sdf": "an SDF file (<sdf>)",
    "mujoco": "a MuJoCo model (<mujoco>)",
}
"""What is said of XML files, by their outermost element; that of SRDF is also <robot>."""

SRDF_ELEMENTS = (
    "group",
    "group_state",
    "end_effector",
    "virtual_joint",
    "disable_collisions",
    "disable_default_collisions",
)
"""Elements by which SRDF is told from a URDF without links."""


@dataclass(frozen=True)
class JointType:
    """What a type of joint of URDF means here.

    Attributes:
        moves: It has a coordinate.
        slides: The coordinate is a length.
        is_bounded: It has limits, which are expected.
        is_rigid: It is fixed, in URDF too.
    """

    moves: bool = False
    slides: bool = False
    is_bounded: bool = False
    is_rigid: bool = False


JOINT_TYPES = {
    "revolute": JointType(moves=True, is_bounded=True),
    "continuous": JointType(moves=True),
    "prismatic": JointType(moves=True, slides=True, is_bounded=True),
    "fixed": JointType(is_rigid=True),
    "floating": JointType(),
    "planar": JointType(),
}

FOREIGN = ("gazebo", "transmission")
"""Elements that do not describe the robot itself."""

READ = {
    "robot": ("link", "joint", "material", *FOREIGN),
    "link": ("inertial", "visual", "collision", "contact"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "safety_controller", "calibration", "mimic"),
}
"""Elements of URDF, by the one they are in; others are noted."""

SIZES = {
    "sphere": {"radius": (1, "")},
    "cylinder": {"radius": (1, ""), "length": (1, "")},
    "box": {"size": (3, "")},
    "mesh": {"scale": (3, "1 1 1")},
}
"""Collision shapes: the attributes that have their sizes, how many numbers each, and what is taken without it."""

LIMITED = ("position", "velocity", "force")
"""Quantities of which URDF has limits."""

DEGREES_FROM = 4 * np.pi
"""Angles [rad] and their rates [rad/s] beyond this look as if they were in degrees."""

_ZEROS = {"0", "0.0"}
"""How exporters write that there is no friction."""

MOST_LINKS = 1000
"""Links of a file; robots with hands have some hundred."""

SMALLEST = 1e-9
"""Size of a collision shape [m] below which it is left out."""

MOST_LISTED = 5
"""Names of links that a message lists."""

Sources = dict[Location, str]
"""What a key of our own files was built from: file, line, kind and name of a link or joint, by path."""

Places = dict[str, tuple[str, Matrix]]
"""By link, its body and its frame in that of the body (4, 4)."""


@dataclass(frozen=True)
class Collision:
    """A collision shape of a link.

    Attributes:
        sourceline: Its line.
        origin: Its frame in the link's (4, 4) [m].
        kind: sphere, cylinder, box or mesh.
        size: Radius; radius and length; edges; or how a mesh is scaled along its axes [m].
        mesh: The mesh's file as it is written.
    """

    sourceline: int
    origin: Matrix
    kind: str
    size: tuple[float, ...]
    mesh: str = ""


@dataclass(frozen=True)
class UrdfLink:
    """A link: its element, which is read further once the link is known to belong to the robot."""

    name: str
    element: Any

    @property
    def sourceline(self) -> int:
        """Line of its element."""
        return int(self.element.sourceline)


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2] of a link, in its frame."""

    mass: float
    centre: Matrix
    inertia: Matrix


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: its type, what it connects, and its element, of which only what the robot uses is read further."""

    name: str
    element: Any
    written_type: str
    type: JointType
    parent: str
    child: str

    @property
    def sourceline(self) -> int:
        """Line of its element."""
        return int(self.element.sourceline)


@dataclass
class Urdf:
    """A URDF file: links and joints, and methods that read what a robot uses of them.

    What no robot is made of may be wrong: `read_connections` checks the names, types and connections of links and
        joints alone.

    Attributes:
        file: Its name, for messages.
        folder: The folder that it is in.
        name: The robot's name.
        sourceline: Line of the element that has it.
        links, joints: By name, in the file's order.
        notes: What was assumed, each with its line.
        errors: What is wrong with what was read so far.
        sizes: What rules of a file that refers to it know of the robot's parts: it is in space.
    """

    sizes: ClassVar[Mapping[str, int]] = {"base": len(ERROR_AXES[3])}

    file: str
    folder: Path
    name: str
    sourceline: int
    links: dict[str, UrdfLink] = field(default_factory=dict)
    joints: dict[str, UrdfJoint] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    @property
    def carried(self) -> dict[str, UrdfJoint]:
        """The joint that carries each link but the root, by link."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def root(self) -> str:
        """The link that no joint carries."""
        return next(name for name in self.links if name not in self.carried)

    @property
    def leaves(self) -> list[str]:
        """The links that carry no other."""
        carriers = {joint.parent for joint in self.joints.values()}
        return [name for name in self.links if name not in carriers]

    def chain(self, tip: str) -> list[UrdfJoint]:
        """Return the joints from the root to a link."""
        carried = self.carried
        joints = list[UrdfJoint]()
        while tip in carried:
            joints.insert(0, carried[tip])
            tip = carried[tip].parent
        return joints

    def where(self, part: "UrdfLink | UrdfJoint") -> str:
        """Return file, line, kind and name of a link or joint, for messages."""
        kind = "link" if isinstance(part, UrdfLink) else "joint"
        return f"{self.file}:{part.sourceline}: {kind} {quoted(part.name)}"

    def ensure_no_errors(self) -> None:
        """Make sure that nothing is wrong with what was read so far.

        Raises:
            SpecError: Something is; the message lists all of it, with lines.
        """
        errors = list(dict.fromkeys(self.errors))
        if more := errors[MOST_FAULTS:]:
            errors[MOST_FAULTS:] = [f"{self.file}: {len(more)} more problems"]
        if errors:
            raise SpecError("\n".join(errors))

    def read_connections(self, root: Any) -> None:
        """Read the names of links and joints, and which links the joints connect.

        What is inside links and joints is read later, by other methods, for those alone of which the robot is made.
        Elements that URDF does not have are noted, once for each name. Errors are added to `errors`.

        Args:
            root: The outermost element of the file.
        """
        if (links := len(root.findall("link"))) > MOST_LINKS:
            self.add_error(root, f"{links} links", f"at most {MOST_LINKS}")
            return
        unknown = set()
        for element in root.iterchildren("*"):
            if element.tag in ("link", "joint"):
                self._add_part(element)
            inside = [(part, element.tag) for part in element.iterchildren("*")] if element.tag in READ else []
            for part, within in (*inside, (element, "robot")):  # elements, each with the tag of the one around it
                if part.tag not in READ[within] and part.tag not in unknown:
                    unknown.add(part.tag)
                    self.add_note(part, f"<{part.tag}> is not an element of URDF's <{within}>: left out")
        if meshes := len(root.findall("link/visual//mesh")):
            not_read = counted(meshes, "visual mesh is", "visual meshes are")
            self.notes.append(f"{not_read} not read: bodies are drawn as capsules")
        self._check_that_joints_make_a_tree(root)

    def _add_part(self, element: Any) -> None:
        elements: dict[str, Any] = self.links if element.tag == "link" else self.joints
        name = element.get("name")
        if not name:
            self.add_error(element, f"<{element.tag}> without a name", "the attribute name")
        elif name in elements:
            second = f"a second {element.tag} {quoted(name)} (first at line {elements[name].sourceline})"
            self.add_error(element, second, "a name of its own")
        else:
            elements[name] = UrdfLink(name, element) if element.tag == "link" else self._read_joint(element, name)

    def _read_joint(self, element: Any, name: str) -> UrdfJoint:
        written = str(element.get("type"))
        of_joint = f"of joint {quoted(name)}"
        if written not in JOINT_TYPES:
            self.add_error(element, f"the type {quoted(written)} {of_joint}", choice(written, JOINT_TYPES))
        ends = dict[str, str]()
        for end in ("parent", "child"):
            one = self._only_child(element, end)
            ends[end] = "" if one is None else str(one.get("link", ""))
            if not ends[end]:
                self.add_error(element, f"no {end} {of_joint}", f"<{end} link=...>")
        return UrdfJoint(name, element, written, JOINT_TYPES.get(written, JointType()), ends["parent"], ends["child"])

    def _only_child(self, element: Any, tag: str) -> Any:
        """Return the element that another one has at most once, None if there is none."""
        elements = element.findall(tag)
        for second in elements[1:]:
            owner = _owner(element)
            whose = f"of {owner.tag} {quoted(owner.get('name'))} (first at line {elements[0].sourceline})"
            self.add_error(second, f"a second <{tag}> {whose}", "one at most")
        return elements[0] if elements else None

    def inertial(self, name: str) -> Inertial:
        """Read mass, centre of mass and inertia of a link, in the link's frame.

        A link without `<inertial>` has no mass, which is noted. A negative mass is an error. A principal moment that is
        not positive is only noted: the body that the link becomes part of may still have positive ones.

        Args:
            name: Name of the link.
        """
        element = self.links[name].element
        inertial = self._only_child(element, "inertial")
        if inertial is None:
            self.add_note(element, f"link {quoted(name)} has no <inertial>: it has no mass")
            return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
        place = self.origin(inertial)
        mass = self._parse_number(inertial, "mass/@value")
        xx, yy, zz = (self._parse_number(inertial, f"inertia/@{term}") for term in ("ixx", "iyy", "izz"))
        xy, xz, yz = (self._parse_number(inertial, f"inertia/@{term}", "0") for term in ("ixy", "ixz", "iyz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if mass < 0:
            self.add_error(inertial, f"a mass of {mass:g} kg of link {quoted(name)}", "a mass of at least 0")
        if mass > 0 and (least := np.linalg.eigvalsh(inertia)[0]) <= 0:
            self.add_note(inertial, f"a principal moment of link {quoted(name)} is {least:.3g} kg m^2")
        R = place[:3, :3]  # the file gives the inertia in a frame of its own, at the centre of mass
        return Inertial(mass, place[:3, 3], R @ inertia @ R.T)

    def collisions(self, name: str) -> list[Collision]:
        """Read the collision shapes of a link."""
        found = (self._read_collision(each, name) for each in self.links[name].element.iterchildren("collision"))
        return [each for each in found if each is not None]

    def _read_collision(self, element: Any, name: str) -> Collision | None:
        """Read one collision shape of a link.

        Args:
            element: Its element `collision`.
            name: Name of the link, for messages.

        Returns:
            The shape; None if it is left out, because its kind is unknown or it is of no size, which is noted, or
            because something is wrong with it, which is an error.
        """
        shape = next(element.iterfind("geometry/*"), None)
        if shape is None or shape.tag not in SIZES:
            self.add_note(element, f"a collision shape of link {quoted(name)} is {_element_text(shape)}: left out")
            return None
        errors_before = len(self.errors)
        kind = shape.tag
        mesh = shape.get("filename") or ""
        if kind == "mesh" and not mesh:
            self.add_error(shape, f"a mesh of link {quoted(name)} without a file", "the attribute filename")
        size = list[float]()
        for key, (count, missing) in SIZES[kind].items():
            size += self._parse_numbers(shape, f"@{key}", count, missing)
        origin = self.origin(element)
        if len(self.errors) > errors_before:
            return None
        smallest = min(map(abs, size)) if kind == "mesh" else min(size)  # a scale may mirror
        if smallest < SMALLEST:
            self.add_note(element, f"a {kind} of link {quoted(name)} has a size of {smallest:g}: left out")
            return None
        return Collision(element.sourceline, origin, kind, tuple(size), mesh)

    def axis(self, joint: UrdfJoint) -> Matrix:
        """Read the unit vector of a joint's axis (3,)."""
        given = self._only_child(joint.element, "axis")
        of_joint = f"of joint {quoted(joint.name)}"
        if given is None:
            self.add_note(joint.element, f"joint {quoted(joint.name)} has no <axis>: taken as 1 0 0")
            return np.array([1.0, 0.0, 0.0])
        axis = np.array(self._parse_numbers(joint.element, "axis/@xyz", 3, "0 0 0"))
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            self.add_error(given, f"an axis of length 0 {of_joint}", "a direction")
        elif abs(length - 1) > 1e-6:
            self.add_note(given, f"the axis {of_joint} has length {length:.4g}: scaled to 1")
        return axis / length if length else axis

    def limits(self, joint: UrdfJoint, quantities: Sequence[str]) -> dict[str, Any]:
        """Read limits of a joint that moves.

        Args:
            joint: The joint.
            quantities: Which of `LIMITED` the robot takes from the URDF; others are not read, and cause no errors.

        Returns:
            By quantity: of the position [low, high], of velocity and force the largest magnitude; None where there is
            no limit.
        """
        readers: Mapping[str, Callable[[UrdfJoint, Any], Any]] = {
            "position": self._position_limits,
            "velocity": self._velocity_limit,
            "force": self._force_limit,
        }
        limit = self._only_child(joint.element, "limit") if quantities else None
        if quantities and limit is None and joint.type.is_bounded:
            self.add_note(joint.element, f"joint {quoted(joint.name)} has no <limit>: without limits")
        return {quantity: None if limit is None else readers[quantity](joint, limit) for quantity in quantities}

    def _position_limits(self, joint: UrdfJoint, limit: Any) -> list[float | str] | None:
        """Return low and high limit of a joint's position with their units, None where it has none.

        URDF files write joints without limits in several ways: as another type, without numbers, with two zeros, or
        with numbers that no joint reaches. All of them mean None, and are noted. Limits in the wrong order, or one
        alone that no joint reaches, are errors.

        Args:
            joint: The joint.
            limit: Its element `limit`, at which notes and errors point.
        """
        of_joint = f"of joint {quoted(joint.name)}"
        if not joint.type.is_bounded:
            ends = [f'{end}="{limit.get(end)}"' for end in ("lower", "upper") if limit.get(end) is not None]
            if ends:
                self.add_note(limit, f"{' and '.join(ends)} {of_joint}, which is {joint.written_type}: without limits")
            return None
        errors_before = len(self.errors)
        low, high = (
            self._parse_numbers(joint.element, f"limit/@{end}", 1, "0", largest=np.inf)[0] for end in ("lower", "upper")
        )
        if len(self.errors) > errors_before:
            return None
        if low == high == 0:
            self.add_note(limit, f"the limits {of_joint} are both 0 or not given: without limits")
            return None
        if -low > LARGEST and high > LARGEST:
            self.add_note(limit, f"the limits {low:g}, {high:g} {of_joint} are beyond {LARGEST:g}: without limits")
            return None
        if max(abs(low), abs(high)) > LARGEST:
            self.add_error(
                limit, f"the limits {low:g}, {high:g} {of_joint}", f"both within {LARGEST:g}, or both beyond it"
            )
        elif low >= high:
            wanted = 'the lower one first; a joint that does not move has type="fixed"'
            self.add_error(limit, f"the limits {low:g}, {high:g} {of_joint}", wanted)
        elif not joint.type.slides and max(-low, high) > DEGREES_FROM:
            self.add_note(limit, f"the limits {low:g}, {high:g} rad {of_joint} look like degrees")
        return [_with_unit(joint, low), _with_unit(joint, high)]

    def _velocity_limit(self, joint: UrdfJoint, limit: Any) -> float | None:
        """Return the largest rate of a joint [rad/s, m/s], None where it has none."""
        of_joint = f"of joint {quoted(joint.name)}"
        rate = self._parse_numbers(joint.element, "limit/@velocity", 1, "0", largest=np.inf)[0]
        if rate == 0:
            self.add_note(limit, f"the velocity {of_joint} is 0 or not given: without a limit")
        elif rate > LARGEST:
            self.add_note(limit, f"the velocity {rate:g} {of_joint} is beyond {LARGEST:g}: without a limit")
        elif not joint.type.slides and rate > DEGREES_FROM:
            self.add_note(limit, f"the velocity {rate:g} rad/s {of_joint} looks like degrees")
        return rate if 0 != rate <= LARGEST else None

    def _force_limit(self, joint: UrdfJoint, limit: Any) -> float | None:
        """Return the largest torque or force of a joint's drive [N m, N], None where nothing is said of it."""
        of_joint = f"of joint {quoted(joint.name)}"
        effort = self._parse_numbers(joint.element, "limit/@effort", 1, "0", largest=np.inf)[0]
        if effort == 0:
            self.add_note(limit, f"the effort {of_joint} is 0 or not given: without a limit")
        elif effort < 0:
            self.add_error(
                limit, f"the effort {effort:g} {of_joint}", "a positive one, or no effort: then without a limit"
            )
        elif effort > LARGEST:
            self.add_note(limit, f"the effort {effort:g} {of_joint} is beyond {LARGEST:g}: without a limit")
        return effort if 0 != effort <= LARGEST else None

    def note_ignored_mechanics(self, joints: Sequence[UrdfJoint]) -> None:
        """Note what the file says of joints that move and the robot does not take over.

        A joint that mimics another one moves by itself here; friction and soft limits are left out.

        Args:
            joints: The joints that move in the robot.
        """
        for joint in joints:
            if (mimic := joint.element.find("mimic")) is not None:
                self.add_note(mimic, f"joint {quoted(joint.name)} mimics another: taken as a joint of its own")
        with_friction = []
        for joint in joints:
            dynamics = joint.element.find("dynamics")
            if dynamics is not None and {dynamics.get("damping", "0"), dynamics.get("friction", "0")} - _ZEROS:
                with_friction.append(joint.name)
        if with_friction:
            whose = f"{counted(len(with_friction), 'joint', 'joints')} ({_list_names(with_friction)})"
            self.notes.append(f"<dynamics> of {whose} is not read: a task says friction, uncertainty.friction")
        if soft := [joint.name for joint in joints if joint.element.find("safety_controller") is not None]:
            whose = f"{counted(len(soft), 'joint', 'joints')} ({_list_names(soft)})"
            self.notes.append(f"<safety_controller> of {whose} is not read: its soft limits are left out")

    def origin(self, element: Any) -> Matrix:
        """Read the frame in the `<origin>` of an element (4, 4) [m]."""
        from scipy.spatial.transform import Rotation

        place = np.eye(4)
        rpy = self._parse_numbers(element, "origin/@rpy", 3, "0 0 0")
        if max(np.abs(rpy)) > DEGREES_FROM:
            angles = " ".join(f"{angle:g}" for angle in rpy)
            self.add_note(element.find("origin"), f'the angles rpy="{angles}" look like degrees: taken as rad')
        place[:3, 3] = self._parse_numbers(element, "origin/@xyz", 3, "0 0 0")
        place[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
        return place

    def _parse_number(self, element: Any, attribute: str, missing: str = "") -> float:
        return self._parse_numbers(element, attribute, 1, missing)[0]

    def _parse_numbers(
        self, element: Any, attribute: str, count: int, missing: str = "", largest: float = LARGEST
    ) -> list[float]:
        """Read the numbers of an attribute of an element, or of one inside it.

        Args:
            element: The element.
            attribute: XPath of the attribute, such as `@radius` or `origin/@xyz`.
            count: How many numbers it has to have.
            missing: Text that is taken where there is no such attribute; empty if that is an error.
            largest: Largest magnitude that a number may have.

        Returns:
            The numbers. After an error, which is added, they are 1, 0, ..., 0, so that reading goes on and finds
            others.
        """
        inside = attribute.rpartition("/")[0]
        if inside:
            self._only_child(element, inside)  # adds an error if there is a second one
        text: Any = next(iter(element.xpath(attribute)), missing)
        values = [float(part) if re.fullmatch(DECIMAL, part) else np.nan for part in text.split()]
        if len(values) != count or not np.all(np.abs(values) <= largest):
            key = attribute.replace("/@", " ").replace("@", f"{element.tag} ")
            found = f"{key} {quoted(text)}" if text else f"no {key}"
            whose = _owner(element)
            wanted = counted(count, "number", "numbers")
            if np.any(np.abs(values) > largest):
                wanted += f" of at most {largest:g} in magnitude"
            found += f" of {whose.tag} {quoted(whose.get('name'))}"
            self.add_error(text.getparent() if text else element, found, wanted)
            return [1.0] + [0.0] * (count - 1)
        return values

    def _check_that_joints_make_a_tree(self, root: Any) -> None:
        """Add errors where the joints do not make a tree of the links.

        Joints have to connect links that exist, no link may be carried by two joints, and there is one link, the root,
        that no joint carries and from which joints lead to all others.

        Args:
            root: The outermost element, at which errors of the whole robot point.
        """
        links = self.links
        carried = dict[str, UrdfJoint]()  # the joint that carries each link
        for joint in self.joints.values():
            for end in (end for end in (joint.parent, joint.child) if end and end not in links):
                self.add_error(
                    joint, f"the unknown link {quoted(end)} of joint {quoted(joint.name)}", choice(end, links)
                )
            if (first := carried.setdefault(joint.child, joint)) is not joint:
                both = f"{quoted(first.name)} and {quoted(joint.name)}"
                self.add_error(joint, f"link {quoted(joint.child)} carried by two joints, {both}", "one for each link")
        roots = [name for name in links if name not in carried]
        if self.errors:  # what follows would only repeat them
            return
        if len(roots) != 1:
            several = f"{len(roots)} links that no joint carries ({_list_names(roots)})"
            found = several if roots else "joints in a circle" if links else "a robot without links"
            self.add_error(root, found, "one link that no joint carries, the base")
            return
        reached = set(roots)
        while more := {name for name, joint in carried.items() if joint.parent in reached} - reached:
            reached |= more
        if circle := [name for name in links if name not in reached]:
            self.add_error(links[circle[0]], f"link {quoted(circle[0])} in a circle of joints", "a tree from the base")

    def add_note(self, element: Any, text: str) -> None:
        """Add a note on what was assumed of an element, or not read of it; notes are printed with the robot."""
        self.notes.append(f"line {element.sourceline}: {text}")

    def add_error(self, at: Any, found: str, wanted: str) -> None:
        """Add an error of an element, link or joint; `ensure_no_errors` raises all of them at once."""
        tail = wanted if wanted.startswith((" (", ", ")) else f", expected {wanted}"
        self.errors.append(f"{self.file}:{at.sourceline}: found {found}{tail}")


def is_xml(path: Path) -> bool:
    """Tell whether a file is XML, by its ending or its first characters, and so no file of ours.

    Raises:
        SpecError: It cannot be read.
    """
    if path.suffix.casefold() in XML_ENDINGS:
        return True
    start = read_bytes(path)[:200].removeprefix(codecs.BOM_UTF8)
    encoding = "utf-16" if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "latin-1"
    return re.match(r"\s*<[!?A-Za-z]", start.decode(encoding, errors="ignore")) is not None


def kind_of_xml(path: Path) -> str:
    """Return what kind of XML a file is, for messages.

    Raises:
        SpecError: It cannot be read, or is no XML.
    """
    return _kind_of_root(_xml_root(path))


def _kind_of_root(root: Any) -> str:
    """Return what kind of XML a file is by its outermost element."""
    is_srdf = (
        root.tag == "robot" and root.find("link") is None and any(root.find(each) is not None for each in SRDF_ELEMENTS)
    )
    return XML_KINDS.get("srdf" if is_srdf else str(root.tag), f"the element <{printable(shortened(str(root.tag)))}>")


def _xml_root(path: Path) -> Any:
    """Return the outermost element of an XML file, which is in the encoding that it declares.

    Raises:
        SpecError: It cannot be read, or is no XML.
    """
    name = shown(path)
    try:
        return etree.fromstring(read_bytes(path))
    except etree.XMLSyntaxError as error:
        line, column = error.position
        if "xacro" in error.msg:  # a prefix without a namespace
            raise _xacro(name, line) from None
        raise SpecError(f"{name}:{line}:{column}: found no XML ({error.msg}), expected a URDF file") from None


def read_urdf(path: Path) -> Urdf:
    """Read which links and joints a URDF file has and how they are connected.

    What is inside them is read when a robot is built from it, by `spatial_robot`.

    Raises:
        SpecError: It cannot be read or is no robot; the message lists everything that is wrong, with lines.
    """
    root = _xml_root(path)
    name = shown(path)
    own_elements = [child for child in root.iterchildren("*") if child.tag not in FOREIGN]
    described = [root, *(part for child in own_elements for part in child.iter("*"))]
    if (macro := next(filter(_is_xacro, described), None)) is not None:
        raise _xacro(name, macro.sourceline)
    if (found := _kind_of_root(root)) != URDF:
        raise SpecError(f"{name}:{root.sourceline}: found {found}, expected {URDF}")
    urdf = Urdf(name, path.parent, root.get("name") or path.stem, root.sourceline)
    urdf.read_connections(root)
    urdf.ensure_no_errors()
    return urdf


def _owner(element: Any) -> Any:
    """Return the link or joint that an element is in, or is."""
    return next(each for each in (element, *element.iterancestors()) if each.tag in ("link", "joint"))


def _is_xacro(element: Any) -> bool:
    """Tell whether an element is of xacro, or has an attribute or an expression of it."""
    names = [name for name in (element.tag, *element.attrib) if name.startswith("{")]
    text = " ".join((*element.attrib.values(), element.text or ""))
    macro = element.prefix == "xacro" or any("xacro" in name for name in names)
    return macro or "${" in text or "$(" in text


def _element_text(shape: Any) -> str:
    """Return what a collision shape is written as."""
    return "nothing" if shape is None else f"<{printable(shape.tag)}>"


def _xacro(name: str, line: int) -> SpecError:
    """Create the error of a file with macros."""
    found = f"{name}:{line}: found xacro macros, expected plain URDF"
    return SpecError(f"{found}: run xacro on it first, xacro FILE > FILE.urdf")


def _list_names(names: Sequence[str]) -> str:
    """List the first few names."""
    listed = ", ".join(printable(shortened(name)) for name in names[:MOST_LISTED])
    return f"{listed}, ..." if len(names) > MOST_LISTED else listed


def spatial_robot(urdf: Urdf, file: UrdfRobot) -> tuple[dict[str, Any], Sources]:
    """Build the keys of a spatial robot from a URDF: links that do not move against each other become one body.

    Joints of no arm are locked, at 0 or where the file says, and their links count. A joint that two arms share belongs
    to the first.

    Args:
        urdf: The URDF.
        file: What refers to it.

    Returns:
        The keys, and what they were built from.

    Raises:
        SpecError: An arm has no joint, or a moving body has no mass.
    """
    base = file.base or urdf.root
    chains = _joints_of_arms(urdf, file, base)
    moving = [joint for _, own in chains.values() for joint in own]
    bodies = {joint.name: f"{name}.{i}" for name, (_, own) in chains.items() for i, joint in enumerate(own, 1)}
    places = _locate_links(urdf, base, file.locked, bodies)
    for joint in (joint for joint in urdf.joints.values() if joint.child in places):
        note = f"line {joint.sourceline}: joint {quoted(joint.name)}"
        if not (joint.type.moves or joint.type.is_rigid):
            urdf.notes.append(f"{note} is {joint.written_type}: taken as fixed")
        if joint.type.moves and joint.name not in bodies:
            unit = " m" if joint.type.slides else " rad"
            urdf.notes.append(f"{note} belongs to no arm: locked at {file.locked.get(joint.name, 0.0):g}{unit}")
    urdf.note_ignored_mechanics(moving)
    parts = _BodyInertias(urdf, places)
    robot: dict[str, Any] = {"name": urdf.name, "space": "spatial", "base": parts.of_body("base", base)}
    arms = robot.setdefault("arms", {})
    limits = robot.setdefault("limits", {})
    sources: Sources = {("name",): f"{urdf.file}:{urdf.sourceline}: <robot>", ("base",): urdf.where(urdf.links[base])}
    if shapes := _shapes_of_bodies(urdf, places, file):
        robot["geometry"] = shapes
        sources["geometry",] = f"{urdf.file}:{urdf.sourceline}: <collision>"
    for name, (tip, own) in chains.items():
        links = []
        sources["arms", name] = sources["arms", name, "tool"] = urdf.where(urdf.links[tip])
        for i, joint in enumerate(own):
            sources["arms", name, "links", i] = urdf.where(urdf.links[joint.child])
            sources["arms", name, "links", i, "joint"] = urdf.where(joint)
            for quantity in LIMITED:
                sources["limits", name, quantity, i] = urdf.where(joint)
            kind = "prismatic" if joint.type.slides else "revolute"
            place = _frame_keys(places[joint.parent][1] @ urdf.origin(joint.element))
            carrying = {"kind": kind, "axis": _plain_numbers(urdf.axis(joint)), **place}
            links.append({"joint": carrying, **parts.of_body(bodies[joint.name], joint.child)})
        arms[name] = {"mount": places[own[0].parent][0], "links": links, "tool": _frame_keys(places[tip][1])}
        used = [quantity for quantity in LIMITED if limits_of_part(file.limits, name, quantity) is None]
        by_joint = [urdf.limits(joint, used) for joint in own]
        of_arm = {quantity: [each[quantity] for each in by_joint] for quantity in used}
        if found := {key: values for key, values in of_arm.items() if any(value is not None for value in values)}:
            limits[name] = found
    for body, link in parts.impossible.items():
        path: Location = ("base",)
        if body != "base":
            arm, _, number = body.rpartition(".")
            path = ("arms", arm, "links", int(number) - 1)
        sources[*path, "inertia"] = urdf.where(urdf.links[link])
    urdf.ensure_no_errors()
    return robot, sources


def _joints_of_arms(urdf: Urdf, file: UrdfRobot, base: str) -> dict[str, tuple[str, list[UrdfJoint]]]:
    """Find the joints of each arm: those that move on the way from the base to its tip.

    Arms are those that the robot's file names. If it names none there is one for each leaf of the tree that moves. A
    joint on the way to two tips belongs to the first arm, and a locked joint to none.

    Args:
        urdf: The URDF.
        file: The robot's file that refers to it.
        base: The link that is the robot's base, which need not be the root.

    Returns:
        By name of the arm, the link at its tip and its joints from the base outward.

    Raises:
        SpecError: An arm that is named has no joint.
    """
    above = {joint.child for joint in urdf.chain(base)}
    arms = dict[str, tuple[str, list[UrdfJoint]]]()
    taken = set(file.locked)
    tips = {name: arm.tip for name, arm in (file.arms or {}).items()}
    for name, tip in (tips or {leaf: leaf for leaf in urdf.leaves if leaf != base}).items():
        moving = [joint for joint in urdf.chain(tip) if joint.child not in above and joint.type.moves]
        if own := [joint for joint in moving if joint.name not in taken]:
            arms[name] = tip, own
            taken |= {joint.name for joint in own}
            if not is_arm_name(name):  # that of a leaf: those of a file are validated with it
                leaf = f"the leaf {quoted(name)}, whose name no arm may have"
                example = f"urdf: {Path(urdf.file).name}, arms: {{NAME: {{tip: {printable(name)}}}}}"
                urdf.add_error(urdf.links[name], leaf, f"a robot file that names the arms, such as {example}")
        elif tips:
            no_joint = f"found no joint of its own on the way to {quoted(tip)}, the tip of arm {quoted(name)}"
            raise SpecError(f"{urdf.file}: {no_joint}, expected a tip that moves against the base and other arms")
    return arms


def _locate_links(urdf: Urdf, base: str, locked: Mapping[str, float], bodies: Mapping[str, str]) -> Places:
    """Find the body that each link is part of, and where the link is in that body.

    A joint that moves begins a new body, whose frame is that of the joint's child. Links behind other joints are part
    of the body before. Links above the base belong to it as far as fixed joints connect them; others are left out.

    Args:
        urdf: The URDF.
        base: The link that is the robot's base.
        locked: Positions of locked joints by name [m, rad]; 0 for those without.
        bodies: Names of the bodies that joints begin, by name of the joint, for the joints that move.

    Returns:
        By link, the name of its body and the link's frame in that of the body (4, 4) [m].
    """
    places = {base: ("base", np.eye(4))}
    waiting = [base]
    while waiting:
        link = waiting.pop()
        body, frame = places[link]
        for joint in urdf.joints.values():
            if joint.parent == link and joint.child not in places:
                if joint.name in bodies:
                    places[joint.child] = bodies[joint.name], np.eye(4)
                else:
                    position = locked.get(joint.name, 0.0)
                    places[joint.child] = body, frame @ _locked_frame(urdf, joint, position)
                waiting.append(joint.child)
            elif joint.child == link and joint.parent not in places and joint.type.is_rigid:
                places[joint.parent] = (body, frame @ np.linalg.inv(urdf.origin(joint.element)))
                waiting.append(joint.parent)
    if left := [name for name in urdf.links if name not in places]:
        urdf.notes.append(f"links above the base are left out: {_list_names(left)}")
    return places


def _locked_frame(urdf: Urdf, joint: UrdfJoint, at: float) -> Matrix:
    """Return the child's frame in the parent's (4, 4), with the joint at a position."""
    from scipy.spatial.transform import Rotation

    origin = urdf.origin(joint.element)
    if not at:
        return origin
    move = np.eye(4)
    if joint.type.slides:
        move[:3, 3] = at * urdf.axis(joint)
    else:
        move[:3, :3] = Rotation.from_rotvec(at * urdf.axis(joint)).as_matrix()
    return np.asarray(origin @ move)


class _BodyInertias:
    """Mass, centre of mass and inertia of bodies, each of all links that are part of it.

    Attributes:
        impossible: By body whose inertia no rigid body has, the link that is to blame.
    """

    def __init__(self, urdf: Urdf, places: Places) -> None:
        self.impossible: dict[str, str] = {}
        self._urdf = urdf
        self._places = places

    def of_body(self, body: str, carrier: str) -> dict[str, Any]:
        """Add up the masses and inertias of the links of a body.

        A body that moves needs a mass and positive principal moments; otherwise an error is added to the URDF. A base
        may have no mass, as long as it is fixed. An inertia that no rigid body has, since a principal moment is larger
        than the sum of the others, is stored in `impossible`, and found when the robot is validated.

        Args:
            body: Name of the body: base, or arm.number.
            carrier: The link whose frame is that of the body.

        Returns:
            The keys of the body in a robot's file: mass, centre_of_mass and inertia.
        """
        urdf = self._urdf
        links = [(link, urdf.inertial(link), frame) for link, (of, frame) in self._places.items() if of == body]
        mass = sum(inertial.mass for _, inertial, _ in links)
        if mass <= 0:
            names = _list_names([link for link, *_ in links])
            if body == "base":
                urdf.notes.append(f"the base ({names}) has no mass: nothing depends on it while the base is fixed")
            else:
                urdf.add_error(urdf.links[carrier], f"no mass of {names}", "one: it moves on its own")
            return {"mass": 0.0, "centre_of_mass": [0.0] * 3, "inertia": [0.0] * 6}
        centres = [(frame @ np.append(inertial.centre, 1.0))[:3] for _, inertial, frame in links]
        weighted = (inertial.mass * at for (_, inertial, _), at in zip(links, centres, strict=True))
        centre = sum(weighted, np.zeros(3)) / mass
        inertia = np.zeros((3, 3))
        for (_, inertial, frame), at in zip(links, centres, strict=True):
            R = frame[:3, :3]
            d = at - centre  # parallel axis theorem
            inertia += R @ inertial.inertia @ R.T + inertial.mass * (d @ d * np.eye(3) - np.outer(d, d))
        if _margin_of_rigid_body(inertia) < 0:
            self.impossible[body] = min(links, key=lambda entry: _margin_of_rigid_body(entry[1].inertia))[0]
        principal = np.linalg.eigvalsh(inertia)
        if principal[0] <= 0:
            blamed = self.impossible.get(body, carrier)
            moments = ", ".join(f"{moment:.3g}" for moment in principal)
            whole = f" together with {_list_names([link for link, *_ in links if link != blamed])}" if links[1:] else ""
            found = f"principal moments {moments} kg m^2 of {quoted(blamed)}{whole}"
            urdf.add_error(urdf.links[blamed], found, "positive ones")
        terms = [inertia[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return {"mass": float(mass), "centre_of_mass": _plain_numbers(centre), "inertia": _plain_numbers(terms)}


def _margin_of_rigid_body(inertia: Matrix) -> float:
    """Return by how far an inertia is from being none of a rigid body; negative if it is none [kg m^2].

    Its least principal moment, and the sum of the smaller two less the largest, have to be positive.
    """
    least, middle, largest = np.linalg.eigvalsh(inertia)
    return float(min(least, least + middle - largest))


def _shapes_of_bodies(urdf: Urdf, places: Places, file: UrdfRobot) -> dict[str, list[dict[str, Any]]]:
    """Build the shapes of bodies, by which distances are computed, from the collision shapes of their links.

    Bodies whose shapes the robot's file gives are left out, and so are meshes that cannot be read. What is left out,
    and what capsules cover only by reaching beyond it, is noted.

    Args:
        urdf: The URDF.
        places: Body and frame of each link.
        file: The robot's file that refers to the URDF.

    Returns:
        The shapes of each body, as a robot's file has them.
    """
    shapes = dict[str, list[dict[str, Any]]]()
    covered = {name: urdf.collisions(name) for name, (body, _) in places.items() if body not in file.geometry}
    title = "covering the collision shapes of the URDF by capsules"
    work = Work("shapes", sum(map(len, covered.values())), title=title, small_parts=True)
    for name, collisions in covered.items():
        body, frame = places[name]
        link = urdf.links[name]
        remarks = []
        for collision in collisions:
            work.advance()
            try:
                covering, remark = _shapes_and_remark(collision, frame @ collision.origin, urdf.folder)
            except SpecError as error:
                urdf.notes.append(f"line {collision.sourceline}: {error}: left out of link {quoted(name)}")
                continue
            shapes.setdefault(body, []).extend(covering)
            remarks += [remark] if remark else []
        if remarks:
            counted_remarks = [f"{count} times " * (count > 1) + text for text, count in Counter(remarks).items()]
            urdf.notes.append(f"line {link.sourceline}: link {quoted(name)} is covered: {'; '.join(counted_remarks)}")
    return shapes


def _shapes_and_remark(collision: Collision, at: Matrix, folder: Path) -> tuple[list[dict[str, Any]], str]:
    """Return the shapes that stand for a collision shape of a URDF, which may be one that our files do not have.

    Spheres and boxes are kept, cylinders and the convex hulls of meshes are covered by capsules. A box is covered by
    capsules as well where distances are computed, so its cover is described.

    Args:
        collision: The collision shape.
        at: Its frame in that of the body (4, 4) [m].
        folder: The folder of the URDF, in which its meshes are looked for.

    Returns:
        The shapes as a robot's file has them, and how they cover the collision shape; empty for a sphere.

    Raises:
        SpecError: Its mesh cannot be read.
    """
    size = [float(value) for value in collision.size]
    if collision.kind == "sphere":
        return [{"shape": {"sphere": size[0]}, **_pose_key(at)}], ""
    if collision.kind == "box":
        cover = cover_box(size)
        return [{"shape": {"box": size}, **_pose_key(at)}], _describe_cover("a box", cover)
    if collision.kind == "cylinder":
        radius, length = size
        ends = np.array([[[0, 0, -length / 2], [0, 0, length / 2]]])
        cover = Cover(ends, radius, radius)  # where the axis leaves its end, and the capsule ends a radius beyond
        remark = _describe_cover("a cylinder", cover)
    else:
        path = _mesh_file(collision.mesh, folder)
        mesh = read_mesh(path)
        scaled = mesh.vertices * size
        largest = float(np.abs(scaled).max())
        width = float(np.sort(np.ptp(scaled, axis=0))[1])  # the second largest extent: a mesh may be flat, but no line
        most = LARGEST / 4  # capsules about it are then within what a number may be
        if largest > most or width < SMALLEST:
            found = (
                f"found a mesh {quoted(path.name)} that reaches to {largest:g} m and is {width:g} m wide by its scale"
            )
            raise SpecError(f"{found}, expected at most {most:g} m, and at least {SMALLEST:g} m")
        cover = cover_mesh(scaled)
        remark = _describe_cover(
            f"the convex hull of {'' if mesh.is_closed else 'the open mesh '}{quoted(path.name)}", cover
        )
    shapes = []
    for start, end in cover.moved(at).ends:
        length = float(np.linalg.norm(end - start))
        shape = {"capsule": [cover.radius, length]} if length > SMALLEST else {"sphere": cover.radius}
        middle = np.eye(4)
        middle[:3, 3] = (start + end) / 2
        middle[:3, :3] = _turned_along(end - start)
        shapes.append({"shape": shape, **_pose_key(middle)})
    return shapes, remark


def _describe_cover(what: str, cover: Cover) -> str:
    """Say how a shape is covered."""
    return f"{what} by {counted(len(cover.ends), 'capsule', 'capsules')}, up to {cover.excess:.2g} m beyond it"


def _pose_key(frame: Matrix) -> dict[str, Any]:
    """Return the pose of a shape at a frame (4, 4), as it is written."""
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(frame[:3, :3]).as_quat(scalar_first=True)
    return {"pose": _plain_numbers([*frame[:3, 3], *quaternion])}


def _turned_along(along: Matrix) -> Matrix:
    """Return a rotation matrix (3, 3) whose first column is along a vector."""
    if not np.linalg.norm(along):
        return np.eye(3)
    axes, triangle = np.linalg.qr(np.column_stack([along, np.eye(3)[:, np.argsort(np.abs(along))[:2]]]))
    axes[:, 0] *= np.sign(triangle[0, 0])
    return np.asarray(axes * [1, 1, np.linalg.det(axes)])


def _mesh_file(reference: str, folder: Path) -> Path:
    """Return the file of a mesh that a URDF refers to.

    Args:
        reference: A path, `file://` with a path, or `package://NAME/PATH`. There is no ROS to ask for the package, so
            it is a folder NAME that is beside the URDF or one of the folders around it, or one of these folders itself.
        folder: The folder of the URDF.

    Raises:
        SpecError: There is no such package.
    """
    if not reference.startswith("package://"):
        return folder / reference.removeprefix("file://")
    package, _, inside = reference.removeprefix("package://").partition("/")
    around = [folder.resolve(), *folder.resolve().parents]
    candidates = [parent / package / inside for parent in around]
    candidates += [parent / inside for parent in around if parent.name == package]
    file = next(filter(os.path.isfile, candidates), None)
    if file is None:
        wanted = f"expected a folder {quoted(package)} with it beside or above the URDF"
        raise SpecError(f"found no mesh {quoted(reference)}, {wanted}")
    return file


def _with_unit(joint: UrdfJoint, limit: float) -> float | str:
    """Return a limit as our own files have it: an angle beyond a turn with its unit."""
    return limit if joint.type.slides or abs(limit) <= 2 * np.pi else f"{limit!r} rad"


def _plain_numbers(values: Any) -> list[float]:
    """Return numbers as they are written to YAML; rounding errors of right angles are dropped."""
    return [0.0 if abs(value) < 1e-15 else float(value) for value in values]


def _frame_keys(frame: Matrix) -> dict[str, Any]:
    """Return the keys of a frame (4, 4)."""
    R = frame[:3, :3]
    cosine = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = np.arctan2(-R[2, 0], cosine)
    if cosine > 1e-9:
        rpy = np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])
    else:
        rpy = np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return {"position": _plain_numbers(frame[:3, 3]), "rpy": _plain_numbers(rpy)}
