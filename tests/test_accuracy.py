"""Settings of a build: presets, single changes, and refusals."""

from dataclasses import replace

import pytest

from phytac_design.design.accuracy import PRESETS, preset_name, settings_of, with_settings
from phytac_shapes.errors import DesignError


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
    ("text", "words"),
    [
        ("refin=5", "did you mean 'refine'"),
        ("refine", "NAME=VALUE"),
        ("refine=2.5", "refine cannot be '2.5'; it is int"),
        ("refine=0", "refine cannot be 0; it lies from 1 to 24"),
        ("place_share=nan", "place_share cannot be nan"),
        ("cad_tolerance_mm=-1", "cad_tolerance_mm cannot be -1"),
        ("receptors=maybe", "receptors cannot be 'maybe'; it is bool"),
    ],
)
def test_invalid_settings_are_rejected(text: str, words: str) -> None:
    with pytest.raises(DesignError, match=words):
        with_settings(PRESETS["draft"], [text])


def test_unknown_preset() -> None:
    with pytest.raises(DesignError, match="choose one of draft, standard, fine"):
        settings_of("best")
