"""CadQuery, imported here only and at first use."""

from typing import Any

from phytac_shapes.errors import MissingPartError


def cadquery() -> Any:
    """Import CadQuery, whose viewer links OpenGL and X11 even where nothing is drawn.

    Raises
    ------
    MissingPartError
        If it, or a library that it links, is not installed.
    """
    try:
        import cadquery
    except ImportError as error:
        raise MissingPartError(
            "missing-library",
            f"no CAD: cadquery cannot be imported ({error}); on Debian/Ubuntu: "
            "sudo apt-get install libgl1 libxrender1",
        ) from error
    return cadquery
