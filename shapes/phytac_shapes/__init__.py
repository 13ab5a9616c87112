"""Surface families: pure geometry on numpy. A new shape is one file here, with a ``FAMILY``.

Names of this package are imported at their first use: its errors are those of all packages, and
commands that only print help need no numpy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phytac_shapes.cone import Cone
    from phytac_shapes.cuboid import Cuboid
    from phytac_shapes.cylinder import Cylinder
    from phytac_shapes.grip import Grip
    from phytac_shapes.hemisphere import Hemisphere
    from phytac_shapes.patch import Patch
    from phytac_shapes.plane import Plane
    from phytac_shapes.registry import REGISTRY, family
    from phytac_shapes.surface import Surface

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


def __getattr__(name: str) -> Any:
    """Return a public name of the registry."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("phytac_shapes.registry"), name)
