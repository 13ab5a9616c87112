"""Scenes for tests."""

from typing import Any

from phytac_design.design.scene import Scene, parse_scene


def scene(**changes: Any) -> Scene:
    """One finger on a part of the small design."""
    data: dict[str, Any] = {
        "name": "finger",
        "outputs": ["decoder"],
        # So that linear theory will do: builds of tests are short.
        "error_allowed": 0.5,
        "contacts": {"force_max_N": 6.0, "at_once": 1},
        "regions": [{"along": [0.35, 0.65], "around": [0.0, 0.2]}],
    }
    return parse_scene(data | changes, "test scene")
