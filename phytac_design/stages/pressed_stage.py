"""Pictures of the press under which a marker is lost first, for the report."""

from pathlib import Path

from phytac_design.engine.stage import Context, Stage, write_arrays
from phytac_design.report.press_pictures import press_pictures


def run(context: Context, folder: Path) -> None:
    """Render the press that ``underload`` kept; without pictures if it could solve none."""
    kept = context.arrays("underload")
    arrays = {}
    if len(kept["shown_uv"]):
        place, motion = kept["shown_uv"][0], kept["shown_motion"][0]
        camera_number = context.arrays("views")["camera"]
        arrays = press_pictures(context, place, motion, camera_number).arrays()
    write_arrays(folder, arrays)


PRESSED = Stage(
    name="pressed",
    design_fields=("cameras", "markers", "bodies", "trips", "touch"),
    depends_on=("views", "underload"),
    arrays={"views": ("camera",), "underload": ("shown_uv", "shown_motion")},
    run=run,
)
