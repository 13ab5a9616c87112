"""Builds read back from their folders, and the figures that a comparison shows of each."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from phytac_design.core import html as page
from phytac_design.report import verdict
from phytac_shapes.bounded_reader import read_bytes, toml_table
from phytac_shapes.errors import InputError

PICTURES = (("camera.jpg", "The camera's view at rest"), ("pressed_close_5.jpg", "Pressed"))
"""Images of each build that are shown side by side."""


@dataclass(frozen=True, kw_only=True)
class Build:
    """Contents of one build folder.

    Attributes
    ----------
    label : str
        Name of its design, with the folder's if names repeat.
    report : dict
        ``report/report.json``.
    design : dict
        ``design.toml``, by dotted name.
    viewer : dict
        ``report/viewer.json``.
    images : dict
        Bytes of the available pictures, by file name.
    """

    label: str
    folder: Path
    report: Mapping[str, Any]
    design: Mapping[str, Any]
    viewer: Mapping[str, Any]
    images: Mapping[str, bytes]


@dataclass(frozen=True)
class ComparedFigure:
    """One row of the comparison; ``better`` says which value is marked.

    ``path`` is that in ``report.json``; ``*`` stands for the report's main estimator, ``?`` marks a
    key that may be missing.
    """

    key: str
    label: str
    path: str
    better: Literal["more", "less", ""] = ""
    factor: float = 1.0

    def of(self, report: Mapping[str, Any]) -> Any:
        """Value in a report."""
        value: Any = report
        for part in self.path.split("/"):
            if part.endswith("?"):
                value = value.get(part[:-1])
                if value is None:
                    return None
                continue
            value = value[verdict.best_of(report) if part == "*" else part]
        return value if self.factor == 1.0 or page.missing(value) else self.factor * float(value)


FIGURES = (
    ComparedFigure("markers", "markers", "markers/count", "more"),
    ComparedFigure("density_per_cm2", "density (per cm²)", "markers/density_per_cm2", "more"),
    ComparedFigure("surface", "surface to the optical axis", "markers/surface_class"),
    ComparedFigure("hidden", "hidden markers", "visibility/occluded", "less"),
    ComparedFigure("fused", "fused markers", "visibility/fused", "less"),
    ComparedFigure(
        "visible_fraction", "smallest visible fraction", "visibility/min_visible_fraction", "more"
    ),
    ComparedFigure(
        "gap_px", "smallest gap to the same colour (px)", "visibility/min_gap_px", "more"
    ),
    ComparedFigure(
        "load_gap_px", "the same under load (px)", "under_load/least_gap_same_colour_px", "more"
    ),
    ComparedFigure(
        "first_force_N", "a marker hides or fuses from (N; none: never)", "under_load/first_force_N"
    ),
    ComparedFigure("crosstalk_px", "largest crosstalk (px)", "under_load/crosstalk_px", "less"),
    ComparedFigure(
        "bound_10N_median_N",
        "resolution of 10 N, median in the middle (N)",
        "resolution/bound/10 N/force_N_median_middle",
        "less",
    ),
    ComparedFigure(
        "bound_10N_worst_N", "the same, worst (N)", "resolution/bound/10 N/force_N_worst", "less"
    ),
    ComparedFigure(
        "error_percent",
        "relative error, held-out contacts, simulated (%)",
        "decoder/*/relative_error",
        "less",
        100.0,
    ),
    ComparedFigure("error_N", "absolute error, the same contacts (N)", "decoder/*/mae_N", "less"),
    ComparedFigure(
        "error_frames_percent",
        "relative error, rendered frames (%)",
        "decoder_frames/*/relative_error",
        "less",
        100.0,
    ),
    ComparedFigure("dent_mm", "deepest dent (mm)", "under_load/dent_mm"),
    ComparedFigure("parts_handled", "parts handled", "fabrication/effort?/parts_handled", "less"),
    ComparedFigure("stem_lengths", "stem lengths", "fabrication/effort?/stem_lengths", "less"),
    ComparedFigure(
        "hand_hours", "hand work, estimated (h)", "fabrication/effort?/hours_total", "less"
    ),
    ComparedFigure("resin_g", "resin, all printed parts (g)", "fabrication/mass_g/resin?", "less"),
    ComparedFigure("rubber_g", "rubber (g)", "fabrication/mass_g/tpu?", "less"),
    ComparedFigure(
        "print_violations", "places that break print rules", "fabrication/print_violations", "less"
    ),
    ComparedFigure("build_s", "time of all stages, when they ran (s)", "timing_s/total"),
    ComparedFigure("press_places", "places pressed", "under_load/presses"),
)


def read_builds(folders: Sequence[Path]) -> list[Build]:
    """Read build folders.

    Raises
    ------
    InputError
        If one is no whole build, or of another program version.
    """
    found = [_read(folder) for folder in folders]
    names = [build.label for build in found]
    return [
        build
        if names.count(build.label) == 1
        else replace(build, label=f"{build.label} ({build.folder.resolve().name})")
        for build in found
    ]


def _read(folder: Path) -> Build:
    try:
        report = _json(folder / "report" / "report.json")
        viewer = _json(folder / "report" / "viewer.json")
        design = toml_table(_bytes(folder / "design.toml").decode("utf-8"))
        _check(report, viewer)
        images = {
            name: _bytes(path)
            for name in ("shell.png", "layout.png", *(name for name, _ in PICTURES))
            if (path := folder / "report" / "images" / name).is_file()
        }
    except OSError as error:
        raise InputError(
            "build-incomplete",
            f"{folder} is no whole build ({error.filename}: {error.strerror}); make it with "
            "`phytac build DESIGN`, without --only and --scene",
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise InputError(
            "build-report-invalid",
            f"{folder} cannot be compared: its report is damaged or of another version "
            f"({type(error).__name__}: {str(error)[:80]}); build it again",
        ) from None
    return Build(
        label=str(report["design"]),
        folder=folder,
        report=report,
        design=page.flatten(design),
        viewer=viewer,
        images=images,
    )


def _bytes(path: Path) -> bytes:
    """Bytes of a regular file; errors name it."""
    try:
        return read_bytes(path, bytes_max=1 << 26)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _json(path: Path) -> Any:
    """JSON without NaN and infinities, which no page could hold."""

    def refuse(name: str) -> Any:
        raise ValueError(f"{path.name} holds {name}")

    return json.loads(_bytes(path), parse_constant=refuse)


def _check(report: Mapping[str, Any], viewer: Mapping[str, Any]) -> None:
    """Read everything that the comparison uses, so that invalid builds raise here."""
    for figure in FIGURES:
        value = figure.of(report)
        if not isinstance(value, int | float | str | None):
            raise TypeError(f"{figure.key} is no number")
        if figure.better and isinstance(value, str):
            raise TypeError(f"{figure.key} is no number")
    verdict.findings(report)
    str(report["design"]), dict(report["accuracy"])
    for item in keyed(viewer).values():
        float(item["low"]), float(item["high"])


def keyed(viewer: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Colourings of a viewer's data by their key."""
    return {str(item["key"]): item for item in viewer["colourings"]}
