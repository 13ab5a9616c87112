#!/usr/bin/env python
"""Makes the files of this example: a made-up rig, its pictures rendered, nothing measured.

Run in this folder: ``python make.py``. The same numbers come out every time.
"""

from pathlib import Path

import cv2
import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses, superpose

PRESSES = (
    # sample, u mm, v degrees, radius mm, force N
    (1, 11.5, 31.0, 4.0, 3.0),
    (2, 11.5, 31.0, 4.0, 6.0),
    (3, 18.5, 206.0, 5.0, 9.0),
    (4, 10.5, 299.0, 4.0, 5.0),
    (4, 25.5, 121.0, 4.5, 7.5),
    (5, 18.0, 90.0, 4.0, 12.0),
)
"""Sample 2 is sample 1 pressed harder, sample 4 has two contacts at once."""
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]


def main(folder: Path) -> None:
    """Render every sample and the sensor at rest, and write the log."""
    design = load_design(str(folder / "rig.toml"))
    surface = design.surface()
    markers = make_markers(design, surface)
    table = np.array(PRESSES)
    angle = np.radians(table[:, 2])
    contacts = Contacts.flat(
        sample=table[:, 0].astype(np.int64) - 1,
        uv=np.column_stack([table[:, 1], angle]),
        radius_mm=table[:, 3],
        force_N=table[:, 4],
        samples=5,
    )
    sensor = Sensor.of(design, surface, markers)
    bits = switch_states(sensor, contacts).bits
    mesh, model = truth_shell(design, surface, 8)
    responses = motion_responses(
        model, mesh, surface, markers, uv=contacts.uv, radius_mm=contacts.radius_mm
    )
    motion = superpose(responses, contacts)
    (camera,) = cameras_of(design, surface)
    (folder / "frames").mkdir(exist_ok=True)
    scenes = PressedScene(sensor, camera)
    for frame in range(6):
        still, off = np.zeros((markers.count, 6)), np.zeros(markers.count, dtype=np.bool_)
        press = (motion[frame - 1], bits[frame - 1]) if frame else (still, off)
        scene = scenes.scene(*press)
        rng = np.random.default_rng(frame)
        image = render_frame(scene, camera, noise_std=1.0, rng=rng)
        cv2.imwrite(str(folder / "frames" / f"frame_{frame:04d}.jpg"), image, JPEG)
    points = surface.point(contacts.uv)
    lines = [
        "# MADE UP for the example of `phytac import`: no sensor was pressed to get these numbers.",
        "# Frame 0 shows the sensor at rest.",
        "sample,frame,timestamp_s,x_mm,y_mm,z_mm,force_N,radius_mm",
    ]
    for (sample, _, _, radius, force), (x, y, z) in zip(PRESSES, points, strict=True):
        place = f"{x:.3f},{y:.3f},{z:.3f}"
        lines.append(f"{sample},{sample},{2.5 * sample:.3f},{place},{force:g},{radius:g}")
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(__file__).parent)
