"""The frozen contacts: drawn once from a seed, kept as a file.

``python -m benchmarks.referee.contacts`` writes the files that are missing.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.arc import by_area
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

DATA = Path(__file__).parent / "data"
SEED = 60
KINDS = ("receptor", "between", "rim", "multi")
COUNTS = {"cylinder60": (20, 12, 8, 16), "grip": (8, 6, 4, 6)}
"""Contacts of each kind."""
RADII_MM = (4.0, 7.0)
BINS_N = ((0.5, 5.0), (5.0, 12.0), (12.0, 25.0))
"""Forces are uniform in one of these, each in turn."""
FIXED_N = (25.0, 10.0, 5.0, 0.5)
"""The first contacts on receptors have these."""
JITTER_MM = 1.0
"""A contact on a receptor is off its axis by at most this, along and around."""
RIM_MM = (2.0, 10.0)
"""Distance of the centre from the rim of contacts near it, along the wall."""
MOST = 4
TRIES = 1000
DECIMALS = 6
"""Positions, radii and forces are rounded to these, so that the file says all."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One load case: patches that press at once.

    Attributes
    ----------
    kind : str
        One of ``KINDS``.
    uv : tuple of (float, float)
        Centres, chart coordinates.
    radius_mm, force_N : tuple of float
        Radius and inward normal force of each.
    """

    kind: str
    uv: tuple[tuple[float, float], ...]
    radius_mm: tuple[float, ...]
    force_N: tuple[float, ...]

    @property
    def centres(self) -> FloatArray:
        """Centres, (m, 2)."""
        return np.array(self.uv)


def draw(name: str) -> list[Contact]:
    """Draw the contacts of a design, kinds mixed so that any first part has all of them."""
    design = load_design(name)
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(SEED)
    # Evenly over the list: the k-th of a kind that has m of them stands at (k + 1/2) / m.
    order = sorted(
        ((k + 0.5) / count, kind, k)
        for kind, count in zip(KINDS, COUNTS[name], strict=True)
        for k in range(count)
    )
    return [_draw(surface, markers, kind, k, rng) for _, kind, k in order]


def _draw(
    surface: Surface, markers: Markers, kind: str, number: int, rng: np.random.Generator
) -> Contact:
    wanted = int(rng.integers(2, MOST + 1)) if kind == "multi" else 1
    placed: list[tuple[FloatArray, FloatArray, float, float]] = []
    for _ in range(TRIES):
        if len(placed) == wanted:
            break
        on = kind if kind != "multi" else str(rng.choice(["receptor", "between"]))
        uv = _place(surface, markers, on, rng)
        point = surface.point(uv[None])[0]
        radius = float(rng.uniform(*RADII_MM))
        # Patches of one contact keep 4 mm between them.
        if all(np.linalg.norm(point - p) > radius + r + 4.0 for _, p, r, _ in placed):
            low, high = BINS_N[(number + len(placed)) % len(BINS_N)]
            placed.append((uv, point, radius, float(rng.uniform(low, high))))
    force = [f for _, _, _, f in placed]
    if kind == "receptor" and number < len(FIXED_N):
        force = [FIXED_N[number]]
    return Contact(
        kind=kind,
        uv=tuple(
            (round(float(uv[0]), DECIMALS), round(float(uv[1]), DECIMALS)) for uv, *_ in placed
        ),
        radius_mm=tuple(round(r, DECIMALS) for _, _, r, _ in placed),
        force_N=tuple(round(f, DECIMALS) for f in force),
    )


def _place(surface: Surface, markers: Markers, kind: str, rng: np.random.Generator) -> FloatArray:
    """Chart position (2,) of a patch's centre; distances along the wall by its meridian."""
    (u0, u1), (v0, v1) = surface.domain
    for _ in range(TRIES):
        if kind == "receptor":
            marker = int(rng.integers(markers.count))
            along, around = surface.tangents(markers.uv[[marker]])[0]
            step = rng.uniform(-JITTER_MM, JITTER_MM, size=2)
            aside = step[0] * along / np.linalg.norm(along)
            aside = aside + step[1] * around / np.linalg.norm(around)
            uv = np.asarray(surface.chart(surface.point(markers.uv[[marker]]) + aside)[0])
        else:
            uv = np.asarray(by_area(surface, rng.random((1, 2)))[0])
        if kind == "rim":
            stretch = float(np.sqrt(surface.metric(uv[None])[0, 0, 0]))
            gap = float(rng.uniform(*RIM_MM)) / stretch
            return np.array([u0 + gap if rng.random() < 0.5 else u1 - gap, uv[1]])
        stretch = float(np.sqrt(surface.metric(uv[None])[0, 0, 0]))
        # Contacts that are not at a rim keep 12 mm from it.
        if min(uv[0] - u0, u1 - uv[0]) * stretch > 12.0 and v0 <= uv[1] <= v1:
            return uv
    raise DesignError(
        "referee-contact-no-room",
        f"no place for a contact {kind!r} on the {surface.name}; see TRIES",
    )


def contacts_file(name: str) -> Path:
    """File of a design's contacts."""
    return DATA / f"{name}.contacts.json"


def load_contacts(name: str) -> list[Contact]:
    """Frozen contacts of a design.

    Raises
    ------
    DesignError
        If there is no file for it.
    """
    path = contacts_file(name)
    if not path.is_file():
        raise DesignError(
            "referee-contacts-missing",
            f"no frozen contacts for {name!r}; run python -m benchmarks.referee.contacts",
        )
    return [
        Contact(
            kind=row["kind"],
            uv=tuple((float(u), float(v)) for u, v in row["uv"]),
            radius_mm=tuple(map(float, row["radius_mm"])),
            force_N=tuple(map(float, row["force_N"])),
        )
        for row in json.loads(path.read_text(encoding="utf-8"))
    ]


def write_contacts(path: Path, contacts: Sequence[Contact]) -> None:
    """Write contacts, one a line."""
    lines = ",\n".join(json.dumps(asdict(contact)) for contact in contacts)
    path.write_text(f"[\n{lines}\n]\n", encoding="utf-8", newline="\n")


def main() -> None:
    """Write missing files; existing ones stay as they are."""
    DATA.mkdir(exist_ok=True)
    for name in COUNTS:
        if not contacts_file(name).exists():
            write_contacts(contacts_file(name), draw(name))


if __name__ == "__main__":
    main()
