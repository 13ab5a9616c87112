"""The examples of use, in their quick form: what they find is near what was done to the sensor."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.stages.build import BuildResult, build
from phytac_design.workflows import simulate

USES = Path(__file__).parents[1] / "examples" / "uses"
ACCURACY = replace(PRESETS["draft"], refine=2, truth_refine=4, sample_share=0.02, place_share=1.2)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder for all of them: the handle is built once, on coarse meshes."""
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(USES))
    import recorded

    def coarse(design: Design, out: Path, **named: Any) -> BuildResult:
        return build(design, out, **{**named, "accuracy": ACCURACY})

    @cache
    def views(_: str) -> Any:
        return expected_views(Sensor(load_design(str(USES / "handle.toml"))))

    patch.setattr(recorded, "build", coarse)
    # What a design shows is found once.
    patch.setattr(simulate, "expected_views", lambda sensor: views(design_hash(sensor.design)))
    yield tmp_path_factory.mktemp("uses")
    for name in ("recorded", "grip", "stroke", "objects", "cup"):
        sys.modules.pop(name, None)
    patch.undo()


@pytest.mark.long
def test_grip_tells_fingers_apart(out: Path) -> None:
    import grip

    found = grip.main(out, quick=True)
    truth, read = found["truth_N"], found["found_N"]
    assert truth.shape == read.shape == (8, 5)
    # A finger that is not there is not felt.
    assert not read[truth == 0.0].any()
    assert np.abs(read - truth)[truth > 0.0].mean() < 0.5 * truth[truth > 0.0].mean()
    assert np.corrcoef(read.ravel(), truth.ravel())[0, 1] > 0.8
    assert (out / "grip.png").stat().st_size > 10_000
    assert len((out / "grip-regions.csv").read_text().splitlines()) == 9


@pytest.mark.long
def test_a_stroke_has_five_curves(out: Path) -> None:
    import stroke

    found = stroke.main(out, quick=True)
    truth, read = found["truth_N"], found["found_N"]
    # Fingers side by side share switches; the thumb stands alone.
    assert np.corrcoef(truth[:, 0], read[:, 0])[0, 1] > 0.9
    assert np.corrcoef(truth.sum(axis=1), read.sum(axis=1))[0, 1] > 0.8
    assert np.corrcoef(truth.ravel(), read.ravel())[0, 1] > 0.6
    # The thumb's peak, within two frames at 480 fps.
    late = found["time_s"][read[:, 0].argmax()] - found["time_s"][truth[:, 0].argmax()]
    assert abs(late) <= 2.0 / 480.0 + 1e-9
    assert (out / "stroke.png").stat().st_size > 10_000


@pytest.mark.long
def test_objects_break_where_the_true_force_would_break_them(out: Path) -> None:
    import objects

    found = objects.main(out, quick=True)
    truth, read = found["truth_N"], found["found_N"]
    states = objects.happened(read)
    for name, crushed_N in (("egg", 50.0), ("vase", 80.0)):
        at = states[name].index("crushed")
        assert truth[at] == pytest.approx(crushed_N, rel=0.3)
        assert set(states[name][at:]) == {"crushed"}
    # Gentle again, the ball comes back; the egg does not.
    assert states["soft ball"][-1] == "free"
    assert objects.happened([30.0, 49.9, 50.0, 0.0])["egg"] == [
        "held",
        "held",
        "crushed",
        "crushed",
    ]
    assert objects.happened([0.5, 4.0, 6.0, 25.0])["soft ball"] == [
        "free",
        "held",
        "squeezed",
        "flat",
    ]


@pytest.mark.long
def test_a_cup_is_held_by_feedback_alone(out: Path) -> None:
    import cup

    ended = cup.main(out, quick=True)
    assert ended == {
        "0.3 without": "dropped",
        "0.3 with feedback": "held",
        "3 without": "crushed",
        "3 with feedback": "held",
    }
    rows = np.loadtxt(out / "cup.csv", delimiter=",", skiprows=1)
    # The loop is closed: where force is felt, what is read goes up and down with it.
    felt = rows[(rows[:, 1] == 1.0) & (rows[:, 5] > 0.0)]
    assert np.corrcoef(felt[:, 4], felt[:, 5])[0, 1] > 0.6
