"""Where a design's markers stand on its chart, for regions given by rows, columns or shares."""

from pathlib import Path

import numpy as np

from phytac_decoder.estimation.force_regions import (
    MarkerChart,
    Region,
    load_regions,
    resolve_regions,
)
from phytac_decoder.io.bundle import Bundle
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.design.spec import Design
from phytac_design.layout.marker_layout import make_markers
from phytac_design.layout.markers import Markers
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError, InputError


def chart_of(surface: Surface, markers: Markers) -> MarkerChart:
    """Rows, columns and shares of the chart of markers."""
    low, high = surface.domain.T
    share = (markers.uv - low) / (high - low)
    closed = bool(surface.periodic[1])
    return MarkerChart(
        row=markers.row,
        column=markers.column,
        along=np.clip(share[:, 0], 0.0, 1.0),
        around=share[:, 1] % 1.0 if closed else np.clip(share[:, 1], 0.0, 1.0),
        closed=closed,
    )


def chart_of_design(design: Design) -> MarkerChart:
    """Rows, columns and shares of the chart of a design's markers."""
    surface = design.surface()
    return chart_of(surface, make_markers(design, surface))


def design_regions(design: Design) -> tuple[Region, ...]:
    """Regions that a design names, on its markers.

    Raises
    ------
    DesignError
        If one holds no marker, or is no region of this surface.
    """
    if not design.regions:
        return ()
    # Heights do not matter here, and line-of-sight heights are slow to find.
    plain = design.layout.model_copy(update={"heights": "linear"})
    surface = design.surface()
    markers = make_markers(design.model_copy(update={"layout": plain}), surface)
    tables = [region.table() for region in design.regions]
    position_mm = surface.point(markers.uv)
    try:
        return resolve_regions(tables, "", position_mm, chart_of(surface, markers))
    except InputError as error:
        raise DesignError(error.code, str(error)) from None


def bundle_regions(
    path: Path | None, bundle: Bundle, folder: Path, design: str | None = None
) -> tuple[Region, ...]:
    """Regions of a file, on a bundle's markers; none without a file.

    Parameters
    ----------
    path : Path, optional
        TOML or JSON, see :func:`phytac_decoder.estimation.force_regions.load_regions`.
    bundle : Bundle
        The sensor's decoder.
    folder : Path
        Where it lies; a build writes the design beside it.
    design : str, optional
        The design's name or file, where it is not there.

    Raises
    ------
    InputError
        If the design is another one than the bundle's, or see :func:`load_regions`.
    """
    if path is None:
        return ()
    beside = folder.resolve().parent / "design.toml"
    where = design or (str(beside) if beside.is_file() else None)
    if where is None:
        return load_regions(path, bundle.position_mm)
    loaded = load_design(where)
    if design_hash(loaded) != bundle.design_hash:
        if design is None:
            return load_regions(path, bundle.position_mm)
        raise InputError(
            "decoder-of-other-design",
            f"the decoder in {folder} was made for {bundle.design!r} as it was built, and {design} "
            "is another design; give the design.toml of its build",
        )
    return load_regions(path, bundle.position_mm, chart_of_design(loaded))
