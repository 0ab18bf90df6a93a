"""A picture of a robot in a pose, from the meshes of its URDF, without a display."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray
from PIL import Image

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.robots.urdf import movable_joints, read_urdf
from hybrid_dynamics.study.report.render import Camera, Surface, look_at, render, shadow
from hybrid_dynamics.types import Array

GREY = (0.86, 0.87, 0.88)


def render_arm(
    urdf: str | os.PathLike[str],
    pose: Mapping[str, float],
    path: str | os.PathLike[str],
    size: tuple[int, int] = (620, 680),
) -> bytes:
    """Draw the robot of ``urdf`` with its joints at ``pose`` (name -> rad; others at zero) to the PNG ``path``.

    ``size`` bounds width and height [pixels]; white margins are cut. Returns the PNG's bytes. Raises
    :class:`InputError` for an unknown joint, a mesh that is missing, or no mesh.
    """
    surface = posed_surface(urdf, pose)
    in_view = np.concatenate([surface.corners.reshape(-1, 3), shadow(surface.corners).reshape(-1, 3)])
    image = _cropped(render(surface, camera_for(in_view, size), *size))
    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary)
    return Path(path).read_bytes()


def _cropped(image: NDArray[np.uint8], margin: int = 8) -> NDArray[np.uint8]:
    rows, columns = (np.flatnonzero((image < 250).any(axis=(axis, 2))) for axis in (1, 0))
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return np.ascontiguousarray(image[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1])


def camera_for(
    points: Array, size: tuple[int, int], direction: tuple[float, float, float] = (1.0, -1.15, 0.5)
) -> Camera:
    """A camera that looks from ``direction`` and has all ``points`` (N, 3) in view with a margin."""
    low, high = points.min(axis=0), points.max(axis=0)
    target = (low + high) / 2
    along = np.asarray(direction) / np.linalg.norm(direction)
    camera = Camera(tuple(target + along), tuple(target))
    view = look_at(points, camera)
    tangent = np.tan(np.deg2rad(camera.field_of_view) / 2)
    wide = np.abs(view[:, 0]) / (tangent * size[0] / size[1])
    high_enough = np.abs(view[:, 1]) / tangent
    distance = 1.07 * float(np.max(np.maximum(wide, high_enough) - (view[:, 2] - 1.0)))
    return Camera(tuple(target + along * distance), tuple(target))


def posed_surface(urdf: str | os.PathLike[str], pose: Mapping[str, float]) -> Surface:
    """All visual meshes of ``urdf`` as one :class:`Surface` in the base frame [m]."""
    root = read_urdf(urdf)
    placements = _link_placements(Path(urdf), pose, movable_joints(root))
    corners, normals, colours = [], [], []
    for link, visual in _visuals(root):
        mesh_element = visual.find("geometry/mesh")
        if mesh_element is None:
            continue
        file = _mesh_path(mesh_element.get("filename", ""), Path(urdf))
        scale = _vector(mesh_element.get("scale"), (1.0, 1.0, 1.0))
        placement = placements[link] @ _origin(visual.find("origin"))
        for mesh, colour in _meshes(file):
            vertices = trimesh.transform_points(np.asarray(mesh.vertices) * scale, placement)
            turned = np.asarray(mesh.vertex_normals) @ placement[:3, :3].T
            corners.append(vertices[mesh.faces])
            normals.append(turned[mesh.faces])
            colours.append(np.tile(colour, (len(mesh.faces), 1)))
    if not corners:
        raise InputError(f"{urdf}: holds no visual mesh to draw; give a URDF with <visual><geometry><mesh> elements")
    return Surface(np.concatenate(corners), np.concatenate(normals), np.concatenate(colours))


def _visuals(root: ET.Element) -> Iterator[tuple[str, ET.Element]]:
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            yield link.get("name", ""), visual


def _link_placements(urdf: Path, pose: Mapping[str, float], joints: list[str]) -> dict[str, Array]:
    model = pin.buildModelFromUrdf(str(urdf))
    q = pin.neutral(model)
    for name, angle in pose.items():
        if name not in joints:
            raise InputError(f"{urdf}: no movable joint {name!r} to pose; its joints are {', '.join(joints)}")
        joint = model.joints[model.getJointId(name)]
        values = [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
        q[joint.idx_q : joint.idx_q + joint.nq] = values
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    bodies = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    return {model.frames[i].name: data.oMf[i].homogeneous for i in bodies}


def _mesh_path(name: str, urdf: Path) -> Path:
    """``package://`` names are looked for in the folders above the URDF."""
    plain = name.removeprefix("file://")
    if not name.startswith("package://"):
        candidates = [Path(plain), urdf.parent / plain]
    else:
        relative = name.removeprefix("package://")
        without_package = relative.partition("/")[2]
        candidates = [folder / part for folder in urdf.resolve().parents for part in (relative, without_package)]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise InputError(f"{urdf}: mesh {name} not found in the folders above the URDF; draw from the packaged description")


def _meshes(file: Path) -> Iterator[tuple[trimesh.Trimesh, Array]]:
    """The meshes of one file in its frame, each with its colour (0..1)."""
    scene = trimesh.load_scene(file)
    for mesh in scene.dump():
        if isinstance(mesh, trimesh.Trimesh):
            yield mesh, _colour(mesh)


def _colour(mesh: trimesh.Trimesh) -> Array:
    material = getattr(mesh.visual, "material", None)
    value = getattr(material, "main_color", None)
    colour = np.asarray(GREY) if value is None else np.asarray(value, float)[:3] / 255
    return np.clip(colour, 0.06, 0.93)


def _origin(element: ET.Element | None) -> Array:
    out = np.eye(4)
    if element is not None:
        out[:3, 3] = _vector(element.get("xyz"), (0.0, 0.0, 0.0))
        out[:3, :3] = pin.rpy.rpyToMatrix(_vector(element.get("rpy"), (0.0, 0.0, 0.0)))
    return out


def _vector(text: str | None, default: tuple[float, float, float]) -> Array:
    return np.array([float(value) for value in text.split()]) if text else np.array(default)
