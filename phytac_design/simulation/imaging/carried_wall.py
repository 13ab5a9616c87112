"""The wall of a scene, carried along by its receptors."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import boundary_mm
from phytac_design.layout import Markers
from phytac_design.optics.render_scene import SHELL, RenderScene
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

NEAREST = 8
"""Markers (and points of the fixed edges) that a point of the wall follows."""


class WallMotion:
    """Motion of the inner face between markers, whose wall's motion is known.

    Each point follows its nearest markers as rigid bodies, weighted by modified Shepard weights
    (Franke and Nielson 1980); open edges are clamped.

    Parameters
    ----------
    scene : Scene
        At rest.
    """

    def __init__(
        self, design: Design, surface: Surface, markers: Markers, scene: RenderScene
    ) -> None:
        shell = scene.triangles[scene.part == SHELL]
        self.vertices = np.unique(shell)
        fixed = boundary_mm(surface, -design.wall.thickness_mm / 2.0)
        anchors = np.concatenate([markers.mid_mm, fixed])
        points = scene.vertices[self.vertices]
        count = min(NEAREST + 1, len(anchors))
        distance, index = cKDTree(anchors).query(points, k=count)
        reach = distance[:, -1:]
        near = np.maximum(distance[:, :-1], 1e-9)
        weight = np.maximum(reach - near, 0.0) ** 2 / (reach * near) ** 2
        weight[:, 0] += 1e-300
        self.weight = weight / weight.sum(axis=1, keepdims=True)
        self.index, self.fixed = index[:, :-1], len(fixed)
        self.arm = points[:, None] - anchors[self.index]

    def moved(self, scene: RenderScene, motion: FloatArray) -> RenderScene:
        """Scene with its wall moved; receptors stay.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation vector (rad) of the wall under each marker.
        """
        every = np.concatenate([motion, np.zeros((self.fixed, 6))])[self.index]
        change = every[..., :3] + np.cross(every[..., 3:], self.arm)
        vertices = scene.vertices.copy()
        vertices[self.vertices] += np.einsum("vk,vki->vi", self.weight, change)
        return replace(scene, vertices=vertices)
