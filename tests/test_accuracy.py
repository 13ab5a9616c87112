"""Settings of a build: presets, single changes, and refusals."""

from dataclasses import replace

import pytest

from phytac_design.design.accuracy import PRESETS, preset_name, settings_of, with_settings
from tests.refusals import refused


@pytest.mark.parametrize("name", PRESETS)
def test_presets_by_name(name: str) -> None:
    assert settings_of(name) is PRESETS[name]
    assert preset_name(PRESETS[name]) == name


def test_custom_settings() -> None:
    own = with_settings(PRESETS["draft"], ["refine=5", "place_share = 0.6", "receptors=no"])
    assert own == replace(PRESETS["draft"], refine=5, place_share=0.6, receptors=False)
    assert settings_of(own) is own
    assert preset_name(own) == "custom"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("refin=5", "setting-unknown"),
        ("refine", "setting-unknown"),
        ("refine=2.5", "setting-invalid"),
        ("refine=0", "setting-invalid"),
        ("place_share=nan", "setting-invalid"),
        ("cad_tolerance_mm=-1", "setting-invalid"),
        ("receptors=maybe", "setting-invalid"),
    ],
)
def test_invalid_settings_are_rejected(text: str, code: str) -> None:
    with refused(code):
        with_settings(PRESETS["draft"], [text])


def test_unknown_preset() -> None:
    with refused("accuracy-unknown"):
        settings_of("best")
