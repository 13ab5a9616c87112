"""Scenario files: read, refused with a reason, named, hashed, documented."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from phytac_design.design.base_table import descriptions
from phytac_design.design.toml_files import table_models
from phytac_design.simulation.scenario.scenario_file import (
    Scenario,
    load_scenario,
    parse_scenario,
    scenario_hash,
    shipped_scenarios,
)
from phytac_shapes.errors import DesignError
from tests.refusals import refused

PAGE = Path(__file__).parents[2] / "docs" / "scenarios.md"
NAMES = [
    "cycles",
    "extremes",
    "grips",
    "paper-grips",
    "paper-protocol",
    "platform",
    "rims",
    "smoke",
]


def test_all_scenarios_are_shipped_and_named_as_their_files() -> None:
    assert shipped_scenarios() == NAMES
    assert [load_scenario(name).name for name in NAMES] == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_resolved_scenario_reads_back_the_same(name: str) -> None:
    scenario = load_scenario(name)
    again = parse_scenario(scenario.model_dump(mode="json"), "again")
    assert again == scenario
    assert scenario_hash(again) == scenario_hash(scenario)


def test_hash_is_of_the_fields_not_of_their_order() -> None:
    one = parse_scenario({"name": "a", "touch": {"samples": 3, "most": 4}, "light": {}}, "one")
    two = parse_scenario({"touch": {"most": 4, "samples": 3}, "name": "a"}, "two")
    assert scenario_hash(one) == scenario_hash(two)
    other = parse_scenario({"name": "a", "touch": {"samples": 3, "most": 5}}, "other")
    assert scenario_hash(one) != scenario_hash(other)
    assert len({scenario_hash(load_scenario(name)) for name in NAMES}) == len(NAMES)


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\n[touch]\nsamples = 7\n')
    assert load_scenario(str(path)).touch.samples == 7


AT = {"force_N": 1.0, "radius_mm": 2.0}
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"touch": {"force_max": 3.0}}, "unknown key 'touch.force_max'; did you mean 'force_max_N'?"),
    ({"lite": {}}, "unknown key 'lite'"),
    ({"touch": {"at": [{"marker": 1, "force_N": 2.0}]}}, "touch.at.0.radius_mm is missing"),
    ({"touch": {"at": [AT]}}, "needs one place: .* (got none)"),
    ({"touch": {"at": [AT | {"marker": 1, "along": 0.5}]}}, "(got marker, along and around)"),
    ({"touch": {"at": [AT | {"row": 1}]}}, "(got row and column, of which one is missing)"),
    ({"touch": {"at": [AT | {"marker": 1, "length_mm": 4.0}]}}, "only a cylinder has length_mm"),
    ({"touch": {"at": [AT | {"marker": 1, "friction": [4.0, 4.0]}]}}, "friction must not exceed"),
    ({"touch": {"indenters": []}}, "touch.indenters: tuple should have at least 1 item"),
    ({"touch": {"indenters": [{"kind": "cone"}]}}, "'flat', 'sphere' or 'cylinder' (got 'cone')"),
    ({"touch": {"indenters": [{"turn_deg": 1.0}]}}, "only a cylinder has length_mm and turn_deg"),
    ({"touch": {"along": [0.5, 0.5]}}, "along must grow"),
    ({"touch": {"placement": "rims", "columns": [0]}}, "columns and grippers go with placement"),
    ({"touch": {"grippers": [{"fingers": [[0, 0], [0, 0]]}]}}, "two fingers press on one receptor"),
    ({"touch": {"around": [0.5, 0.5]}}, "around must not be empty"),
    ({"touch": {"around": [0.5, 1.5]}}, "touch.around.1: .* less than or equal to 1 (got 1.5)"),
    ({"touch": {"force_min_N": 3.0, "force_max_N": 2.0}}, "force_min_N must not exceed force_max"),
    ({"touch": {"radius_min_mm": 3.0, "radius_max_mm": 2.0}}, "radius_min_mm must not exceed"),
    ({"touch": {"friction_min": 1.0}}, "friction_min must not exceed friction_max"),
    ({"touch": {"samples": True}}, "samples must be a number or a text, not true or false"),
    ({"touch": {"samples": 1, "at": [AT | {"marker": 1, "sample": 1}]}}, "raise it to 2"),
    ({"grip": {}}, "[grip] goes with kind = 'grips' (got kind = 'presses')"),
    ({"kind": "grips", "cycle": {}}, "[cycle] goes with kind = 'cycles'"),
    ({"kind": "grips", "touch": {"at": []}}, "give [[grip.pads]]"),
    ({"kind": "grips", "grip": {"total_min_N": 9.0, "total_max_N": 8.0}}, "total_min_N must not"),
    ({"kind": "grips", "grip": {"pads": [{"along": 0.5}]}}, "grip.pads.0.around is missing"),
    ({"kind": "cycles", "touch": {"samples": 3}}, "set cycle.count, cycle.every"),
    ({"kind": "cycles", "touch": {"at": [AT | {"marker": 1, "sample": 2}]}}, "pressed together"),
    ({"kind": "cycles", "cycle": {"phases": [1.0, 1.0]}}, "phases must grow"),
    ({"kind": "cycles", "cycle": {"phases": [4.5]}}, "less than or equal to 4"),
    ({"kind": "cycles", "cycle": {"count": 90_000, "every": 1}}, "raise every (got 1)"),
    ({"time": {"relax_share": [0.1]}}, "must be equally long (got 1 and 0)"),
    ({"time": {"relax_share": [0.6, 0.5], "relax_s": [1, 2]}}, "must sum to less than 1 (got 1.1)"),
    ({"time": {"relax_share": [0.1, 0.1], "relax_s": [2, 2]}}, "relax_s must differ"),
    ({"time": {"ramp_s": 0.0}}, "time.ramp_s: .* greater than 0 (got 0.0)"),
    ({"imaging": {"lens_blur": 1}}, "imaging.lens_blur"),
    ({"solve": {"rote": "frames"}}, "unknown key 'solve.rote'; did you mean 'route'?"),
    ({"solve": {"displacement": "huge"}}, "'auto', 'linear' or 'large' (got 'huge')"),
    ({"unit": {"number": -1}}, "unit.number"),
    ({"unit": {"modulus_share": float("inf")}}, "unit.modulus_share"),
]


@pytest.mark.parametrize(("data", "says"), WRONG, ids=[says[:40] for _, says in WRONG])
def test_mistakes_are_rejected_with_the_key_and_what_would_do(
    data: dict[str, Any], says: str
) -> None:
    pattern = re.escape(says).replace(r"\.\*", ".*")
    with refused("field-invalid") as error:
        parse_scenario({"name": "t"} | data, "t.toml")
    error.match(pattern)
    assert str(error.value).startswith("scenario t.toml: ")


def test_every_mistake_is_named_at_once() -> None:
    data = {"name": "t", "touch": {"most": 1}, "light": {"drift": 1.0}, "time": {"rest_s": -1.0}}
    with pytest.raises(DesignError) as error:
        parse_scenario(data, "t")
    assert all(key in str(error.value) for key in ("touch.most", "light.drift", "time.rest_s"))


def test_an_unknown_name_lists_the_known_ones() -> None:
    with refused("toml-file-not-found") as caught:
        load_scenario("platfrom")
    caught.match("did you mean 'platform'")


@pytest.mark.parametrize(
    ("text", "says"), [(b"name = ", "is not TOML"), (b"\xff\xfe", "it is not even text")]
)
def test_files_that_are_no_toml(tmp_path: Path, text: bytes, says: str) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(text)
    with refused("toml-syntax") as caught:
        load_scenario(str(path))
    caught.match(says)


def test_switches_are_true_or_false() -> None:
    for table in ("imaging", "eyes"):  # the latter is its former name
        scenario = parse_scenario({"name": "t", table: {"lens_blur": False}}, "t")
        assert scenario.imaging.lens_blur is False
    assert scenario.solve.local is True


def test_the_page_explains_every_field() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"`{name}`" in page for name in NAMES)
    for model in _models(Scenario):
        for key, info in model.model_fields.items():
            if not isinstance(info.default, BaseModel) and key not in {"grip", "cycle"}:
                text = " ".join(descriptions(model)[key].split()).replace("|", "\\|")
                assert re.search(rf"^\| `{key}` \|.*\| {re.escape(text)} \|$", page, re.MULTILINE)


def _models(model: type[BaseModel]) -> set[type[BaseModel]]:
    """A model and all that it holds."""
    fields = model.model_fields.values()
    return {model}.union(*(_models(m) for info in fields for m in table_models(info.annotation)))


def test_examples_of_the_page_are_scenarios() -> None:
    examples = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names = [parse_scenario(tomllib.loads(text), "page").name for text in examples]
    assert names == ["my-rig", "two-thumbs"]


def test_a_mistake_within_a_list_is_not_one_of_the_list_as_well() -> None:
    with pytest.raises(DesignError) as error:
        parse_scenario({"name": "t", "touch": {"indenters": [{"kind": "cone"}]}}, "t")
    assert "at least 1 item" not in str(error.value)
