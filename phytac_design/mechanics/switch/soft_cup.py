"""The cup of a switch that does not snap: side wall, flat roof, hub; its mesh and its model.

Two families share this section. A *membrane* is a cup whose thin roof bends and stretches between a
hub and a stiff side wall; its boss stands above the rim. A *plunger* is a tall cup whose side wall
is compressed under a thick roof. The side wall is glued to the outer face of the shell. The stem
hangs from the middle of the roof and is not meshed: it carries no load.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from phytac_design.mechanics.switch.bowl_mesh import AxiMesh, block, join
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_design.mechanics.switch.model import AxiModel
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

CupFamily = Literal["membrane", "plunger"]


@dataclass(frozen=True, kw_only=True)
class SoftCup:
    """Dimensions of a cup, mm.

    Attributes
    ----------
    family : {"membrane", "plunger"}
        A membrane is pressed on its boss, a plunger on its whole roof.
    diameter_mm : float
        Outer diameter on the shell's outer face.
    height_mm : float
        Inner height, from the shell's face to the underside of the roof.
    side_mm : float
        Thickness of the side wall.
    roof_mm : float
        Thickness of the roof.
    hub_diameter_mm : float
        Diameter of hub and boss of a membrane. A plunger's stem is as wide above its stop.
    boss_mm : float
        How far the boss stands above the roof; 0 for a plunger.
    fillet_mm : float
        Radius of the inner corners.
    draft_deg : float
        Slope of the side wall, narrower towards the roof on both sides.
    """

    family: CupFamily
    diameter_mm: float
    height_mm: float
    side_mm: float
    roof_mm: float
    hub_diameter_mm: float
    boss_mm: float = 0.0
    fillet_mm: float = 0.15
    draft_deg: float = 0.5

    def __post_init__(self) -> None:
        may_be_zero = {"draft_deg"} | ({"boss_mm"} if self.family == "plunger" else set())
        for name, value in vars(self).items():
            if name == "family":
                continue
            if not np.isfinite(value) or value < 0.0 or (value == 0.0 and name not in may_be_zero):
                raise DesignError(
                    "cup-size-not-positive",
                    f"the {self.family}'s {name} must be a positive number (got {value:g}); "
                    "give it in mm",
                )
        if self.web_mm < 2.0 * self.fillet_mm or self.height_mm < 2.0 * self.fillet_mm:
            raise DesignError(
                "cup-without-web",
                f"nothing is left between hub and side wall of the {self.family} (web "
                f"{self.web_mm:.3g} mm, height {self.height_mm:g} mm, fillets "
                f"{self.fillet_mm:g} mm); take a narrower hub, a thinner side wall or a wider "
                "footprint",
            )

    @property
    def web_mm(self) -> float:
        """Width of the ring between hub and side wall, under the roof."""
        lean = self.height_mm * float(np.tan(np.radians(self.draft_deg)))
        return 0.5 * (self.diameter_mm - self.hub_diameter_mm) - self.side_mm - lean

    @property
    def top_mm(self) -> float:
        """Height of the pressed face over the shell's."""
        return self.height_mm + self.roof_mm + self.boss_mm

    def scaled(self, factor: float) -> "SoftCup":
        """Return the cup with all lengths multiplied."""
        fixed = {"family": self.family, "draft_deg": self.draft_deg}
        sizes = {name: factor * v for name, v in vars(self).items() if name not in fixed}
        return SoftCup(**sizes, **fixed)  # type: ignore[arg-type]  # keywords of two types


@dataclass(frozen=True, kw_only=True)
class CupModel:
    """A cup ready to be pressed.

    Attributes
    ----------
    cup : SoftCup
        Its dimensions.
    model : AxiModel
        The solid, clamped on the shell's face, its pressed face held flat.
    pad, tip : int
        The unknowns that are the motion of the pressed face and of the stem's root along z.
    load : (n,) float
        One newton on the pressed face, inward.
    inner, outer : (m,) int
        Nodes on the inside and on the outside of the side wall.
    """

    cup: SoftCup
    model: AxiModel
    pad: int
    tip: int
    load: FloatArray
    inner: IntArray
    outer: IntArray


def _arc(centre: FloatArray, radius: float, angles_deg: tuple[float, float]) -> FloatArray:
    angle = np.radians(np.linspace(*angles_deg, 60))
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _line(points: Sequence[FloatArray] | FloatArray, cells: int, closer: float = 0.0) -> FloatArray:
    """Nodes (2 cells + 1, 2) along a broken line, denser at both ends by ``closer`` (0 to 1)."""
    line = np.concatenate([np.atleast_2d(p) for p in points])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    even = np.linspace(0.0, 1.0, 2 * cells + 1)
    share = even - closer * np.sin(2.0 * np.pi * even) / (2.0 * np.pi)
    return np.stack([np.interp(share * way[-1], way, line[:, k]) for k in range(2)], axis=1)


def cup_mesh(cup: SoftCup, refine: int = 1) -> AxiMesh:
    """Mesh of the half section, each way ``refine`` times as many elements."""
    n, rho = refine, cup.fillet_mm
    high, top = cup.height_mm, cup.height_mm + cup.roof_mm
    lean = high * float(np.tan(np.radians(cup.draft_deg)))
    hub, outer = 0.5 * cup.hub_diameter_mm, 0.5 * cup.diameter_mm - lean
    inner, diagonal = outer - cup.side_mm, rho * np.sqrt(0.5)
    across, through = 3 * n, 3 * n
    # Under the roof, where it meets the side wall; the elements meet in the middle of its fillet.
    under = np.array([inner - rho, high - rho])
    turn = under + diagonal
    blocks = []
    if cup.boss_mm:
        over = np.array([hub + rho, top + rho])
        split = over - diagonal
        rise = top + cup.boss_mm
        flank = [_arc(over, rho, (225.0, 180.0)), np.array([hub, rise])]
        side = _line(flank, 4 * n)
        axis = _line(np.array([[0.0, split[1]], [0.0, rise]]), 4 * n)
        blocks.append(np.swapaxes(block(axis, side, across), 0, 1))
        upper = [_arc(over, rho, (225.0, 270.0)), np.array([turn[0], top])]
    else:
        split = np.array([hub, top])
        upper = [split, np.array([turn[0], top])]
    low = np.array([[0.0, high], [split[0], high]])
    blocks.append(
        block(_line(low, across), _line(np.array([[0.0, split[1]], split]), across), through)
    )
    lower = [np.array([split[0], high]), _arc(under, rho, (90.0, 45.0))]
    blocks.append(block(_line(lower, 8 * n, 0.5), _line(upper, 8 * n, 0.5), through))
    # The corner of roof and side wall, then the side wall down to the shell.
    corner, edge = np.array([outer, top]), np.array([outer, turn[1]])
    blocks.append(
        block(
            _line(np.array([turn, edge]), across),
            _line(np.array([[turn[0], top], corner]), across),
            through,
        )
    )
    inside = [np.array([inner, 0.0]), _arc(under, rho, (0.0, 45.0))]
    wall = block(
        _line(inside, 8 * n, 0.5), _line(np.array([[outer, 0.0], edge]), 8 * n, 0.5), across
    )
    blocks.append(np.swapaxes(wall, 0, 1))
    # Only the side wall leans; the rest keeps its radius.
    mesh = join(blocks)
    r, z = mesh.nodes_mm.T
    share = np.clip((r - hub) / (inner - hub), 0.0, 1.0) * np.clip(1.0 - z / high, 0.0, 1.0)
    return AxiMesh(nodes_mm=np.stack([r + lean * share, z], axis=1), quads=mesh.quads)


def cup_model(cup: SoftCup, material: Material, *, refine: int = 1) -> CupModel:
    """Model of a cup glued to the shell and pressed by a flat, frictionless body."""
    mesh = cup_mesh(cup, refine)
    r, z = mesh.nodes_mm.T
    held = np.zeros((len(r), 2), dtype=bool)
    held[mesh.where(z)] = True
    model = AxiModel(mesh=mesh, material=material, held=held, tied=mesh.where(z - cup.top_mm))
    pad = model.node_unknown(int(model.tied[0]), 1)
    load = np.zeros(model.count)
    load[pad] = -1.0
    lean = np.tan(np.radians(cup.draft_deg)) * np.minimum(z, cup.height_mm)
    free, side = z > 0.0, r - (0.5 * cup.diameter_mm - lean)
    return CupModel(
        cup=cup,
        model=model,
        pad=pad,
        tip=model.node_unknown(mesh.at(0.0, cup.height_mm), 1),
        load=load,
        inner=mesh.where(
            np.where(free & (z < cup.height_mm - cup.fillet_mm), side + cup.side_mm, 1.0)
        ),
        outer=mesh.where(np.where(free, side, 1.0)),
    )
