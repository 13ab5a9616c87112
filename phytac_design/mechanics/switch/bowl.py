"""The soft bowl of a switch: its dimensions, the space and rules it must keep, its mesh.

The bowl stands on the outer face of the shell like a dome over the hole; its rim is glued there.
Its walls are concentric spheres. A flat pad on top takes the contact, a stem below reaches through
the receptor to the red tip. The section is meshed with the stem cut short: its free part carries
no load.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.switch.bowl_mesh import AxiMesh, block, join
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_design.mechanics.switch.model import AxiModel
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Bowl:
    """Dimensions of a bowl, its pad and its stem, mm.

    Attributes
    ----------
    diameter_mm : float
        Outer diameter on the shell's outer face.
    depth_mm : float
        Inner height, from the shell's face to the underside on the axis.
    thickness_mm : float
        Wall.
    stem_diameter_mm : float
        Diameter of the stem.
    pad_diameter_mm : float
        Diameter of the flat pad: the footprint that takes the contact.
    pad_height_mm : float
        How far the pad stands above the bowl's apex.
    fillet_mm : float
        Radius where pad and stem meet the bowl: sharp corners would tear, and crease the model.
    """

    diameter_mm: float
    depth_mm: float
    thickness_mm: float
    stem_diameter_mm: float = 1.2
    pad_diameter_mm: float = 1.2
    pad_height_mm: float = 0.02
    fillet_mm: float = 0.2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0.0):
                raise DesignError(
                    "bowl-size-not-positive",
                    f"the bowl's {name} must be a positive number (got {value:g}); give it in mm",
                )
        if self.thickness_mm >= self.depth_mm:
            raise DesignError(
                "bowl-wall-too-thick",
                f"the bowl is no bowl: its wall of {self.thickness_mm:g} mm is not thinner than "
                f"its depth of {self.depth_mm:g} mm; lower the wall or raise the depth",
            )
        half = 0.5 * self.diameter_mm
        if self.depth_mm + self.thickness_mm > half:
            raise DesignError(
                "bowl-too-tall",
                f"the bowl is taller than half a sphere ({self.depth_mm + self.thickness_mm:.3g} "
                f"mm > {half:.3g} mm), so that no mold releases it; lower the depth or raise the "
                "diameter",
            )
        if 0.5 * self.pad_diameter_mm > 0.7 * half or self.stem_diameter_mm > self.pad_diameter_mm:
            raise DesignError(
                "bowl-pad-size",
                f"the pad must be wider than the stem and leave the bowl free (got pad "
                f"{self.pad_diameter_mm:g}, stem {self.stem_diameter_mm:g}, bowl "
                f"{self.diameter_mm:g} mm); take a pad of at most {1.4 * half:.3g} mm",
            )
        if 0.5 * self.stem_diameter_mm > 0.9 * self.inner_base_mm:
            raise DesignError(
                "bowl-stem-too-wide",
                f"the stem fills the bowl (stem {self.stem_diameter_mm:g} mm, bowl "
                f"{2.0 * self.inner_base_mm:.3g} mm inside); lower the stem or the wall",
            )

    @property
    def outer_radius_mm(self) -> float:
        """Radius of the outer sphere."""
        height, half = self.depth_mm + self.thickness_mm, 0.5 * self.diameter_mm
        return (half**2 + height**2) / (2.0 * height)

    @property
    def centre_mm(self) -> float:
        """Height of the spheres' centre over the shell's face; not positive."""
        return self.depth_mm + self.thickness_mm - self.outer_radius_mm

    @property
    def inner_base_mm(self) -> float:
        """Radius of the inner sphere in the shell's face."""
        inner = self.outer_radius_mm - self.thickness_mm
        return float(np.sqrt(max(inner**2 - self.centre_mm**2, 0.0)))

    def scaled(self, factor: float) -> "Bowl":
        """Return the bowl with all lengths multiplied."""
        return Bowl(**{name: factor * value for name, value in vars(self).items()})


@dataclass(frozen=True, kw_only=True)
class BowlModel:
    """A bowl ready to be pressed.

    Attributes
    ----------
    bowl : Bowl
        Its dimensions.
    model : AxiModel
        The solid, clamped on the shell's face, its pad held flat.
    pad : int
        The unknown that is the pad's motion along z.
    load : (n,) float
        One newton on the pad, inward.
    seat : (m,) int
        Nodes of the underside outside the hole, which come to rest on the shell.
    """

    bowl: Bowl
    model: AxiModel
    pad: int
    load: FloatArray
    seat: IntArray


def bowl_mesh(bowl: Bowl, refine: int = 1) -> AxiMesh:
    """Mesh of the half section: about 50 elements, each way ``refine`` times as many.

    Raises
    ------
    DesignError
        If pad, stem and fillets leave no bowl between them.
    """
    under, over, stem = walls(bowl, 32 * refine, 4 * refine)
    top = bowl.depth_mm + bowl.thickness_mm + bowl.pad_height_mm
    share = np.linspace(0.0, 1.0, 6 * refine + 1)[:, None]
    # The hub's lower side arches up to the axis: corners at the stem's fillet stay open.
    low = (1.0 - share) * [0.0, 0.7 * bowl.depth_mm + 0.3 * top] + share * under[0]
    high = (1.0 - share) * [0.0, top] + share * over[0]
    stub = block(
        np.stack([np.zeros(len(stem)), np.linspace(stem[0, 1], low[0, 1], len(stem))], axis=1),
        stem,
        3 * refine,
    )
    return join(
        [
            block(low, high, 3 * refine),
            block(under, over, 3 * refine),
            np.swapaxes(stub, 0, 1),
        ]
    )


def walls(bowl: Bowl, cells: int, stem_cells: int = 4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Underside from the stem's fillet to the rim, upper side from the pad to the rim, stem's side.

    The first two are (cells + 1, 2), the third, from its end up, (stem_cells + 1, 2).

    Raises
    ------
    DesignError
        If pad, stem and fillets leave no bowl between them.
    """
    centre, outer = bowl.centre_mm, bowl.outer_radius_mm
    inner, stem = outer - bowl.thickness_mm, 0.5 * bowl.stem_diameter_mm
    half, rho = 0.5 * bowl.diameter_mm, bowl.fillet_mm
    # The pad's flank falls at 45 degrees; the fillet touches it and the outer sphere from outside.
    edge = np.array([0.5 * bowl.pad_diameter_mm, bowl.depth_mm + bowl.thickness_mm])
    edge[1] += bowl.pad_height_mm
    total = edge.sum() - centre + np.sqrt(2.0) * rho
    root = 2.0 * (outer + rho) ** 2 - total**2
    foot = 0.5 * (total - np.sqrt(max(root, 0.0)))
    axis = np.array([foot, centre + total - foot])
    start = axis - rho * np.sqrt(0.5)
    end = np.array([0.0, centre]) + outer / (outer + rho) * (axis - [0.0, centre])
    below = (inner - rho) ** 2 - (stem + rho) ** 2
    if root <= 0.0 or start[0] < edge[0] or end[0] > 0.8 * half or below <= 0.0:
        raise DesignError(
            "bowl-without-membrane",
            f"pad and stem leave no bowl around them (pad {bowl.pad_diameter_mm:g} mm wide and "
            f"{bowl.pad_height_mm:g} high, stem {bowl.stem_diameter_mm:g}, fillets {rho:g}, bowl "
            f"{bowl.diameter_mm:g} mm); take a narrower pad or a wider bowl",
        )
    pocket = np.array([stem + rho, centre + np.sqrt(below)])
    touch = np.array([0.0, centre]) + inner / (inner - rho) * (pocket - [0.0, centre])
    middle = np.array([0.0, centre])
    over = [
        np.linspace(edge, start, 200),
        _arc(axis, rho, start, end),
        _arc(middle, outer, end, np.array([half, 0.0])),
    ]
    curl = _arc(pocket, rho, np.array([stem, pocket[1]]), touch)
    # The elements of bowl and stem meet where both keep open corners.
    split = int(0.6 * len(curl))
    under = [curl[split:], _arc(middle, inner, touch, np.array([bowl.inner_base_mm, 0.0]))]
    # Half a diameter of the stem is meshed: below, stresses have died out.
    below_ = np.array([[stem, pocket[1] - 0.5 * bowl.stem_diameter_mm]])
    closer = 2.5  # nodes on fillets and flank than on the bowl
    return (
        _spread(under, (closer, 1.0), cells),
        _spread(over, (closer, closer, 1.0), cells),
        _spread([np.concatenate([below_, curl[: split + 1]])], (1.0,), stem_cells),
    )


def _arc(centre: FloatArray, radius: float, start: FloatArray, end: FloatArray) -> FloatArray:
    """Points of the shorter arc between two points of a circle."""
    first, last = (np.arctan2(*(p - centre)[::-1]) for p in (start, end))
    angle = first + np.linspace(0.0, 1.0, 400) * ((last - first + np.pi) % (2.0 * np.pi) - np.pi)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _spread(pieces: list[FloatArray], closer: tuple[float, ...], cells: int) -> FloatArray:
    """Points (cells + 1, 2) along joined pieces, ``closer`` times denser on each; ends are kept."""
    steps = [
        factor * np.hypot(*np.diff(piece, axis=0, prepend=piece[:1]).T)
        for piece, factor in zip(pieces, closer, strict=True)
    ]
    line, way = np.concatenate(pieces), np.cumsum(np.concatenate(steps))
    step = np.linspace(0.0, way[-1], cells + 1)
    even = np.stack([np.interp(step, way, line[:, k]) for k in range(2)], axis=1)
    even[[0, -1]] = line[[0, -1]]
    return even


def bowl_model(
    bowl: Bowl, material: Material, *, hole_diameter_mm: float = 1.6, refine: int = 1
) -> BowlModel:
    """Model of a bowl glued to the shell and pressed on its pad by a flat, frictionless body."""
    mesh = bowl_mesh(bowl, refine)
    r, z = mesh.nodes_mm.T
    top = bowl.depth_mm + bowl.thickness_mm + bowl.pad_height_mm
    tied = mesh.where(z - top)
    held = np.zeros((len(r), 2), dtype=bool)
    rim = (np.abs(z) < 1e-9) & (r > 0.5 * (bowl.inner_base_mm + 0.5 * bowl.stem_diameter_mm))
    held[rim] = True
    model = AxiModel(mesh=mesh, material=material, held=held, tied=tied)
    pad = model.node_unknown(int(tied[0]), 1)
    load = np.zeros(model.count)
    load[pad] = -1.0
    under, _, _ = walls(bowl, 32 * refine)
    near = np.hypot(*(mesh.nodes_mm[:, None] - under[None]).transpose(2, 0, 1)).min(axis=1)
    seat = np.flatnonzero((near < 1e-6) & (r > 0.5 * hole_diameter_mm) & ~rim)
    return BowlModel(bowl=bowl, model=model, pad=pad, load=load, seat=seat)
