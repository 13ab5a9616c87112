"""Surface families: pure geometry on numpy. A new shape is one file here and one line below."""

from difflib import get_close_matches

from shapes.cone import Cone
from shapes.cuboid import Cuboid
from shapes.cylinder import Cylinder
from shapes.errors import DesignError
from shapes.grip import Grip
from shapes.hemisphere import Hemisphere
from shapes.patch import Patch
from shapes.plane import Plane
from shapes.surface import Surface

REGISTRY: dict[str, type[Surface]] = {
    family.name: family for family in (Cylinder, Cone, Plane, Cuboid, Hemisphere, Grip, Patch)
}


def family(name: str) -> type[Surface]:
    """Return the surface family registered as ``name``.

    Raises
    ------
    DesignError
        If no family has that name; the message lists the known ones and the nearest.
    """
    if name not in REGISTRY:
        near = get_close_matches(name, REGISTRY, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(
            f"shape {name!r} is not registered{hint} (known: {', '.join(sorted(REGISTRY))})"
        )
    return REGISTRY[name]


__all__ = [
    "REGISTRY",
    "Cone",
    "Cuboid",
    "Cylinder",
    "Grip",
    "Hemisphere",
    "Patch",
    "Plane",
    "Surface",
    "family",
]
