"""All printed pieces of the kit, by name, and their parts list."""

from dataclasses import dataclass
from typing import Any

from phytac_design.design.spec import Design
from phytac_design.fabrication.bill import bill_part
from phytac_design.fabrication.calibration_rig.grippers import jaw, palm
from phytac_design.fabrication.calibration_rig.jigs import collar, has_rims, hole_plates, is_tube
from phytac_design.fabrication.calibration_rig.regions import Regions
from phytac_design.fabrication.calibration_rig.tool_solids import (
    ball_indenter,
    cell_seat,
    fitted_indenter,
    flat_indenter,
)
from phytac_design.layout.sensor import Sensor
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A printed piece.

    Attributes
    ----------
    name : str
        Of its file, without ending.
    body : manifold3d.Manifold
        The solid, mm.
    note : str
        What it is for.
    markers : tuple of int
        Regions that it is for; () if it is for all.
    """

    name: str
    body: Any
    note: str
    count: int = 1
    markers: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CalibrationKit:
    """Pieces of a kit, and what was left out, with the reason."""

    pieces: tuple[Piece, ...]
    left_out: dict[str, str]

    @property
    def cells(self) -> int:
        """Load cells that the kit has seats for."""
        return 3 if any(piece.name == "gripper_three" for piece in self.pieces) else 1


def kit_bodies(
    sensor: Sensor, regions: Regions, *, bowl_mm: float, tolerance_mm: float
) -> CalibrationKit:
    """Make all pieces of a design's kit.

    Parameters
    ----------
    bowl_mm : float
        How far the switches' bowls stand out of the outer face.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    kit, training, tol = design.kit, design.training, tolerance_mm
    left: dict[str, str] = {}
    pieces = []
    three = jaw(sensor, regions, tol)
    for k, face in enumerate(regions.faces):
        own = tuple(map(int, regions.marker[regions.face == k]))
        body = fitted_indenter(surface, markers.uv[face.marker], face.radius_mm, kit, tol)
        note = f"fingertip, ø{2.0 * face.radius_mm:g} mm, cut from {markers.name(face.marker)}"
        pieces.append(
            Piece(
                name=f"indenter_{k + 1}",
                body=body,
                note=note,
                count=3 if k == 0 and three is not None else 1,
                markers=own,
            )
        )
    radius = training.patch_radius_max_mm
    pieces += [
        Piece(name="indenter_flat", body=flat_indenter(radius, kit, tol), note="flat face"),
        Piece(name="indenter_ball", body=ball_indenter(radius, kit, tol), note="round face"),
        Piece(name="cell_seat", body=cell_seat(kit, tol), note="between load cell and rig"),
    ]
    wide = palm(sensor, tol)
    if wide is None:
        left["gripper_palm"] = "every marker stands too near a rim or an edge"
    else:
        pieces.append(Piece(name="gripper_palm", body=wide, note="covers several receptors"))
    if three is None:
        left["gripper_three"] = (
            "no three regions whose load cells stand side by side have nearly the same normal"
        )
    else:
        body, pressed = three
        note = "three load cells with indenter_1"
        pieces.append(Piece(name="gripper_three", body=body, note=note, markers=pressed))
    if not is_tube(surface):
        try:
            plates = hole_plates(sensor, regions, bowl_mm, tol)
        except DesignError as error:
            plates, left["plates"] = [], str(error)
        for k, (body, chosen) in enumerate(plates, start=1):
            served = tuple(map(int, regions.marker[chosen]))
            note = f"jig: {len(chosen)} holes over regions"
            pieces.append(Piece(name=f"plate_{k}", body=body, note=note, markers=served))
    elif has_rims(design):
        body = collar(sensor, tol)
        pieces.append(Piece(name="collar", body=body, note="jig: a notch for each column"))
    else:
        left["collar"] = "the wall has no rims for it to hold"
    return CalibrationKit(pieces=tuple(pieces), left_out=left)


def kit_parts(design: Design, kit: CalibrationKit) -> list[dict[str, Any]]:
    """Parts list of the kit, for the bill of materials."""
    made = [
        bill_part(
            f"kit: {piece.name}",
            file=f"kit/{piece.name}.stl",
            count=piece.count,
            volume_mm3=float(piece.body.volume()),
            note=piece.note,
        )
        for piece in kit.pieces
    ]
    screws = 2 * design.kit.cell_bolts * kit.cells
    size = f"for {design.kit.cell_bolt_hole_mm:g} mm holes"
    return [
        *made,
        bill_part("kit: load cell", count=kit.cells, material="electronics", note="0 to 50 N"),
        bill_part("kit: screws", count=screws, material="steel", note=size),
    ]
