"""``phytac live`` as a person runs it, and regions of a design that was built."""

import http.client
import json
import os
import re
import select
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.io.bundle import load_bundle
from phytac_design.layout import make_markers
from phytac_design.layout.region_chart import bundle_regions
from phytac_design.stages.build import BuildResult
from tests.decoder.toy_sensor import toy_recording
from tests.designs import small
from tests.refusals import refused
from tests.test_cli import PHYTAC, phytac

PATIENCE_S = 60.0


def test_a_browser_sees_frames_until_it_is_stopped(tmp_path: Path) -> None:
    decoder, frames = toy_recording(tmp_path, [{}, {14: 3.0}, {14: 3.0}])
    words = ("live", str(decoder), str(frames), "--fps", "50", "--loop", "--every", "--port", "0")
    words += ("--moment-about", "20", "20", "5")
    done = subprocess.Popen(
        ["env", "--default-signal=INT", *PHYTAC, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    with done:
        try:
            assert done.stderr is not None
            assert select.select([done.stderr], [], [], PATIENCE_S)[0]
            found = re.search(r"http://127\.0\.0\.1:(\d+)/", done.stderr.readline())
            assert found
            link = http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=PATIENCE_S)
            link.request("GET", "/events")
            data = (line for line in link.getresponse() if line.startswith(b"data: "))
            assert json.loads(next(data)[6:])["design"] == "toy"
            # Pushes are fewer than frames, and may keep in step: three frames, not two.
            for _ in range(1000):
                message = json.loads(next(data)[6:])
                assert message["type"] == "frame"
                if message["total_N"] > 0.0:
                    break
            assert message["total_N"] == pytest.approx(3.0, abs=0.15)
            assert message["moment_about_mm"] == [20.0, 20.0, 5.0]
            done.send_signal(signal.SIGINT)
            assert json.loads(list(data)[-1][6:]) == {"type": "end", "reason": "stopped"}
            link.close()
            reported, errors = done.communicate(timeout=PATIENCE_S)
        finally:
            done.kill()
    assert done.returncode == 130
    assert "Traceback" not in errors
    assert " frames in " in reported


def test_errors_are_one_line(tmp_path: Path) -> None:
    decoder, frames = toy_recording(tmp_path, [{}])
    for words, message in (
        ((str(decoder), str(tmp_path / "none")), "no frames at"),
        ((str(decoder), str(frames), "--follow"), "give it with --rest"),
        ((str(decoder), str(frames), str(frames)), "has one camera"),
    ):
        out = phytac("live", *words, "--port", "0")
        assert (out.returncode, len(out.stderr.splitlines())) == (4, 1), out.stderr
        assert message in out.stderr


def test_shares_and_rows_are_those_of_the_design_beside_the_bundle(
    built: BuildResult, tmp_path: Path
) -> None:
    folder = built.out / "decoder"
    bundle, path = load_bundle(folder), tmp_path / "regions.toml"
    path.write_text(
        '[[regions]]\nname = "row"\nrows = [2, 2]\n'
        '[[regions]]\nname = "far"\nalong = [0.5, 1.0]\n'
        '[[regions]]\nname = "seam"\naround = [0.9, 0.1]\n'
    )
    row, far, seam = bundle_regions(path, bundle, folder)
    design = small()
    markers = make_markers(design, design.surface())
    assert list(row.markers) == np.flatnonzero(markers.row == 2).tolist()
    assert list(far.markers) == np.flatnonzero(bundle.position_mm[:, 2] > 30.0).tolist()
    angle = np.arctan2(bundle.position_mm[:, 1], bundle.position_mm[:, 0])
    assert list(seam.markers) == np.flatnonzero(np.abs(angle) <= 0.2 * np.pi).tolist()
    assert bundle_regions(None, bundle, folder) == ()
    with refused("decoder-of-other-design"):
        bundle_regions(path, bundle, folder, "cylinder60")
