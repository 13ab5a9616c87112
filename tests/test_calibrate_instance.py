"""``phytac calibrate-instance``: a print's decoder from a few presses on a scale.

The pictures are those of the example rig, a sensor as designed. A print that is 1.2 times as stiff
shows the same pictures under forces that are 1.2 times as large.
"""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_design.cli import calibrate_instance_command
from phytac_design.cli.app import app
from phytac_design.cli.calibrate_instance_command import newtons
from phytac_design.training.locator_calibration import SETTINGS, spread_of_few
from phytac_design.training.press_places import next_place, remaining_variance, usable_places
from phytac_design.workflows.import_rig import import_rig
from phytac_shapes.arrays import ImageArray
from tests.refusals import refused
from tests.simulation.test_rig import DESIGN, EXAMPLE, bundle

__all__ = ["bundle"]  # a fixture

STIFFER = 1.2
FRAMES = EXAMPLE / "frames"
FORCES = {1: 3.0, 2: 6.0, 3: 9.0, 5: 12.0}
"""Of the pictures with one contact."""
REST = FRAMES / "frame_0000.jpg"


def run(bundle: Path, out: Path, *words: str, source: Path = FRAMES, typed: str = "") -> Result:
    """The command, with the example's rest frame."""
    fixed = ["calibrate-instance", str(EXAMPLE / "rig.toml"), str(bundle), str(source)]
    fixed += ["--rest", str(REST), "--out", str(out)]
    return CliRunner().invoke(app, [*fixed, *words], input=typed)


def table(path: Path, numbers: tuple[int, ...] = (2, 3, 5), factor: float = STIFFER) -> Path:
    """A table of presses on the stiffer print."""
    rows = [f"{number},{factor * FORCES[number]:g}" for number in numbers]
    path.write_text("\n".join(["frame,force_N", *rows]) + "\n")
    return path


def reading(bundle: Bundle, number: int) -> Reading:
    """One of the example's pictures, read."""
    calibrated = calibrate_rest(bundle, read_image(REST))
    image = read_image(FRAMES / f"frame_{number:04d}.jpg")
    return read(calibrated, measure_frame(calibrated, image), "auto")


def test_a_stiffer_print_is_read_right_and_with_narrower_intervals(
    bundle: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mine"
    done = run(bundle, out, "--forces", str(table(tmp_path / "forces.csv")), "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["presses"] == 3
    assert facts["auto"]["stiffness"] == pytest.approx(STIFFER, rel=0.06)
    plain, calibrated = load_bundle(bundle), load_bundle(out)
    for number in (2, 3, 5):
        (before,), (after,) = (
            one.found.contacts for one in (reading(plain, number), reading(calibrated, number))
        )
        assert after.force_N == pytest.approx(STIFFER * FORCES[number], abs=1.96 * after.sd_N)
        assert after.force_N == pytest.approx(STIFFER * before.force_N, rel=0.08)
        assert after.sd_N / after.force_N < 0.8 * before.sd_N / before.force_N
        assert after.sd_N > 0.03 * after.force_N
    assert calibrated.notes["instance"]["presses"] == 3
    assert len(calibrated.learnt_rest_px) == 1


def test_other_prints_are_noticed(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    assert run(bundle, out, "--forces", str(table(tmp_path / "forces.csv"))).exit_code == 0
    calibrated = load_bundle(out)
    assert not calibrate_rest(calibrated, read_image(REST)).other_print_mm
    scatter = np.random.default_rng(0).normal(0.0, 1.0, calibrated.rest_px.shape)
    other = replace(calibrated, learnt_rest_px=calibrated.learnt_rest_px + scatter)
    assert calibrate_rest(other, read_image(REST)).other_print_mm > 0.0


def test_what_is_kept_can_be_imported_and_read_again(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    assert run(bundle, out, "--forces", str(table(tmp_path / "forces.csv"))).exit_code == 0
    done = import_rig(
        DESIGN,
        out / "presses.csv",
        frames=[out / "frames"],
        bundle=bundle,
        out=tmp_path / "data",
        rest=["rest"],
        progress=lambda _: None,
    )
    assert done.samples.count == 3
    np.testing.assert_allclose(done.samples.total_N, [STIFFER * FORCES[k] for k in (2, 3, 5)])
    again = run(
        bundle, tmp_path / "again", "--forces", str(out / "presses.csv"), source=out / "frames"
    )
    assert again.exit_code == 0, again.output
    for name in ("bundle.safetensors", "presses.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes()


def test_answers_are_typed_press_by_press(bundle: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    # The third answer is of a picture with two contacts; the press on the next is taken back.
    for name, number in enumerate((2, 4, 3, 3, 5)):
        shutil.copy(FRAMES / f"frame_{number:04d}.jpg", pictures / f"{name}.jpg")
    typed = ["7.2 N", "skip", "two", "9", "14", "undo", "1101 g", "14,4", "done", "5"]
    done = run(bundle, tmp_path / "mine", source=pictures, typed="\n".join(typed) + "\n")
    assert done.exit_code == 0, done.output
    assert "not taken: a force is a number" in done.stderr
    assert "not taken: 2 contacts are seen" in done.stderr
    proposals = re.findall(r"press (\d) of 10: (.*)", done.stderr)
    assert [number for number, _ in proposals] == list("122223234")
    assert proposals[1][1] != proposals[2][1]  # what is skipped is not proposed again
    rows = (tmp_path / "mine" / "presses.csv").read_text().splitlines()[1:]
    forces = [float(row.split(",")[-1]) for row in rows]
    assert forces == pytest.approx([7.2, 1.101 * 9.80665, 14.4], rel=1e-5)


def test_the_end_of_the_answers_keeps_what_there_is(bundle: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    shutil.copy(FRAMES / "frame_0003.jpg", pictures)
    done = run(bundle, tmp_path / "mine", source=pictures, typed="10.8\n")
    assert done.exit_code == 0, done.output
    assert "presses: 1," in done.stdout
    assert load_bundle(tmp_path / "mine").notes["instance"]["presses"] == 1


def test_it_stops_at_the_accuracy_asked_for(bundle: Path, tmp_path: Path) -> None:
    words = ("--forces", str(table(tmp_path / "forces.csv")))
    said = run(bundle, tmp_path / "all", *words).stderr
    stated = [float(text) for text in re.findall(r"± (\S+) %", said)]
    assert len(stated) == 3
    enough = f"{max(stated[:2]) + 0.1:.1f}"
    fewer = json.loads(
        run(bundle, tmp_path / "fewer", *words, "--accuracy", enough, "--json").stdout
    )
    assert fewer["presses"] in (1, 2)
    assert 100.0 * fewer["interval_share"] <= float(enough)
    one = json.loads(run(bundle, tmp_path / "one", *words, "--presses", "1", "--json").stdout)
    assert one["presses"] == 1


class Swinging(Source):
    """A camera before which a press alternates between two pictures."""

    live = True
    description, clock = "camera 0", "seconds"

    def __init__(self, *numbers: int) -> None:
        self.images = [read_image(FRAMES / f"frame_{number:04d}.jpg") for number in numbers]

    def __iter__(self) -> Iterator[Frame]:
        for number in range(100):
            image: ImageArray = self.images[number % len(self.images)]
            yield Frame(number=number, timestamp_s=number / 30, images=(image,), ready_s=0.0)

    def close(self) -> None:
        """Nothing to close."""


@pytest.mark.parametrize(("numbers", "steady"), [((1, 2), False), ((3, 3), True)])
def test_a_press_must_be_held(
    bundle: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    numbers: tuple[int, int],
    steady: bool,
) -> None:
    camera = Swinging(*numbers)
    monkeypatch.setattr(calibrate_instance_command, "open_frames", lambda *_, **__: camera)
    done = run(bundle, tmp_path / "mine", typed="9\n")
    assert (done.exit_code == 0) == steady, done.output
    assert ("hold still" in done.stderr) != steady


@pytest.mark.parametrize(
    ("forces", "said"),
    [
        ("4,9", "2 contacts are seen"),
        ("0,9", "no contacts are seen"),
        ("3,900", "the markers show"),
        ("3,0.9 kg?", "a force is a number"),
        ("77,9", "holds no picture"),
    ],
)
def test_presses_of_no_use_are_left_out(
    bundle: Path, tmp_path: Path, forces: str, said: str
) -> None:
    path = table(tmp_path / "forces.csv")
    path.write_text(path.read_text() + forces + "\n")
    done = run(bundle, tmp_path / "mine", "--forces", str(path))
    assert done.exit_code == 0, done.output
    assert f"not taken: {path}, line 5: " in done.stderr
    assert said in done.stderr
    assert "presses: 3," in done.stdout


def test_bad_input_is_refused(bundle: Path, tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    path.write_text("picture,force_N\n3,9\n")
    done = run(bundle, tmp_path / "mine", "--forces", str(path))
    assert done.exit_code != 0
    with refused("csv-columns"):
        raise done.exception
    path.write_text("frame,force_N\n4,9\n")
    with refused("no-presses"):
        raise run(bundle, tmp_path / "mine", "--forces", str(path)).exception
    other = tmp_path / "other"
    save_bundle(replace(load_bundle(bundle), design_hash="0"), other)
    with refused("decoder-of-other-design"):
        raise run(other, tmp_path / "mine", "--forces", str(path)).exception
    plain = load_bundle(bundle)
    save_bundle(replace(plain, model=replace(plain.model, locator=None)), other)
    with refused("decoder-without-tables"):
        raise run(other, tmp_path / "mine", "--forces", str(path)).exception
    assert not (tmp_path / "mine" / "bundle.json").exists()


def test_presses_of_another_run_are_not_lost(bundle: Path, tmp_path: Path) -> None:
    words = ("--forces", str(table(tmp_path / "forces.csv")))
    assert run(bundle, tmp_path / "mine", *words).exit_code == 0
    with refused("output-exists"):
        raise run(bundle, tmp_path / "mine", *words).exception
    mine = tmp_path / "mine"
    with refused("output-holds-source"):
        raise run(bundle, mine, *words, "--force", source=mine / "frames").exception
    fewer = table(tmp_path / "forces.csv", (3,))
    assert run(bundle, tmp_path / "mine", "--forces", str(fewer), "--force").exit_code == 0
    kept = sorted(path.name for path in (tmp_path / "mine" / "frames").iterdir())
    assert kept == ["press_001.png", "rest.png"]


@pytest.mark.parametrize(
    ("text", "expected_N"),
    [("9", 9.0), (" 9.5 N ", 9.5), ("0,5kg", 4.903325), ("850 g", 8.3356525), ("2 lb", 8.896444)],
)
def test_readings_of_scales(text: str, expected_N: float) -> None:
    assert newtons(text) == pytest.approx(expected_N)


@pytest.mark.parametrize("text", ["", "0", "-3", "nine", "9 mm", "1.2.3", "1e3"])
def test_what_is_no_force(text: str) -> None:
    with refused("force-invalid"):
        newtons(text)


def test_proposed_presses_leave_less_variance_than_random_ones(bundle: Path) -> None:
    locator = load_bundle(bundle).model.locator
    assert locator is not None
    places = locator.places
    targets = places.point_mm[usable_places(places)]

    def left(pressed: np.ndarray) -> float:
        return float(np.diagonal(remaining_variance(places, targets, pressed)).mean())

    pressed = np.zeros((0, 3))
    assert left(pressed) == pytest.approx(LOCATOR.stiffness_sd**2)
    before = np.inf
    for _ in range(6):
        pressed = np.append(pressed, next_place(places, pressed)[None], axis=0)
        assert left(pressed) < before
        before = left(pressed)
    rng = np.random.default_rng(0)
    draws = [left(rng.permutation(targets)[:6]) for _ in range(20)]
    assert before < min(draws)
    gap = np.linalg.norm(pressed[:, None] - pressed[None], axis=2) + 1e9 * np.eye(6)
    assert gap.min() > places.radius_mm
    signal = np.linalg.norm(places.shift_px[:, 0], axis=1)
    assert signal[places.nearest(pressed)].min() >= 0.5 * np.median(signal)


def test_the_spread_that_few_contacts_show() -> None:
    prior, _ = SETTINGS.spread_prior
    exact = [spread_of_few(0.01, np.full(count, 0.005)) for count in (1, 3, 10, 100, 10000)]
    assert exact == sorted(exact, reverse=True)
    assert exact[-1] == pytest.approx(0.01, rel=0.01)
    assert prior < exact[0] < LOCATOR.stiffness_sd
    # Of one contact whose own force is not known, nothing is learnt.
    assert spread_of_few(0.0, np.array([1.0])) == LOCATOR.stiffness_sd
    # The error of the common factor is that of the mean of two forces; 1.181 widens a normal
    # distribution to the 90 % interval of Student's with six degrees of freedom.
    two = spread_of_few(prior, np.full(2, 0.04))
    assert two == pytest.approx(1.181 * np.sqrt(prior**2 + (prior**2 + 0.04**2) / 2.0), rel=1e-3)
