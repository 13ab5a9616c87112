"""``phytac calibrate-instance``: a print's decoder from a few presses on a scale.

The pictures are those of the example rig, a sensor as designed. A print that is 1.2 times as stiff
shows the same pictures under forces that are 1.2 times as large.
"""

import json
import re
from collections.abc import Callable, Iterator
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
from phytac_design.layout.sensor import Sensor
from phytac_design.training import locator_calibration
from phytac_design.training.locator_calibration import SETTINGS, spread_with_prior
from phytac_design.training.press_places import (
    next_press,
    pressable_receptors,
    remaining_covariance,
)
from phytac_design.workflows import calibrate_instance
from phytac_design.workflows.calibrate_instance import (
    InstanceCalibration,
    known_press,
    press_samples,
)
from phytac_design.workflows.import_rig import import_rig
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
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
    done = run(bundle, out, "--table", str(table(tmp_path / "forces.csv")), "--json")
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


def few_show_the_wall(monkeypatch: pytest.MonkeyPatch, solver: Callable[..., None]) -> None:
    """Three presses are enough for the thickness of the wall, which ``solver`` is asked for."""
    for module in (calibrate_instance, locator_calibration):
        monkeypatch.setattr(module, "UNEVEN", replace(module.UNEVEN, blocks_min=3))
    monkeypatch.setattr(calibrate_instance, "designed_wall", solver)


def test_the_wall_is_fitted_once_at_the_end(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    few_show_the_wall(monkeypatch, lambda design, _: asked.append(design.name))
    few = run(bundle, tmp_path / "few", "--table", str(table(tmp_path / "two.csv", (2, 3))))
    assert few.exit_code == 0, few.output
    assert not asked
    assert "the thickness of the wall" not in few.output
    enough = run(bundle, tmp_path / "enough", "--table", str(table(tmp_path / "three.csv")))
    assert enough.exit_code == 0, enough.output
    assert asked == [DESIGN.name]
    assert "the thickness of the wall" in enough.output


def test_stopping_leaves_the_wall_out_and_keeps_the_presses(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    few_show_the_wall(monkeypatch, stop)
    done = run(bundle, tmp_path / "mine", "--table", str(table(tmp_path / "forces.csv")), "--json")
    assert done.exit_code == 0, done.output
    assert "stopped: the wall is taken as even" in done.stderr
    facts = json.loads(done.stdout)
    assert facts["presses"] == 3
    assert facts["auto"]["wall"] == {"even": "not fitted"}
    assert facts["auto"]["stiffness"] == pytest.approx(STIFFER, rel=0.06)


@pytest.mark.parametrize(
    "error", [DesignError("stage-died", "the stage died"), OSError("disk full"), MemoryError()]
)
def test_a_wall_that_cannot_be_fitted_loses_no_press(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def broken(*_: object) -> None:
        raise error

    few_show_the_wall(monkeypatch, broken)
    done = run(bundle, tmp_path / "mine", "--table", str(table(tmp_path / "forces.csv")))
    assert done.exit_code == 0, done.output
    assert f"warning: the wall is taken as even: {error or 'MemoryError'}" in done.stderr
    assert load_bundle(tmp_path / "mine").notes["instance"]["presses"] == 3


def test_the_wall_of_the_design_is_at_hand(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sensor of the pictures is even: presses on it show no other thickness."""
    few_show_the_wall(monkeypatch, calibrate_instance.designed_wall)
    done = run(bundle, tmp_path / "mine", "--table", str(table(tmp_path / "forces.csv")), "--json")
    assert done.exit_code == 0, done.output
    wall = json.loads(done.stdout)["auto"]["wall"]
    assert "even" in wall or 0.95 < wall["thinnest"] < wall["thickest"] < 1.05
    found = calibrate_instance.designed_wall(DESIGN, lambda _: None)
    assert found is not None
    assert len(found.see.slope) == load_bundle(bundle).rest_px.shape[0]


def test_other_prints_are_noticed(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    assert run(bundle, out, "--table", str(table(tmp_path / "forces.csv"))).exit_code == 0
    calibrated = load_bundle(out)
    assert not calibrate_rest(calibrated, read_image(REST)).other_print_mm
    scatter = np.random.default_rng(0).normal(0.0, 1.0, calibrated.rest_px.shape)
    other = replace(calibrated, learnt_rest_px=calibrated.learnt_rest_px + scatter)
    assert calibrate_rest(other, read_image(REST)).other_print_mm > 0.0


def test_what_is_kept_can_be_imported_and_read_again(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    assert run(bundle, out, "--table", str(table(tmp_path / "forces.csv"))).exit_code == 0
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
        bundle, tmp_path / "again", "--table", str(out / "presses.csv"), source=out / "frames"
    )
    assert again.exit_code == 0, again.output
    for name in ("bundle.safetensors", "presses.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes()


class FakeCamera(Source):
    """A camera before which one press after the other is held: each by the pictures it shows."""

    live = True
    description, clock = "camera 0", "seconds"

    def __init__(self, *presses: tuple[int, ...]) -> None:
        self.presses = list(presses)

    def __iter__(self) -> Iterator[Frame]:
        shown = self.presses.pop(0)
        images = [read_image(FRAMES / f"frame_{number:04d}.jpg") for number in shown]
        for number in range(10 if shown else 0):
            image = images[number % len(images)]
            yield Frame(number=number, timestamp_s=number / 30, images=(image,), ready_s=0.0)

    def close(self) -> None:
        """Nothing to close."""


Typed = Callable[..., Result]


@pytest.fixture
def typed(bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Typed:
    """Run the command with a camera before which presses are held, and typed answers."""

    def run_typed(
        presses: list[tuple[int, ...]], *answers: str, words: tuple[str, ...] = ()
    ) -> Result:
        camera = FakeCamera(*presses)
        monkeypatch.setattr(calibrate_instance_command, "open_frames", lambda *_, **__: camera)
        answers = tuple(f"{answer}\n" for answer in answers)
        return run(bundle, tmp_path / "mine", *words, source=Path("0"), typed="".join(answers))

    return run_typed


def forces_kept(out: Path) -> list[float]:
    """Forces of the presses that a folder holds."""
    rows = (out / "presses.csv").read_text().splitlines()[1:]
    return [float(row.split(",")[-1]) for row in rows]


def test_answers_are_typed_press_by_press(typed: Typed, tmp_path: Path) -> None:
    # The second press is of two pads, the third is taken back, the fourth has no picture.
    presses = [(2,), (4,), (3,), (), (3,), (5,)]
    answers = ["", "7.2 N", "skip", "what?", "", "9", "", "14", "undo", "", "", "1101 g"]
    done = typed(presses, *answers, "", "14,4", "done", "", "5")
    assert done.exit_code == 0, done.output
    assert "not taken: 2 contacts are seen" in done.stderr
    assert "not taken: the camera gives no picture" in done.stderr
    assert "or type skip, undo or done" in done.stderr
    proposals = re.findall(r"press (\d) of 10: (.*)", done.stderr)
    assert [number for number, _ in proposals] == list("1222232234")
    assert proposals[1][1] != proposals[2][1]  # what is skipped is not proposed again
    expected = [7.2, 1.101 * 9.80665, 14.4]
    assert forces_kept(tmp_path / "mine") == pytest.approx(expected, rel=1e-5)
    assert re.search(r"press 1: 7.20 N at receptor \d+ .*, read as 6.55 N by design", done.stderr)
    pictures = sorted(path.name for path in (tmp_path / "mine" / "frames").iterdir())
    assert pictures == [*(f"press_{number:03d}.png" for number in (1, 2, 3)), "rest.png"]
    assert not done.stdout.startswith(" ")


def test_the_end_of_the_answers_keeps_what_there_is(
    typed: Typed, bundle: Path, tmp_path: Path
) -> None:
    done = typed([(3,), (5,)], "", "10.8", "")
    assert done.exit_code == 0, done.output
    assert "presses: 1;" in done.stdout
    assert load_bundle(tmp_path / "mine").notes["instance"]["presses"] == 1


def test_words_in_place_of_a_force(typed: Typed, tmp_path: Path) -> None:
    done = typed([(3,), (3,), (5,), (5,)], "", "skip", "", "10.8", "", "undo", "", "done")
    assert re.findall(r"press (\d) of 10", done.stderr) == list("1121")
    assert "presses so far: 0" in done.stderr
    with refused("no-presses"):
        raise done.exception


def test_the_folder_of_the_result_may_be_that_of_the_shell(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera's number is no path below it."""
    monkeypatch.chdir(tmp_path)
    camera = FakeCamera((3,), (3,))
    monkeypatch.setattr(calibrate_instance_command, "open_frames", lambda *_, **__: camera)
    done = run(bundle, Path(), source=Path("0"), typed="\n10.8\ndone\n")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "bundle.json").is_file()


def test_undo_before_and_after_the_only_press(typed: Typed, tmp_path: Path) -> None:
    with refused("no-presses"):
        raise typed([(3,)], "undo", "", "10.8", "undo", "undo", "done").exception
    assert not (tmp_path / "mine" / "presses.csv").exists()
    again = typed([(3,)], "", "10.8", "done")
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize(("shown", "steady"), [((1, 2), False), ((3,), True)])
def test_a_press_must_be_held(typed: Typed, shown: tuple[int, ...], steady: bool) -> None:
    done = typed([shown], "", "9")
    assert (done.exit_code == 0) == steady, done.output
    assert ("hold still" in done.stderr) != steady


def test_ctrl_c_keeps_what_there_is(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(InstanceCalibration, "undo", stop)
    done = typed([(3,)], "", "10.8", "undo", "", "5")
    assert done.exit_code == 0, done.output
    assert forces_kept(tmp_path / "mine") == [10.8]
    assert (tmp_path / "mine" / "bundle.json").exists()


def test_ctrl_c_at_a_question_does_not_fit_the_wall(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["", "10.8"])

    def answer() -> str:
        for text in answers:
            return text
        raise KeyboardInterrupt

    few_show_the_wall(monkeypatch, lambda *_: pytest.fail("fitted"))
    for module in (calibrate_instance, locator_calibration):
        monkeypatch.setattr(module, "UNEVEN", replace(module.UNEVEN, blocks_min=1))
    monkeypatch.setattr("builtins.input", answer)
    done = typed([(3,)])
    assert done.exit_code == 0, done.output
    assert "stopped" in done.stderr
    assert forces_kept(tmp_path / "mine") == [10.8]


def test_it_stops_at_the_accuracy_asked_for(typed: Typed) -> None:
    presses, answers = (
        [(2,), (3,), (5,), (3,), (5,)],
        ["", "7.2", "", "10.8", "", "14.4", "", "10.8"],
    )
    done = typed(presses, *answers, words=("--accuracy", "90", "--json"))
    assert json.loads(done.stdout)["presses"] == 3  # the least
    stated = [float(text) for text in re.findall(r"± (\S+) % \(95 %\)", done.stderr)]
    assert len(stated) == 4
    assert stated[0] == 22.0  # by design
    enough = f"{stated[-1] - 1.0:.1f}"
    done = typed(presses, *answers, words=("--accuracy", enough, "--json", "--force"))
    facts = json.loads(done.stdout)
    assert facts["presses"] == 4
    done = typed(presses, *answers, words=("--presses", "1", "--json", "--force"))
    assert json.loads(done.stdout)["presses"] == 1


def test_all_rows_of_a_table_are_taken_unless_fewer_are_asked_for(
    bundle: Path, tmp_path: Path
) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")), "--presses", "2", "--json")
    done = run(bundle, tmp_path / "mine", *words)
    assert json.loads(done.stdout)["presses"] == 2
    assert "rows that are not needed: 1" in done.stderr


@pytest.mark.parametrize(
    ("forces", "said"),
    [
        ("4,9", "2 contacts are seen"),
        ("0,9", "no contact is seen"),
        ("1,3.6", "with a standard deviation of"),
        ("3,900", "the markers show"),
        ("3,0.9 kg?", "a force is a number"),
        ("77,9", "holds no picture"),
    ],
)
def test_presses_of_no_use_are_left_out(
    bundle: Path, tmp_path: Path, forces: str, said: str
) -> None:
    path = table(tmp_path / "forces.csv", (2, 5))
    path.write_text(path.read_text() + forces + "\n")
    done = run(bundle, tmp_path / "mine", "--table", str(path))
    assert done.exit_code == 0, done.output
    assert f"not taken: {path}, line 4: " in done.stderr
    assert said in done.stderr
    assert "presses: 2;" in done.stdout


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("picture,force_N\n3,9\n", "csv-columns"),
        ("frame;force_N\n3;9\n", "csv-columns"),
        ("frame,force_N\n3,10,8\n", "csv-row-length"),
        ("frame,force_N\n3,9\n5,12\n3,9\n", "frame-twice"),
        ("frame,force_N\n3,9\nframe_0003,9\n", "frame-twice"),
        ("frame,force_N\n4,9\n", "no-presses"),
        ("frame,force_N\n", "csv-empty"),
        (None, "file-unreadable"),
    ],
)
def test_tables_that_are_refused(bundle: Path, tmp_path: Path, text: str | None, code: str) -> None:
    path = tmp_path / "forces.csv"
    if text is not None:
        path.write_text(text)
    with refused(code):
        raise run(bundle, tmp_path / "mine", "--table", str(path)).exception
    assert not (tmp_path / "mine" / "bundle.json").exists()


def test_tables_as_spreadsheets_write_them(bundle: Path, tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    path.write_bytes(b"\xef\xbb\xbfframe,force_N\r\n# a note\r\nframe_0003,1101 g\r\n5,oops\r\n")
    done = run(bundle, tmp_path / "mine", "--table", str(path))
    assert done.exit_code == 0, done.output
    assert forces_kept(tmp_path / "mine") == pytest.approx([1.101 * 9.80665], rel=1e-5)
    assert f"{path}, line 4: " in done.stderr


def test_decoders_that_cannot_be_calibrated(bundle: Path, tmp_path: Path) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")))
    plain, other = load_bundle(bundle), tmp_path / "other"
    dark = replace(plain.tips, red_on_px=plain.tips.red_rest_px)
    for changed, code in (
        (replace(plain, design_hash="0"), "decoder-of-other-design"),
        (replace(plain, model=replace(plain.model, locator=None)), "decoder-without-tables"),
        (replace(plain, tips=dark), "training-without-switches"),
    ):
        save_bundle(changed, other)
        with refused(code):
            raise run(other, tmp_path / "mine", *words).exception
    assert run(bundle, tmp_path / "mine", *words).exit_code == 0
    with refused("decoder-already-trained"):
        raise run(tmp_path / "mine", tmp_path / "again", *words).exception
    with refused("output-holds-source"):
        raise run(bundle, bundle, *words, "--force").exception


def test_sources_and_rest_frames_that_are_refused(bundle: Path, tmp_path: Path) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")))
    fixed = ["calibrate-instance", str(EXAMPLE / "rig.toml"), str(bundle), str(FRAMES)]
    fixed += ["--out", str(tmp_path / "mine")]
    for more, code in (
        (words, "rest-frame-missing"),
        ((*words, "--rest", str(REST), "--rest-first", "3"), "rest-options-exclusive"),
        ((*words, "--rest", str(FRAMES / "frame_0003.jpg")), "rest-frame-pressed"),
        (("--rest", str(REST)), "source-not-live"),
        ((str(FRAMES), *words, "--rest", str(REST)), "camera-count"),
    ):
        with refused(code):
            raise CliRunner().invoke(app, [*fixed, *more]).exception


def test_presses_that_contradict_are_reported(bundle: Path, tmp_path: Path) -> None:
    path = table(tmp_path / "forces.csv", (3, 5), factor=1.0)
    path.write_text(path.read_text() + "2,9\n")
    done = run(bundle, tmp_path / "odd", "--table", str(path), "--json")
    assert "by press 3 the print is 1.37 times as stiff" in done.stderr
    odd = json.loads(done.stdout)
    assert len(odd["doubts"]) == 1
    path = table(tmp_path / "forces.csv", factor=1.0)
    even = json.loads(run(bundle, tmp_path / "even", "--table", str(path), "--json").stdout)
    assert not even["doubts"]
    assert odd["auto"]["spread_share"] > 1.3 * even["auto"]["spread_share"]
    assert odd["interval_share"] > even["interval_share"]
    path = table(tmp_path / "forces.csv", factor=1.6)
    soft = run(bundle, tmp_path / "soft", "--table", str(path))
    assert "more than prints differ" in soft.stderr


def test_the_radius_of_presses_is_unknown_and_their_place_is_where_they_are_seen(
    bundle: Path,
) -> None:
    calibrated = calibrate_rest(load_bundle(bundle), read_image(REST))
    images = {number: read_image(FRAMES / f"frame_{number:04d}.jpg") for number in (3, 5)}
    presses = [
        known_press(calibrated, measure_frame(calibrated, image), FORCES[number])
        for number, image in images.items()
    ]
    samples = press_samples(Sensor(DESIGN), calibrated, presses)
    assert samples.touches is not None
    assert not samples.touches.radius_mm.any()
    places = [press.contact.point_mm for press in presses]
    np.testing.assert_allclose(samples.touches.point_mm, places, atol=0.1)
    assert samples.truth is not None
    assert set(samples.truth.touch.tolist()) == {0, 1}


def test_few_presses_keep_the_noise_of_the_design(bundle: Path, tmp_path: Path) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")))
    assert run(bundle, tmp_path / "mine", *words).exit_code == 0
    before, after = (load_bundle(folder).model.locator for folder in (bundle, tmp_path / "mine"))
    assert before is not None
    assert after is not None
    assert not after.noise.fitted
    np.testing.assert_array_equal(after.noise.each_px, before.noise.each_px)
    limits = load_bundle(tmp_path / "mine").limits("auto")
    assert any("build with --accuracy standard" in limit for limit in limits)


def test_a_turned_shell_is_refused(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its places would be those of the shell, and nothing would say so later."""
    monkeypatch.setattr(
        calibrate_instance,
        "calibrate_rest",
        lambda *words: replace(calibrate_rest(*words), turned_deg=60.0),
    )
    words = ("--table", str(table(tmp_path / "forces.csv")))
    with refused("shell-turned"):
        raise run(bundle, tmp_path / "mine", *words).exception


def test_few_presses_keep_the_error_of_linear_tables(bundle: Path, tmp_path: Path) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")))
    assert run(bundle, tmp_path / "mine", *words).exit_code == 0
    for folder in (bundle, tmp_path / "mine"):
        locator = load_bundle(folder).model.locator
        assert locator is not None
        assert locator.linear_error > 0.0
        assert locator.as_if_linear


def test_presses_of_another_run_are_not_lost(bundle: Path, tmp_path: Path) -> None:
    words = ("--table", str(table(tmp_path / "forces.csv")))
    assert run(bundle, tmp_path / "mine", *words).exit_code == 0
    with refused("output-exists"):
        raise run(bundle, tmp_path / "mine", *words).exception
    mine = tmp_path / "mine"
    with refused("output-holds-source"):
        raise run(bundle, mine, *words, "--force", source=mine / "frames").exception
    fewer = table(tmp_path / "forces.csv", (3,))
    assert run(bundle, tmp_path / "mine", "--table", str(fewer), "--force").exit_code == 0
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
    decoder = load_bundle(bundle)
    locator = decoder.model.locator
    assert locator is not None
    places = locator.places
    receptors = pressable_receptors(decoder, locator)
    targets = decoder.position_mm[receptors]
    radius_mm = places.radius_mm

    def left(pressed: FloatArray) -> float:
        whole = remaining_covariance(targets, pressed, radius_mm=radius_mm)
        return float(np.diagonal(whole).mean())

    pressed = np.zeros((0, 3))
    assert left(pressed) == pytest.approx(LOCATOR.stiffness_sd**2)
    before = np.inf
    for _ in range(5):
        chosen = next_press(targets, pressed, radius_mm=radius_mm)
        pressed = np.append(pressed, targets[chosen][None], axis=0)
        assert left(pressed) < before
        before = left(pressed)
    rng = np.random.default_rng(0)
    draws = [left(rng.permutation(targets)[:5]) for _ in range(20)]
    assert before < min(draws)
    gap = np.linalg.norm(pressed[:, None] - pressed[None], axis=2) + 1e9 * np.eye(5)
    assert gap.min() > radius_mm


def test_receptors_that_cannot_be_read_or_stand_at_rims_are_not_proposed(bundle: Path) -> None:
    decoder = load_bundle(bundle)
    locator = decoder.model.locator
    assert locator is not None
    receptors = pressable_receptors(decoder, locator)
    signal = np.linalg.norm(locator.places.shift_px[:, 0], axis=1)
    near = locator.places.nearest(decoder.position_mm)
    assert 0 < len(receptors) < len(decoder.colour)
    assert signal[near[receptors]].min() >= 0.5 * np.median(signal[near])
    blind = replace(locator, blind=receptors[:2])
    np.testing.assert_array_equal(pressable_receptors(decoder, blind), receptors[2:])
    scene = replace(decoder, notes={"scene": {"in_play": receptors[3:].tolist()}})
    np.testing.assert_array_equal(pressable_receptors(scene, locator), receptors[3:])


def spread(error: float, sd: float, count: int, *, presses: int | None = None) -> float:
    """Spread by contacts that are all alike, of so many presses."""
    block = np.arange(count) % (presses or count)
    return spread_with_prior(np.full(count, error), np.full(count, sd), block)


def test_the_spread_that_few_contacts_show() -> None:
    prior, _ = SETTINGS.spread_prior
    each = [spread(0.01, 0.001, count) for count in (1, 3, 10, 100, 10000)]
    assert each == sorted(each, reverse=True)
    assert each[-1] == pytest.approx(0.01, rel=0.01)
    assert prior < each[0] < LOCATOR.stiffness_sd
    # Frames of one press count once.
    assert spread(0.01, 0.001, 300, presses=10) == pytest.approx(spread(0.01, 0.001, 10))
    # Contacts whose own force is hardly known say nothing of the spread, and little of the factor.
    unknown = spread(0.0, 1.0, 1)
    assert unknown > LOCATOR.stiffness_sd
    assert spread(0.0, 0.3, 9) > prior
    # Contradictory presses are not taken for a print as any other.
    assert spread(0.4, 0.01, 10) > 0.3
    # Without noise it is the quantile of Student's distribution, and the factor's error besides.
    for square, found in (
        (1.5 * prior**2, spread(prior, 1e-9, 3)),  # of three errors about their own factor
        (0.0, spread_with_prior(np.ones(3), np.full(3, 1e-9), np.arange(3), known=0.0)),
    ):
        share = 1.895 / 1.645 * np.sqrt((4.0 * prior**2 + 3.0 * square) / 7.0)
        factor = 1.0 / (3.0 / (np.pi / 2.0 * share**2) + 1.0 / LOCATOR.stiffness_sd**2)
        assert found == pytest.approx(np.sqrt(share**2 + factor), rel=2e-3)
    # What the errors hold of noise is no spread.
    assert spread(0.05, 0.04, 9) < 0.9 * spread(0.05, 0.001, 9)
    # A narrower prior, as of a print whose wall was found, makes it narrower.
    own, one = SETTINGS.spread_own_wall, np.array([0.01])
    assert own < spread_with_prior(one, 0.1 * one, np.arange(1), prior=own) < each[0]
    # A spread that was fitted counts as such.
    fitted = spread_with_prior(np.zeros(400), np.full(400, 0.001), np.arange(400), known=0.05)
    assert fitted == pytest.approx(0.05, rel=0.02)


def test_intervals_hold_what_they_state_for_prints_that_scatter_as_the_prior() -> None:
    prior, count = SETTINGS.spread_prior[0], 3
    rng, inside = np.random.default_rng(0), []
    for _ in range(1000):
        log = rng.normal(rng.normal(0.0, LOCATOR.stiffness_sd), prior, count + 1)
        error = log[:count] - np.median(log[:count])
        share = spread_with_prior(error, np.full(count, 0.005), np.arange(count))
        inside.append(abs(log[-1] - np.median(log[:count])) <= 1.645 * share)
    assert 0.88 <= np.mean(inside) <= 0.95
