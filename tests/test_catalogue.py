"""What `phytac shapes` says: every family and variable, ready for a design file."""

from dataclasses import fields

import pytest

import phytac_shapes
from phytac_design.design.catalogue import shape_facts, shape_list, shape_page
from tests.refusals import refused


def test_every_family_has_its_line() -> None:
    lines = shape_list().splitlines()
    for line, name in zip(lines, phytac_shapes.REGISTRY, strict=False):
        assert line.startswith(f"{name} ")
        assert line.endswith(".")


@pytest.mark.parametrize("name", sorted(phytac_shapes.REGISTRY))
def test_a_page_names_every_variable_with_its_range_and_default(name: str) -> None:
    page = shape_page(name)
    assert f'kind = "{name}"' in page
    for item in fields(phytac_shapes.REGISTRY[name]):
        (line,) = [text for text in page.splitlines() if text.startswith(f"{item.name} = ")]
        needed = next(
            entry["required"]
            for family in shape_facts()
            if family["kind"] == name
            for entry in family["variables"]
            if entry["name"] == item.name
        )
        assert line.endswith("# required") == needed
        assert item.metadata["doc"] in page
        if "minimum" in item.metadata:
            assert f"[{item.metadata['minimum']:g} … {item.metadata['maximum']:g}]" in page


def test_defaults_are_written_as_toml() -> None:
    assert 'faces = ["+x", "+y", "-x", "-y"]' in shape_page("cuboid")
    assert 'end = "open"' in shape_page("cone")
    assert "tilt_deg = 0" in shape_page("plane")


def test_an_unknown_family_is_refused() -> None:
    with refused("shape-unknown") as caught:
        shape_page("con")
    caught.match("did you mean 'cone'")
