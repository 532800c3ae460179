"""One chain of a URDF file, read and checked: what `Arm.from_urdf` takes.

The file is read as it stands (XML of the URDF specification, wiki.ros.org/urdf/XML): fixed joints are merged into the
placements of those that turn. Meshes are only looked for, on disk: a file whose meshes are missing describes another
robot than its author's, and collision checks on it would pass everything.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import matrix_from_rpy, transform

Array = NDArray[np.float64]

_TURNING = ("revolute", "continuous")


class UrdfChain(NamedTuple):
    """The joints that turn between two links; arrays as `Arm` takes them."""

    placements: Array  # (n, 4, 4)
    axes: Array  # (n, 3)
    limits: Array  # (n, 2) [rad]; ± π for continuous joints
    T_tool: Array  # (4, 4)
    names: tuple[str, ...]


def read_chain(path: str | PathLike[str], base: str | None = None, tip: str | None = None) -> UrdfChain:
    """The chain from `base` (the root by default) to `tip` (by default the only link without children).

    Raises:
        FileNotFoundError: no such file, or a mesh that the file names is missing.
        ValueError: not a URDF; unknown links; a joint that is neither revolute, continuous nor fixed, or that mimics
            another; a branching robot without `tip`; a link that moves without mass or inertia; no joint that turns.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"path: no such file: {file}")
    try:
        robot = ElementTree.fromstring(file.read_bytes())
    except ElementTree.ParseError as error:
        raise ValueError(f"{file.name}: not XML: {error}") from None
    if robot.tag != "robot":
        raise ValueError(f"{file.name}: expected a URDF's <robot>, got <{robot.tag}>")
    links = {_text(link, "name", file): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    above: dict[str, Element] = {}  # child link → the joint that carries it
    for joint in joints:
        _, child = (_linked(joint, tag, links, file) for tag in ("parent", "child"))
        if child in above:
            raise ValueError(f"{file.name}: link {child!r} has two parents; chains only, no closed loops")
        above[child] = joint
    _check_meshes(robot, file)
    route = _route(links, above, base, tip, file)
    return _chain(route, links, joints, file)


def _route(
    links: dict[str, Element], above: dict[str, Element], base: str | None, tip: str | None, file: Path
) -> list[Element]:
    """The joints from base to tip."""
    for argument, name in (("base", base), ("tip", tip)):
        if name is not None and name not in links:
            raise ValueError(f"{argument}: {file.name} has no link {name!r}; there are: {', '.join(links)}")
    roots = [name for name in links if name not in above]
    if base is None:
        if len(roots) != 1:
            raise ValueError(f"{file.name}: expected one root link, got {roots}; name the base")
        base = roots[0]
    if tip is None:
        parents = {_link_of(joint, "parent") for joint in above.values()}
        leaves = [name for name in links if name not in parents and base in _ancestors(name, above)]
        if len(leaves) != 1:
            raise ValueError(f"{file.name}: branches from {base!r} to {leaves}; name the tip")
        tip = leaves[0]
    lineage = _ancestors(tip, above)
    if base not in lineage:
        raise ValueError(f"tip: {tip!r} is not carried by {base!r}; it is carried by {lineage[1:] or 'nothing'}")
    return [above[name] for name in lineage[: lineage.index(base)][::-1]]


def _ancestors(name: str, above: dict[str, Element]) -> list[str]:
    """The link and what carries it, up to its root (or to where a loop closes)."""
    lineage = [name]
    while lineage[-1] in above:
        parent = _link_of(above[lineage[-1]], "parent")
        if parent in lineage:
            break
        lineage.append(parent)
    return lineage


def _chain(route: list[Element], links: dict[str, Element], joints: list[Element], file: Path) -> UrdfChain:
    placements, axes, limits, names = [], [], [], []
    T = np.eye(4)
    for joint in route:
        name, kind = _text(joint, "name", file), joint.get("type")
        where = f"{file.name}: joint {name!r}"
        T = T @ _origin(joint, where)
        if kind == "fixed":
            continue
        if kind not in _TURNING:
            raise ValueError(f"{where}: expected a type of {', '.join(_TURNING)} or fixed, got {kind!r}")
        if joint.find("mimic") is not None:
            raise ValueError(f"{where}: it mimics another; expected joints that turn by themselves")
        axis = _numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise ValueError(f"{where}: expected an axis of positive length, got {axis.tolist()}")
        _check_inertia(_link_of(joint, "child"), links, joints, file)
        placements.append(T)
        axes.append(axis / length)
        limits.append(_limits(joint, kind, where))
        names.append(name)
        T = np.eye(4)
    if not placements:
        raise ValueError(f"{file.name}: expected a joint that turns between base and tip, got none")
    return UrdfChain(np.array(placements), np.array(axes), np.array(limits), T, tuple(names))


def _limits(joint: Element, kind: str, where: str) -> tuple[float, float]:
    if kind == "continuous":
        return -math.pi, math.pi
    limit = joint.find("limit")
    if limit is None or limit.get("lower") is None or limit.get("upper") is None:
        raise ValueError(f"{where}: a revolute joint needs <limit lower= upper=>")
    lower, upper = (float(_numbers(limit, name, None, where)[0]) for name in ("lower", "upper"))
    if lower >= upper:
        raise ValueError(f"{where}: expected lower < upper, got {lower:g} and {upper:g}")
    return lower, upper


def _check_inertia(name: str, links: dict[str, Element], joints: list[Element], file: Path) -> None:
    """What a joint moves, the link with all that is fixed to it, must have mass and be hard to turn about any axis."""
    lump, solid = [name], False
    for member in lump:
        fixed = (j for j in joints if j.get("type") == "fixed" and _link_of(j, "parent") == member)
        lump += [child for child in (_link_of(j, "child") for j in fixed) if child not in lump]
        inertial = links[member].find("inertial")
        if inertial is None:
            continue
        where = f"{file.name}: link {member!r}"
        mass = float(_numbers(inertial.find("mass"), "value", (0.0,), where)[0])
        element = inertial.find("inertia")
        xx, xy, xz, yy, yz, zz = (
            float(_numbers(element, key, (0.0,), where)[0]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if mass < 0.0 or moments[0] < 0.0:
            raise ValueError(f"{where}: expected no negative mass or moment of inertia, got {mass:g} kg, {moments}")
        solid |= mass > 0.0 and moments[0] > 0.0
    if not solid:
        raise ValueError(f"{file.name}: link {name!r} moves, but has zero mass or inertia")


def _check_meshes(robot: Element, file: Path) -> None:
    missing = sorted(
        {m.get("filename", "") for m in robot.iter("mesh") if _find_mesh(m.get("filename", ""), file) is None}
    )
    if missing:
        shown = ", ".join(repr(name) for name in missing[:3])
        raise FileNotFoundError(f"{file.name}: {len(missing)} meshes are missing: {shown}{' …' if missing[3:] else ''}")


def _find_mesh(name: str, file: Path) -> Path | None:
    """Where a mesh is: beside the file, or for package://NAME/… in a folder NAME beside or above it."""
    return next((place for place in _places(name, file.resolve().parent) if place.is_file()), None)


def _places(name: str, folder: Path) -> Iterator[Path]:
    scheme, mark, rest = name.partition("://")
    if not mark:
        yield folder / name
    elif scheme == "file":
        yield Path(rest)
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        for parent in (folder, *folder.parents):
            yield parent / rest
            if parent.name == package:
                yield parent / inside


def _origin(joint: Element, where: str) -> Array:
    origin = joint.find("origin")
    zero = (0.0, 0.0, 0.0)
    return transform(matrix_from_rpy(_numbers(origin, "rpy", zero, where)), _numbers(origin, "xyz", zero, where))


def _numbers(element: Element | None, name: str, default: tuple[float, ...] | None, where: str) -> Array:
    """An attribute's numbers; as many as the default has, if there is one."""
    text = None if element is None else element.get(name)
    if text is None:
        assert default is not None
        return np.array(default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        hint = "; expand xacro first" if "${" in text else ""
        raise ValueError(f"{where}: expected numbers in {name}, got {text!r}{hint}") from None
    if len(values) != (1 if default is None else len(default)) or not np.isfinite(values).all():
        raise ValueError(
            f"{where}: expected {1 if default is None else len(default)} finite numbers in {name}, got {text!r}"
        )
    return values


def _text(element: Element, name: str, file: Path) -> str:
    value = element.get(name)
    if not value:
        raise ValueError(f"{file.name}: a <{element.tag}> has no {name}")
    return value


def _link_of(joint: Element, tag: str) -> str:
    """Name of a joint's parent or child link."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _linked(joint: Element, tag: str, links: dict[str, Element], file: Path) -> str:
    name = _link_of(joint, tag)
    if name not in links:
        raise ValueError(f"{file.name}: joint {joint.get('name')!r} has an unknown {tag} link {name!r}")
    return name
