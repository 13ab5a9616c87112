"""Reading whole builds back: what a comparison asks of each, checked when it is read."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from phytac_design.report import page, verdict
from phytac_shapes.bounded_reader import read_bytes, toml_table
from phytac_shapes.errors import InputError

PICTURES = (("camera.jpg", "The camera's view at rest"), ("pressed_close_5.jpg", "Pressed"))
"""Images of each build that are shown side by side."""
STILLS = ("shell.png", "layout.png")
"""Images that stand for what scripts draw, where they cannot, and in print."""
LETTERS = 80
"""Of a message that are shown."""
FILE_BYTES_MAX = 1 << 26
"""Largest file of a build that is read."""


@dataclass(frozen=True, kw_only=True)
class Build:
    """What one build folder says.

    Attributes
    ----------
    label : str
        Name of its design; with the folder's where names repeat.
    report : dict
        ``report/report.json``.
    design : dict
        ``design.toml``, by dotted name.
    viewer : dict
        ``report/viewer.json``.
    images : dict
        Bytes of the pictures that there are, by file name.
    """

    label: str
    folder: Path
    report: Mapping[str, Any]
    design: Mapping[str, Any]
    viewer: Mapping[str, Any]
    images: Mapping[str, bytes]


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One row of the comparison; ``better`` says which value is marked."""

    key: str
    label: str
    of: Callable[[Mapping[str, Any]], Any]
    better: Literal["more", "less", ""] = ""


def _decoded(name: str, key: str, factor: float = 1.0) -> Callable[[Mapping[str, Any]], Any]:
    def value(report: Mapping[str, Any]) -> Any:
        found = report[name][verdict.best_of(report)][key]
        return None if page.missing(found) else factor * float(found)

    return value


FIGURES = (
    Figure(key="markers", label="markers", of=lambda r: r["markers"]["count"], better="more"),
    Figure(
        key="density_per_cm2",
        label="density (per cm²)",
        of=lambda r: r["markers"]["density_per_cm2"],
        better="more",
    ),
    Figure(
        key="surface",
        label="surface to the optical axis",
        of=lambda r: r["markers"]["surface_class"],
    ),
    Figure(
        key="hidden",
        label="hidden markers",
        of=lambda r: r["visibility"]["occluded"],
        better="less",
    ),
    Figure(
        key="fused", label="fused markers", of=lambda r: r["visibility"]["fused"], better="less"
    ),
    Figure(
        key="visible_fraction",
        label="least visible fraction",
        of=lambda r: r["visibility"]["min_visible_fraction"],
        better="more",
    ),
    Figure(
        key="gap_px",
        label="least gap to the same colour (px)",
        of=lambda r: r["visibility"]["min_gap_px"],
        better="more",
    ),
    Figure(
        key="load_gap_px",
        label="the same under load (px)",
        of=lambda r: r["under_load"]["least_gap_same_colour_px"],
        better="more",
    ),
    Figure(
        key="first_force_N",
        label="a marker hides or fuses from (N; none: never)",
        of=lambda r: r["under_load"]["first_force_N"],
    ),
    Figure(
        key="crosstalk_px",
        label="greatest crosstalk (px)",
        of=lambda r: r["under_load"]["crosstalk_px"],
        better="less",
    ),
    Figure(
        key="bound_10N_median_N",
        label="resolution of 10 N, median in the middle (N)",
        of=lambda r: r["resolution"]["bound"]["10 N"]["force_N_median_middle"],
        better="less",
    ),
    Figure(
        key="bound_10N_worst_N",
        label="the same, worst (N)",
        of=lambda r: r["resolution"]["bound"]["10 N"]["force_N_worst"],
        better="less",
    ),
    Figure(
        key="error_percent",
        label="force error, held-out contacts, simulated (%)",
        of=_decoded("decoder", "relative_error", 100.0),
        better="less",
    ),
    Figure(
        key="error_N",
        label="the same, mean absolute (N)",
        of=_decoded("decoder", "mae_N"),
        better="less",
    ),
    Figure(
        key="error_frames_percent",
        label="force error through rendered frames (%)",
        of=_decoded("decoder_frames", "relative_error", 100.0),
        better="less",
    ),
    Figure(key="dent_mm", label="deepest dent (mm)", of=lambda r: r["under_load"]["dent_mm"]),
    Figure(
        key="resin_g",
        label="resin, all printed parts (g)",
        of=lambda r: r["fabrication"]["mass_g"].get("resin"),
        better="less",
    ),
    Figure(
        key="rubber_g",
        label="rubber (g)",
        of=lambda r: r["fabrication"]["mass_g"].get("tpu"),
        better="less",
    ),
    Figure(
        key="print_violations",
        label="places that break print rules",
        of=lambda r: r["fabrication"]["print_violations"],
        better="less",
    ),
    Figure(
        key="build_s",
        label="time of all stages, when they ran (s)",
        of=lambda r: r["timing_s"]["total"],
    ),
    Figure(key="press_places", label="places pressed", of=lambda r: r["under_load"]["presses"]),
)


def read_builds(folders: Sequence[Path]) -> list[Build]:
    """Read build folders.

    Raises
    ------
    InputError
        If one is no whole build, or of another program version.
    """
    found = [_read(folder) for folder in folders]
    names = [str(report["design"]) for report, *_ in found]
    out = []
    for folder, name, (report, design, viewer, images) in zip(folders, names, found, strict=True):
        label = name if names.count(name) == 1 else f"{name} ({folder.resolve().name})"
        out.append(
            Build(
                label=label,
                folder=folder,
                report=report,
                design=design,
                viewer=viewer,
                images=images,
            )
        )
    return out


def _read(
    folder: Path,
) -> tuple[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any], Mapping[str, bytes]]:
    try:
        report = _json(folder / "report" / "report.json")
        viewer = _json(folder / "report" / "viewer.json")
        design = toml_table(_bytes(folder / "design.toml").decode("utf-8"))
        _check(report, viewer)
        images = {
            name: _bytes(path)
            for name in (*STILLS, *(name for name, _ in PICTURES))
            if (path := folder / "report" / "images" / name).is_file()
        }
    except OSError as error:
        raise InputError(
            f"{folder} is no whole build ({error.filename}: {error.strerror}); make it with "
            "`phytac build DESIGN`, without --only and --scene"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise InputError(
            f"{folder} cannot be compared: its report is damaged or of another version "
            f"({type(error).__name__}: {str(error)[:LETTERS]}); build it again"
        ) from None
    return report, page.flatten(design), viewer, images


def _bytes(path: Path) -> bytes:
    """Bytes of a regular file; what is wrong with another names it."""
    try:
        return read_bytes(path, bytes_max=FILE_BYTES_MAX)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _json(path: Path) -> Any:
    """JSON without NaN and infinities, which no page could hold."""

    def refuse(name: str) -> Any:
        raise ValueError(f"{path.name} holds {name}")

    return json.loads(_bytes(path), parse_constant=refuse)


def _check(report: Mapping[str, Any], viewer: Mapping[str, Any]) -> None:
    """Read everything that the comparison reads of a build, so that what is wrong shows here."""
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
