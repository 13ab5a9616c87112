"""The surface families by name."""

from difflib import get_close_matches
from importlib import import_module
from pkgutil import iter_modules

import phytac_shapes
from phytac_shapes.cone import Cone
from phytac_shapes.cuboid import Cuboid
from phytac_shapes.cylinder import Cylinder
from phytac_shapes.errors import DesignError
from phytac_shapes.grip import Grip
from phytac_shapes.hemisphere import Hemisphere
from phytac_shapes.patch import Patch
from phytac_shapes.plane import Plane
from phytac_shapes.surface import Surface

SHIPPED = (Cylinder, Cone, Plane, Cuboid, Hemisphere, Grip, Patch)


def _registered() -> dict[str, type[Surface]]:
    """Shipped families, then those that further files of this folder register, by file name."""
    found: dict[str, type[Surface]] = {family.name: family for family in SHIPPED}
    for module in iter_modules(phytac_shapes.__path__):
        own = getattr(import_module(f"phytac_shapes.{module.name}"), "FAMILY", None)
        if own is None:
            continue
        if own.name in found:
            raise DesignError(
                "shape-name-duplicate",
                f"phytac_shapes/{module.name}.py registers the shape {own.name!r}, which there is "
                f"already ({found[own.name].__module__}); give it another name",
            )
        found[own.name] = own
    return found


REGISTRY: dict[str, type[Surface]] = _registered()
"""Every surface family by its name, the ``kind`` of a design file."""


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
            "shape-unknown",
            f"shape {name!r} is not registered{hint} (known: {', '.join(sorted(REGISTRY))})",
        )
    return REGISTRY[name]
