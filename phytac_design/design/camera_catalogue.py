"""Common cameras with their lenses, for a first design: what their makers publish.

Sizes are those of video modes with the full field of view; where such a mode bins pixels, the pixel
is the binned one. Data sheets round the field of view: calibrate the camera that is built in.
"""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class CatalogueCamera:
    """A camera module with a lens; the fields are those of the table ``camera``, but ``label``."""

    label: str
    width_px: int
    height_px: int
    frame_rate_Hz: float
    field_of_view_deg: float
    pixel_um: float
    f_number: float
    model: str = "pinhole"

    def table(self) -> dict[str, Any]:
        """Table ``camera`` of a design file."""
        fields = asdict(self)
        del fields["label"]
        if self.model == "pinhole":
            del fields["model"]
        return fields

    def words(self) -> str:
        """One line for a list."""
        lens = ", fisheye" if self.model == "kannala_brandt" else ""
        return (
            f"{self.label}: {self.width_px} x {self.height_px} px, "
            f"{self.field_of_view_deg:g}° across{lens}"
        )


CAMERAS = (
    CatalogueCamera(
        label="5 MP camera of the published sensor (field of view assumed)",
        width_px=2592, height_px=1944, frame_rate_Hz=30.0,
        field_of_view_deg=106.4, pixel_um=1.4, f_number=2.8,
    ),
    CatalogueCamera(
        label="Raspberry Pi Camera Module 2 (IMX219)",
        width_px=1640, height_px=1232, frame_rate_Hz=40.0,
        field_of_view_deg=62.2, pixel_um=2.24, f_number=2.0,
    ),
    CatalogueCamera(
        label="Raspberry Pi Camera Module 3 (IMX708)",
        width_px=2304, height_px=1296, frame_rate_Hz=56.0,
        field_of_view_deg=66.0, pixel_um=2.8, f_number=1.8,
    ),
    CatalogueCamera(
        label="Raspberry Pi Camera Module 3 Wide (IMX708)",
        width_px=2304, height_px=1296, frame_rate_Hz=56.0,
        field_of_view_deg=102.0, pixel_um=2.8, f_number=2.2,
    ),
    CatalogueCamera(
        label="Full HD web camera (78° diagonal, typical values)",
        width_px=1920, height_px=1080, frame_rate_Hz=30.0,
        field_of_view_deg=70.4, pixel_um=2.0, f_number=2.2,
    ),
    CatalogueCamera(
        label="USB endoscope camera (typical values)",
        width_px=1280, height_px=720, frame_rate_Hz=30.0,
        field_of_view_deg=70.0, pixel_um=1.4, f_number=2.8,
    ),
    CatalogueCamera(
        label="USB camera module with a fisheye lens (typical values)",
        width_px=1920, height_px=1080, frame_rate_Hz=30.0,
        field_of_view_deg=160.0, pixel_um=3.0, f_number=2.0, model="kannala_brandt",
    ),
)  # fmt: skip
"""Cameras in the order of the list. Those of Raspberry Pi have the numbers of its documentation;
the last three stand for many similar products."""
