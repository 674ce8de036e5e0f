# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes from a few shapes: bodies of revolution, boxes and struts."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.palette import Colour

F32 = NDArray[np.float32]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Mesh:
    """V vertices with normals and colours, T triangles.

    `position` and `normal` are `(V, 3)` float32, `colour` `(V, 3)` uint8, `triangle` `(T, 3)`
    uint32, counter-clockwise seen from outside.
    """

    position: F32
    normal: F32
    colour: NDArray[np.uint8]
    triangle: NDArray[np.uint32]


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh that combines all of them."""
    offsets = np.cumsum([0, *(len(m.position) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.position for m in meshes]),
        np.concatenate([m.normal for m in meshes]),
        np.concatenate([m.colour for m in meshes]),
        np.concatenate([
            m.triangle + np.uint32(offset)
            for m, offset in zip(meshes, offsets, strict=True)]),
    )


def transform(mesh: Mesh, scale: float = 1.0, yaw: float = 0.0,
              offset: Point = (0.0, 0.0, 0.0)) -> Mesh:
    """Return a mesh scaled, then turned about z by `yaw` (rad), then moved by `offset`."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array(((cos, -sin, 0), (sin, cos, 0), (0, 0, 1)), np.float32)
    return Mesh(
        (mesh.position @ (scale * turn.T) + np.array(offset)).astype(np.float32),
        mesh.normal @ turn.T, mesh.colour, mesh.triangle)


def revolve(
    profile: Sequence[tuple[float, float, Colour]], sides: int = 16,
) -> Mesh:
    """Return the solid of revolution of a profile around z.

    :param profile: (radius, z, colour) from one end to the other, upwards for outward normals;
        two points at the same height make a flat ring, a repeated point a sharp edge.
    """
    radius = np.array([p[0] for p in profile])
    height = np.array([p[1] for p in profile])
    colour = np.array([p[2] for p in profile], np.uint8)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    around = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    positions, normals, colours, triangles = [], [], [], []
    base = 0
    for k in range(len(profile) - 1):
        run, rise = radius[k + 1] - radius[k], height[k + 1] - height[k]
        length = float(np.hypot(run, rise))
        if length == 0.0:
            continue
        slope = np.array((rise, -run)) / length
        for end in (k, k + 1):
            positions.append(np.column_stack(
                (around * radius[end], np.full(sides, height[end]))))
            normals.append(np.column_stack((around * slope[0], np.full(sides, slope[1]))))
            colours.append(np.repeat(colour[end][None], sides, axis=0))
        here = np.arange(sides)
        there = (here + 1) % sides
        lower, upper = base, base + sides
        triangles.append(np.column_stack((lower + here, lower + there, upper + there)))
        triangles.append(np.column_stack((lower + here, upper + there, upper + here)))
        base += 2 * sides
    return Mesh(
        np.concatenate(positions).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.concatenate(colours), np.concatenate(triangles).astype(np.uint32))


def hull(corners: F32, colour: Colour) -> Mesh:
    """Return the six-sided body with the corners `(8, 3)`.

    Corners 0 to 3 go around one face and 4 to 7 around the opposite one, in the same sense.
    """
    faces = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    centre = corners.mean(axis=0)
    positions, normals, triangles = [], [], []
    for number, face in enumerate(faces):
        quad = corners[list(face)]
        normal = np.cross(quad[2] - quad[0], quad[3] - quad[1])
        if np.dot(normal, quad.mean(axis=0) - centre) < 0:
            quad, normal = quad[::-1], -normal
        normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
        positions.append(quad)
        normals.append(np.repeat(normal[None], 4, axis=0))
        triangles.append(np.array(((0, 1, 2), (0, 2, 3))) + 4 * number)
    return Mesh(
        np.concatenate(positions).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.repeat(np.array([colour], np.uint8), 24, axis=0),
        np.concatenate(triangles).astype(np.uint32))


def box(centre: Point, size: Point, colour: Colour) -> Mesh:
    """Return a box; `size` is its length along x, y and z."""
    half = np.array(size) / 2
    signs = np.array((
        (-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1),
        (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)))
    return hull((np.array(centre) + signs * half).astype(np.float32), colour)


def strut(start: Point, end: Point, width: tuple[float, float], colour: Colour) -> Mesh:
    """Return a bar of square section from `start` to `end`, with its width at each end."""
    a, b = np.array(start), np.array(end)
    along = (b - a) / np.linalg.norm(b - a)
    helper = np.array((0.0, 0.0, 1.0)) if abs(along[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    side = np.cross(along, helper)
    side /= np.linalg.norm(side)
    other = np.cross(along, side)
    corners = [
        point + (s * side + o * other) * (w / 2)
        for point, w in ((a, width[0]), (b, width[1]))
        for s, o in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return hull(np.array(corners, np.float32), colour)


def ring(inner: float, outer: float, height: float, colours: tuple[Colour, Colour],
         sides: int = 40) -> Mesh:
    """Return a flat ring, a disc when `inner` is 0; colours are those inside and outside."""
    mesh = revolve(((outer, height, colours[1]), (inner, height, colours[0])), sides)
    return Mesh(
        mesh.position, np.tile(np.array((0, 0, 1), np.float32), (len(mesh.position), 1)),
        mesh.colour, mesh.triangle)
