"""Scales of a bundle's networks: what is no scale is refused, and not a force of NaN."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from phytac_decoder.io.bundle import load_bundle
from phytac_design.stages.build import BuildResult
from tests.refusals import refused


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
