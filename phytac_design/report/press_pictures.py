"""Pictures of one press from rest to the largest force: the camera's view, and a close view."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.core import html as page
from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import cameras_of
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class PressPictures:
    """Pictures of one press.

    Attributes
    ----------
    force_N : (k,) float
        From 0 to the design's largest force.
    on : (k,) int
        Switches that are on.
    marker, camera : int
        Marker nearest to the press, and number of the camera.
    whole, close : list of bytes
        JPEG of the whole view, and of the surroundings of the press.
    """

    force_N: FloatArray
    on: FloatArray
    marker: int
    camera: int
    whole: list[bytes]
    close: list[bytes]

    def arrays(self) -> dict[str, Any]:
        """Arrays for a stage's file."""
        pictures = {
            f"{name}_{number}": np.frombuffer(data, dtype=np.uint8)
            for name in ("whole", "close")
            for number, data in enumerate(getattr(self, name))
        }
        figures = {name: getattr(self, name) for name in ("force_N", "on", "marker", "camera")}
        return figures | pictures

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> "PressPictures | None":
        """Pictures among a stage's arrays; None if there are none."""
        if "force_N" not in arrays:
            return None
        whole, close = (
            [arrays[f"{name}_{number}"].tobytes() for number in range(len(arrays["force_N"]))]
            for name in ("whole", "close")
        )
        return cls(
            force_N=arrays["force_N"],
            on=arrays["on"],
            marker=int(arrays["marker"]),
            camera=int(arrays["camera"]),
            whole=whole,
            close=close,
        )


def window(camera: Camera, low_px: FloatArray, width_px: float, out_px: int) -> Camera:
    """Camera that sees a part of a camera's picture, scaled.

    Parameters
    ----------
    low_px : (2,) float
        Left and upper edge of the part, counted from the picture's edge.
    width_px : float
        Its width; the aspect stays.
    out_px : int
        Width of the new picture.
    """
    lens, scale = camera.lens, out_px / width_px
    cx, cy = ((lens.centre_px + 0.5 - low_px) * scale - 0.5).tolist()
    part = replace(
        lens,
        width_px=out_px,
        height_px=max(round(out_px * lens.height_px / lens.width_px), 1),
        fx_px=lens.fx_px * scale,
        fy_px=lens.fy_px * scale,
        cx_px=cx,
        cy_px=cy,
    )
    return replace(camera, lens=part)


def close_to(camera: Camera, point_mm: FloatArray, width_px: int) -> Camera:
    """Close view around the image of a point (3,), inside the camera's picture, of some width."""
    size = np.array([camera.width_px, camera.height_px])
    part = 0.22 * size
    middle = np.nan_to_num(camera.project(point_mm[None])[0], nan=0.0) + 0.5
    low = np.clip(middle - part / 2.0, 0.0, size - part)
    return window(camera, low, float(part[0]), width_px)


def press_pictures(
    context: Context,
    uv: FloatArray,
    motion: FloatArray,
    camera_number: IntArray,
    *,
    steps: int = 6,
    width_px: int = 640,
) -> PressPictures:
    """Render a press with the design's largest force.

    Between rest and the full force the wall's motion is interpolated linearly, in ``steps``
    pictures, rest included.

    Parameters
    ----------
    uv : (2,) float
        Its place.
    motion : (n, 6) float
        Motion of the wall under every marker, mm and rad.
    camera_number : (n,) int
        Camera that each marker is read through.
    """
    design, surface, markers = context.design, context.surface, context.markers
    place = surface.point(uv[None])
    marker = int(np.linalg.norm(surface.point(markers.uv) - place, axis=1).argmin())
    number = int(camera_number[marker])
    camera = cameras_of(design, surface)[number]
    share = np.linspace(0.0, 1.0, steps)
    force = share * design.training.force_max_N
    contacts = Contacts.flat(
        sample=np.arange(steps),
        uv=np.repeat(uv[None], steps, axis=0),
        radius_mm=np.full(steps, design.training.patch_radius_max_mm),
        force_N=force,
        samples=steps,
    )
    switching = switch_states(context.sensor, contacts)
    shown = switching.shown
    views = {
        "whole": window(camera, np.zeros(2), camera.width_px, width_px),
        "close": close_to(camera, markers.tip_mm[marker], width_px),
    }
    pictures: dict[str, list[bytes]] = {}
    for name, view in views.items():
        scenes = PressedScene(context.sensor, view)
        pictures[name] = [
            _jpeg(render_frame(scenes.scene(share[step] * motion, shown[step]), view, samples=4))
            for step in range(steps)
        ]
    return PressPictures(
        force_N=force, on=switching.bits.sum(axis=1), marker=marker, camera=number, **pictures
    )


def _jpeg(image: ImageArray) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 78])[1])


def press_slider(pressed: PressPictures, name: str, whose: str) -> str:
    """HTML of the pictures with a slider; without scripts and in print the first and last show.

    Parameters
    ----------
    name : str
        Name of the pressed marker.
    whose : str
        Text that names the camera, "" if there is one.
    """
    forces = [f"{force:.3g}" for force in pressed.force_N]
    figures = []
    for what, images in (("All of it", pressed.whole), ("Close to the press", pressed.close)):
        shown = "".join(
            page.image(
                data,
                f"{what}{whose}, pressed with {forces[k]} N near marker {name}"
                if k
                else f"{what}{whose}, at rest",
                "jpeg",
                name=f"pressed_{'close' if images is pressed.close else 'all'}_{k}.jpg",
                extra=' class="ends"' if k in (0, len(images) - 1) else "",
            )
            for k, data in enumerate(images)
        )
        figures.append(
            f"<figure>{shown}<figcaption>{escape(what + whose)}, from rest to {forces[-1]} N near "
            f"marker {escape(name)}</figcaption></figure>"
        )
    on = " ".join(str(int(count)) for count in pressed.on)
    return (
        f'<div class="press" data-forces="{" ".join(forces)}" data-on="{on}">'
        '<p class="controls" hidden><label for="press-force">Force of the press </label>'
        f'<input id="press-force" type="range" min="0" max="{len(forces) - 1}" step="1" '
        f'value="{len(forces) - 1}"> <output for="press-force"></output></p>'
        f"{page.side_by_side(*figures)}</div>"
    )
