"""A software renderer: triangles to an image by a depth buffer, smooth shading and a ground shadow. NumPy only.

World frame: z up, metres. Pictures are rendered at twice their size and averaged down, which smooths the edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from hybrid_dynamics.types import Array

OVERSAMPLING = 2
#: Candidate pixels per batch: bounds the memory of the rasteriser (about 200 MB).
BATCH = 2_000_000
#: Direction to the sun; the fill light comes from the other side.
SUN = np.array([-0.2, -0.45, 1.0]) / np.linalg.norm([-0.2, -0.45, 1.0])
FILL = np.array([0.8, -0.5, 0.35]) / np.linalg.norm([0.8, -0.5, 0.35])


@dataclass(frozen=True)
class Camera:
    """Looks from ``eye`` to ``target`` [m], ``field_of_view`` [deg] vertically."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float = 28.0


@dataclass(frozen=True)
class Surface:
    """F triangles: ``corners`` (F, 3, 3) [m], unit ``normals`` at the corners (F, 3, 3), ``colours`` (F, 3) in 0..1."""

    corners: Array
    normals: Array
    colours: Array


def look_at(points: Array, camera: Camera) -> Array:
    """``points`` (..., 3) [m] in the camera's frame: right, up, depth along the view [m]."""
    eye = np.asarray(camera.eye, float)
    forward = np.asarray(camera.target, float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return np.asarray((points - eye) @ np.stack([right, np.cross(right, forward), forward], axis=1))


def _screen(points: Array, camera: Camera, width: int, height: int) -> Array:
    """Pixel coordinates (x right, y down) and 1/depth of world ``points``; 1/depth is linear on the screen."""
    view = look_at(points, camera)
    focal = 0.5 * height / np.tan(np.deg2rad(camera.field_of_view) / 2)
    inverse = 1.0 / view[..., 2]
    x = 0.5 * width + focal * view[..., 0] * inverse
    y = 0.5 * height - focal * view[..., 1] * inverse
    return np.stack([x, y, inverse], axis=-1)


def _rasterise(screen: Array, width: int, height: int) -> tuple[NDArray[np.int64], Array]:
    """Nearest triangle of every pixel (-1: none) and its screen-space barycentric weights (height*width, 3)."""
    nearest = np.zeros(width * height)
    owner = np.full(width * height, -1, dtype=np.int64)
    weights = np.zeros((width * height, 3))
    xy = screen[..., :2]
    low = np.floor(xy.min(axis=1)).astype(int)
    high = np.ceil(xy.max(axis=1)).astype(int)
    limit = np.array([width - 1, height - 1])
    low, high = np.clip(low, 0, limit), np.clip(high, 0, limit)
    edge1, edge2 = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
    area = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]
    span = high - low + 1
    count = np.where((np.abs(area) > 1e-12) & (screen[..., 2] > 0).all(axis=1), span.prod(axis=1), 0)
    ends = np.cumsum(count)
    start = 0
    while start < len(count):
        before = ends[start] - count[start]
        stop = max(start + 1, int(np.searchsorted(ends, before + BATCH, side="right")))
        face = np.repeat(np.arange(start, stop), count[start:stop])
        if len(face):
            place = np.arange(len(face)) - (ends - count)[face] + before
            px = low[face, 0] + place % span[face, 0]
            py = low[face, 1] + place // span[face, 0]
            dx, dy = px + 0.5 - xy[face, 0, 0], py + 0.5 - xy[face, 0, 1]
            b = (dx * edge2[face, 1] - dy * edge2[face, 0]) / area[face]
            c = (dy * edge1[face, 0] - dx * edge1[face, 1]) / area[face]
            inside = (b >= 0) & (c >= 0) & (b + c <= 1)
            face, b, c = face[inside], b[inside], c[inside]
            pixel = py[inside] * width + px[inside]
            bary = np.stack([1 - b - c, b, c], axis=1)
            depth = (bary * screen[face, :, 2]).sum(axis=1)
            np.maximum.at(nearest, pixel, depth)
            won = depth == nearest[pixel]
            owner[pixel[won]], weights[pixel[won]] = face[won], bary[won]
        start = stop
    return owner, weights


def shadow(corners: Array) -> Array:
    """Where the sun throws points (..., 3) on the plane z = 0."""
    flat = corners - SUN * (np.maximum(corners[..., 2:], 0.0) / SUN[2])
    flat[..., 2] = 0.0
    return np.asarray(flat)


def render(surface: Surface, camera: Camera, width: int, height: int) -> NDArray[np.uint8]:
    """An RGB image (height, width, 3) of ``surface`` on a white ground with its shadow."""
    w, h = width * OVERSAMPLING, height * OVERSAMPLING
    sun = SUN
    image = _ground(surface, camera, w, h)
    screen = _screen(surface.corners, camera, w, h)
    owner, weights = _rasterise(screen, w, h)
    hit = owner >= 0
    face, bary = owner[hit], weights[hit]
    bary = bary * screen[face, :, 2]
    bary /= bary.sum(axis=1, keepdims=True)
    normal = np.einsum("pk,pkd->pd", bary, surface.normals[face])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    point = np.einsum("pk,pkd->pd", bary, surface.corners[face])
    view = np.asarray(camera.eye) - point
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    normal *= np.sign((normal * view).sum(axis=1, keepdims=True) + 1e-12)
    half = view + sun
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    diffuse = 0.60 * np.clip(normal @ sun, 0, 1) + 0.30 * np.clip(normal @ FILL, 0, 1)
    ambient = 0.34 + 0.10 * normal[:, 2]
    shine = 0.16 * np.clip((normal * half).sum(axis=1), 0, 1) ** 40
    rim = (1 - np.clip((normal * view).sum(axis=1), 0, 1)) ** 3
    shade = (ambient + diffuse) * (1 - 0.25 * rim)
    image[hit] = np.clip(surface.colours[face] * shade[:, None] + shine[:, None], 0, 1)
    small = image.reshape(height, OVERSAMPLING, width, OVERSAMPLING, 3).mean(axis=(1, 3))
    return np.asarray(np.round(255 * small).astype(np.uint8))


def _ground(surface: Surface, camera: Camera, w: int, h: int) -> Array:
    """White, with the soft shadow that the surface casts on the plane z = 0."""
    owner, _ = _rasterise(_screen(shadow(surface.corners), camera, w, h), w, h)
    dark = gaussian_filter((owner >= 0).astype(float).reshape(h, w), 4.0 * OVERSAMPLING)
    return np.repeat(1.0 - 0.20 * dark.reshape(-1, 1), 3, axis=1)
