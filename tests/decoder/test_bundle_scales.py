"""Numbers of a bundle: what is no scale or no camera is refused, and not a force of NaN."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_design.stages.build import BuildResult
from tests.refusals import refused
from verification.test_readers import bundle


@pytest.mark.parametrize(
    ("name", "change", "code"),
    [
        ("scale_in", lambda value: [None, *value[1:]], "bundle-invalid"),
        ("scale_in", lambda value: [0.0, *value[1:]], "bundle-invalid"),
        ("scale_in", lambda value: [-1.0, *value[1:]], "bundle-invalid"),
        ("scale_in", lambda value: value[1:], "bundle-invalid"),
        ("scale_in", lambda _: 1.0, "bundle-invalid"),
        ("scale_out", lambda _: None, "bundle-invalid"),
        ("scale_out", lambda _: [1.0, 2.0], "bundle-invalid"),
        ("scale_out", lambda _: 1e999, "bundle-unreadable"),
    ],
)
def test_what_is_no_scale_is_rejected(
    built: BuildResult, tmp_path: Path, name: str, change: Any, code: str
) -> None:
    folder = tmp_path / "decoder"
    shutil.copytree(built.out / "decoder", folder)
    assert load_bundle(folder).model.networks["fem_nn"].scale_in.shape == (10,)
    path = folder / "bundle.json"
    meta = json.loads(path.read_text())
    network = meta["networks"]["fem_nn"]
    network[name] = change(network[name])
    path.write_text(json.dumps(meta))
    with refused(code):
        load_bundle(folder)


@pytest.mark.parametrize(
    ("where", "text", "code"),
    [
        ("markers", "1e400", "bundle-unreadable"),
        ("markers", "1" * 400, "bundle-invalid"),
        ("markers", "1e30", "bundle-invalid"),
        ("focal_px", "1e400", "bundle-unreadable"),
        ("focal_px", "1e308", "bundle-camera-range"),
        ("width_px", "1e30", "bundle-camera-range"),
        ("centre_px", "[-1e308, 1]", "bundle-camera-range"),
        ("position_mm", "[0, 0, 1e300]", "bundle-camera-range"),
    ],
)
def test_absurd_numbers_are_rejected_and_named(
    tmp_path: Path, where: str, text: str, code: str
) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    (meta if where in meta else meta["cameras"][0])[where] = "HERE"
    path.write_text(json.dumps(meta).replace('"HERE"', text))
    with refused(code) as caught:
        load_bundle(tmp_path)
    assert len(str(caught.value)) < 400
    assert "rebuild the decoder" in str(caught.value)
