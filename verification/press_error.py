"""Presses on shipped designs: true errors of extrapolated motion, and what is claimed of them.

The truth is the same shell, with its receptors, on meshes of 16 and 8 elements per marker pitch,
extrapolated; with large displacements of 12 and 8. Presses go all over the surface, up to the rims.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.layout.arc import by_area
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.pressing.contact_patch import ContactPatch
from phytac_design.mechanics.pressing.press import linear_limit, press, probed_meshes, read_motion
from phytac_design.mechanics.shell.discretisation import ProbedShell, probed_sensor
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.mesh_pair import mesh_pair
from phytac_design.simulation.pressed_series import DiscResponse, ExtrapolatedResponse
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

DESIGNS = (
    *("cylinder60", "cylinder40", "cone", "hemisphere"),
    *("grip", "plane", "patch", "cuboid"),
)
PLACES = (
    *((0.5, 0.5), (0.1, 0.3), (0.8, 0.77), (0.97, 0.1)),
    *((0.3, 0.9), (0.04, 0.6), (0.65, 0.02), (0.4, 0.4)),
)
"""Shares of the area along and around."""
RADII = (1.0, 1.0, 1.0, 1.0, 0.43, 0.71, 1.29, 0.36)
"""Of the patches, over their mean in training."""
REFINE = 4
"""Elements per marker pitch of ``phytac press``."""


@dataclass(frozen=True, kw_only=True)
class PressErrors:
    """Errors (p,) of some presses, of the largest motion or, of tables, root mean square.

    Attributes
    ----------
    plain, extrapolated : (p,) float
        True error on the finest mesh that was solved, and of the extrapolated motion.
    claimed : (p,) float
        What is claimed of the latter.
    """

    plain: FloatArray
    extrapolated: FloatArray
    claimed: FloatArray


class PressedDesign:
    """A shipped design, its presses, and its shell on any mesh."""

    def __init__(self, name: str) -> None:
        self.design = load_design(name)
        self.sensor = Sensor(self.design)
        self.receptors = not unknown_receptors(self.design)
        training = self.design.training
        mean = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        self.uv = by_area(self.sensor.surface, np.array(PLACES))
        self.radii_mm = mean * np.array(RADII)

    def shell(self, refine: int) -> tuple[ShellMesh, ShellModel]:
        """Mesh and model with so many elements per marker pitch."""
        markers, wall = self.sensor.markers, self.design.wall.thickness_mm
        mesh = marker_mesh(self.sensor.surface, markers, thickness_mm=wall, refine=refine)
        return mesh, sensor_model(self.design, markers, mesh, receptors=self.receptors)

    def probed(self, refine: int) -> ProbedShell:
        """The shell under all presses."""
        mesh, model = self.shell(refine)
        surface, markers = self.sensor.surface, self.sensor.markers
        return probed_sensor(model, mesh, surface, markers, self.uv, self.radii_mm)

    def linear(self) -> PressErrors:
        """Of linear presses, as ``phytac press`` extrapolates them."""

        def solve(refine: int) -> tuple[FloatArray, int]:
            part = self.probed(refine)
            return part.read(part.model.solve(part.loads).motion), len(part.model.quads)

        truth = _limit(solve, 16, 8)
        found = linear_limit(
            probed_meshes(
                self.sensor, self.uv, self.radii_mm, refine=REFINE, receptors=self.receptors
            )
        )
        if found is None:
            raise NumericalError("press-one-mesh", f"{self.design.name} has one mesh only")
        return PressErrors(
            plain=_largest(found.motion - truth) / _largest(truth),
            extrapolated=_largest(found.extrapolated - truth) / _largest(truth),
            claimed=found.relative,
        )

    def tables(self) -> PressErrors:
        """Of the linear part of the tables of ``auto``: the wall under the receptors."""
        surface, markers = self.sensor.surface, self.sensor.markers

        def solve(refine: int) -> tuple[FloatArray, int]:
            mesh, model = self.shell(refine)
            disc = DiscResponse(self.design, surface, markers, mesh=mesh, model=model, orders=1)
            return self._translations(disc), len(mesh.quads)

        truth = _limit(solve, 16, 8)
        meshes = mesh_pair(self.shell, (6, 4))
        if meshes is None:
            raise NumericalError("press-one-mesh", f"{self.design.name} has one mesh only")
        pair = ExtrapolatedResponse(self.design, surface, markers, meshes)
        done = self._translations(pair)
        size = np.linalg.norm(truth, axis=(0, 1))
        return PressErrors(
            plain=np.linalg.norm(solve(6)[0] - truth, axis=(0, 1)) / size,
            extrapolated=np.linalg.norm(done - truth, axis=(0, 1)) / size,
            claimed=np.array(pair.claimed),
        )

    def _translations(self, shell: DiscResponse | ExtrapolatedResponse) -> FloatArray:
        each = [
            shell.motions(uv[None], float(radius))[0][0][:, :3]
            for uv, radius in zip(self.uv, self.radii_mm, strict=True)
        ]
        return np.stack(each, axis=2)

    def large(self, place: int) -> PressErrors:
        """Of one press of the greatest force, with large displacements."""
        force = self.design.training.force_max_N

        def solve(refine: int) -> tuple[FloatArray, int]:
            part = self.probed(refine)
            motion = solve_large(part.model, force * part.loads[:, [place]])[0].state.motion
            return read_motion(part, motion, large=True)[:, :, None], len(part.model.quads)

        count = self.sensor.markers.count
        # Tips and the wall under them; not the centres of the other patches.
        truth, plain = _limit(solve, 12, 8)[: 2 * count], solve(2 * REFINE)[0][: 2 * count]
        radius = float(self.radii_mm[place])
        patch = ContactPatch(uv=self.uv[place], radius_mm=radius, force_N=force)
        found = press(self.sensor, patch, theory="large", refine=REFINE, receptors=self.receptors)
        moved = np.concatenate([found.tip_mm, found.wall_mm])
        return PressErrors(
            plain=_largest(plain - truth) / _largest(truth),
            extrapolated=_largest(moved[:, :, None] - truth) / _largest(truth),
            claimed=np.array([found.mesh_error or 0.0]),
        )


def _limit(solve: Callable[[int], tuple[FloatArray, int]], finer: int, coarser: int) -> FloatArray:
    """Extrapolate two results by their numbers of elements."""
    (fine, many), (coarse, few) = solve(finer), solve(coarser)
    return fine + (fine - coarse) / (many / few - 1.0)


def _largest(field: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(field, axis=1).max(axis=0))
