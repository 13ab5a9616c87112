"""Header of the calibration log that a rig writes while it runs the motion program.

``phytac calibrate`` reads the log's columns as they are, ``phytac import`` the step, frame and time
in the comment line before each reading (``docs/formats.md``).
"""

import re

COLUMNS = ("contact_marker", "patch_radius_mm", "force_N", "displacement_mm")
NOTE = re.compile(r"#\s*step\s+(\d+)\s*,\s*frame\s+(\d+)\s*,\s*([-+.\deE]+)\s*s\s*$")


def log_head(name: str) -> str:
    """First lines of a log of a design, to which the rig appends."""
    return (
        f"# calibration log of {name}\n"
        "# before each reading: # step STEP, frame FRAME, SECONDS s\n" + ",".join(COLUMNS) + "\n"
    )
