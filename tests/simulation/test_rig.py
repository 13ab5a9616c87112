"""``phytac import``: a made-up rig in, a data set out; all that is wrong is reported at once."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from phytac_decoder.estimation.cascade_network import CascadeNetwork, parameter_count
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_design.cli.import_command import import_
from phytac_design.datasets.samples import REAL, Samples
from phytac_design.datasets.samples_file import read_samples
from phytac_design.design.camera_files import write_lens
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.simulation.rig_import.rig_samples import REASONS
from phytac_design.stages.build import build
from phytac_design.training import levenberg_marquardt
from phytac_design.training.levenberg_marquardt import TrainedNetwork
from phytac_design.training.training_data import DataSet, check_inputs
from phytac_design.workflows.import_rig import (
    ImportResult,
    ImportSettings,
    import_rig,
    lens_difference_px,
)
from phytac_shapes.errors import InputError
from tests.refusals import refused

EXAMPLE = Path(__file__).parents[2] / "examples" / "rig"
DESIGN = load_design(str(EXAMPLE / "rig.toml"))
LOG = (EXAMPLE / "log.csv").read_text()
HEAD = LOG.splitlines()[2]
ROWS = LOG.splitlines()[3:]
Import = Callable[..., ImportResult]


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's decoder, without what takes long and is not used here: pictures, training."""
    out = tmp_path_factory.mktemp("rig") / "rig"
    nothing = TrainedNetwork(
        network=CascadeNetwork(
            parameters=np.zeros(parameter_count()),
            activation="identity",
            scale_in=np.ones(10),
            scale_out=1.0,
        ),
        seconds=0.0,
        rounds=0,
        rmse_train_N=0.0,
        rmse_validation_N=0.0,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(levenberg_marquardt, "train_network", lambda *_, **__: nothing)
        build(DESIGN, out, accuracy="draft", only=["decoder"], progress=lambda _: None)
    return out / "decoder"


@pytest.fixture
def bring(bundle: Path, tmp_path: Path) -> Import:
    """Import a changed example, of which only the changes are given."""

    def run(
        log: str = LOG,
        frames: Path = EXAMPLE / "frames",
        *,
        rest: str = "0",
        cameras: tuple[Path, ...] = (),
        said: list[str] | None = None,
        **settings: object,
    ) -> ImportResult:
        path = tmp_path / "log.csv"
        path.write_text(log)
        return import_rig(
            DESIGN,
            path,
            frames=[frames],
            bundle=bundle,
            out=tmp_path / "data",
            rest=[rest],
            cameras=cameras,
            settings=ImportSettings(**settings),
            progress=(said if said is not None else []).append,
        )

    return run


def log_of(rows: list[str], head: str = HEAD) -> str:
    return "\n".join([head, *rows]) + "\n"


def test_the_example_from_end_to_end(bundle: Path, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(import_)
    words = [str(EXAMPLE / "rig.toml"), str(EXAMPLE / "log.csv"), "--frames"]
    words += [str(EXAMPLE / "frames"), "--rest", "0", "--bundle", str(bundle)]
    words += ["--out", str(tmp_path / "data"), "--keep", "frames"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "5 samples (0 flagged), 6 contacts" in done.output
    hash_ = design_hash(DESIGN)
    samples, meta = read_samples(tmp_path / "data", expect_design_hash=hash_, check_frames=True)
    assert not meta.simulated
    assert meta.what == "measured: 5 samples of a rig with rig"
    assert meta.route == "camera"
    assert sorted(meta.hashes) == ["bundle", "log"]
    assert "MADE UP" in meta.notes["log_says"][0]
    for number in range(5):
        kept = tmp_path / "data" / "frames" / f"{number:06d}.jpg"
        assert kept.read_bytes() == (EXAMPLE / f"frames/frame_{number + 1:04d}.jpg").read_bytes()
    assert samples.count == 5
    np.testing.assert_array_equal(samples.status, 0)
    np.testing.assert_array_equal(samples.theory, REAL)
    np.testing.assert_allclose(samples.time_s, [0.0, 2.5, 5.0, 7.5, 10.0])
    # The second press is the first one, harder.
    np.testing.assert_array_equal(samples.sequence, [0, 0, 1, 2, 3])
    np.testing.assert_array_equal(samples.contacts, [1, 1, 1, 2, 1])
    np.testing.assert_allclose(samples.total_N, [3.0, 6.0, 9.0, 12.5, 12.0])
    check_truth(samples)
    check_forces(samples, load_bundle(bundle))


def check_truth(samples: Samples) -> None:
    """Where all switches are read right, the truth per receptor is the simulation's."""
    surface = DESIGN.surface()
    markers = make_markers(DESIGN, surface)
    touches, truth = samples.touches, samples.truth
    assert touches is not None
    assert truth is not None
    twin = switch_states(
        Sensor.of(DESIGN, surface, markers),
        Contacts.flat(
            sample=touches.sample,
            uv=touches.uv,
            radius_mm=touches.radius_mm,
            force_N=touches.force_N,
            samples=5,
        ),
    )
    np.testing.assert_array_equal(samples.bits, twin.bits)
    np.testing.assert_array_equal(samples.bits_read, twin.bits)
    np.testing.assert_array_equal(truth.touch, twin.owner[truth.sample, truth.marker])
    np.testing.assert_allclose(truth.force_N, twin.receptor_force_N[twin.bits], rtol=1e-6)
    each = np.bincount(truth.touch, weights=truth.force_N)
    np.testing.assert_allclose(each, touches.force_N)


def check_forces(samples: Samples, decoder: Bundle) -> None:
    """Decoded totals are near the log's: the pictures are matched to their rows."""
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    total = [
        decoder.model.forces("koi_inverse", shift, np.flatnonzero(bits)).sum()
        for shift, bits in zip(samples.shift_px, samples.bits_read, strict=True)
    ]
    np.testing.assert_allclose(total, samples.total_N, rtol=0.45)
    assert np.corrcoef(total, samples.total_N)[0, 1] > 0.95


def test_inputs_alone(bring: Import, bundle: Path, tmp_path: Path) -> None:
    whole = bring().samples
    shutil.rmtree(tmp_path / "data")
    samples = bring(keep="inputs").samples
    got, _ = read_samples(tmp_path / "data")
    assert got.key_nodes is not None
    assert got.shift_px is None
    assert whole.truth is not None
    np.testing.assert_array_equal(got.key_nodes.marker, whole.truth.marker)
    np.testing.assert_allclose(got.key_nodes.force_N, whole.truth.force_N, atol=5e-4)
    assert samples.key_nodes is not None
    assert got.key_nodes.inputs_mm.shape == (len(whole.truth.marker), 10)
    # They go with the mechanics that made them, whatever those were called.
    read, meta = read_samples(tmp_path / "data")
    item = DataSet(folder=tmp_path / "data", samples=read, meta=meta, sha256="")
    model = load_bundle(bundle).model
    check_inputs(item, model, "draft")
    with refused("inputs-other-decoder"):
        check_inputs(item, replace(model, stiffness=1.02 * model.stiffness), "draft")
    silent = replace(item, meta=replace(meta, notes={}))
    with refused("inputs-other-decoder"):
        check_inputs(silent, model, "draft")


def test_a_video_gives_what_its_images_give(bring: Import, tmp_path: Path) -> None:
    expected = bring().samples
    shutil.rmtree(tmp_path / "data")
    video = tmp_path / "rig.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"FFV1"), 4.0, (640, 480))
    order = [0, 0, 1, 1, 2, 3, 3, 4, 5, 5]
    for number in order:
        writer.write(cv2.imread(str(EXAMPLE / f"frames/frame_{number:04d}.jpg")))
    writer.release()
    # Frames at 0, 0.25, … s; the log's clock is 100 s ahead and a little off.
    first = {number: order.index(number) / 4.0 for number in range(1, 6)}
    rows = []
    for row in ROWS:
        cells = row.split(",")
        time = f"{100.02 + first[int(cells[0])]:.3f}"
        rows.append(",".join([cells[0], time, *cells[3:]]))
    log = log_of(rows, HEAD.replace("frame,", ""))
    got = bring(log, video, offset_s=-100.0, keep="frames").samples
    np.testing.assert_array_equal(got.bits_read, expected.bits_read)
    assert got.shift_px is not None
    assert expected.shift_px is not None
    np.testing.assert_array_equal(got.shift_px, expected.shift_px)
    kept = cv2.imread(str(tmp_path / "data" / "frames" / "000000.png"))
    assert kept.shape == (480, 640, 3)
    with refused("rig-clocks-differ") as caught:
        import_again(bring, tmp_path, log, video)
    caught.match("--offset-s")


def import_again(bring: Import, folder: Path, *words: object, **settings: object) -> ImportResult:
    shutil.rmtree(folder / "data", ignore_errors=True)
    return bring(*words, **settings)


def test_two_readings_of_a_place_without_radius(bring: Import) -> None:
    rows = [row.rpartition(",")[0] for row in ROWS]
    done = bring(log_of(rows, HEAD.replace(",radius_mm", "")), radius_mm=4.5)
    assert done.meta.notes["radius_assumed_mm"] == 4.5
    assert done.samples.touches is not None
    np.testing.assert_array_equal(done.samples.touches.radius_mm, 4.5)


def test_frames_that_show_no_sensor(bring: Import, tmp_path: Path) -> None:
    """They are reported with line and name, and left out with --skip-bad."""
    frames = tmp_path / "frames"
    shutil.copytree(EXAMPLE / "frames", frames)
    cv2.imwrite(str(frames / "frame_0003.jpg"), np.zeros((480, 640, 3), np.uint8))
    (frames / "frame_0005.jpg").write_bytes(b"no image")
    with refused("rig-rows-invalid") as caught:
        bring(frames=frames)
    caught.match("line 6: frame 'frame_0003.jpg'")
    assert not (tmp_path / "data").exists()
    done = bring(frames=frames, skip_bad=True, keep="frames")
    assert (done.samples.count, done.left_out) == (3, 2)
    kept = tmp_path / "data" / "frames" / "000002.jpg"
    assert kept.read_bytes() == (frames / "frame_0004.jpg").read_bytes()
    assert "line 9" in done.problems.text()
    np.testing.assert_allclose(done.samples.total_N, [3.0, 6.0, 12.5])
    np.testing.assert_array_equal(done.samples.contacts, [1, 1, 2])
    assert done.meta.notes["left_out"] == 2
    check_truth_sums(done.samples)


def check_truth_sums(samples: Samples) -> None:
    assert samples.truth is not None
    assert samples.touches is not None
    each = np.bincount(samples.truth.touch, weights=samples.truth.force_N)
    np.testing.assert_allclose(each, samples.touches.force_N)


def test_frames_of_another_camera_mode(bring: Import, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for item in sorted((EXAMPLE / "frames").iterdir()):
        cv2.imwrite(str(frames / item.name), cv2.resize(cv2.imread(str(item)), (320, 240)))
    with refused("frame-size"):
        bring(frames=frames, rest=str(EXAMPLE / "frames" / "frame_0000.jpg"), skip_bad=True)


def test_a_log_that_contradicts_its_pictures_is_flagged(bring: Import) -> None:
    """The last press is said to be elsewhere."""
    cells = ROWS[-1].split(",")
    moved = ",".join([*cells[:3], "0", "-20", *cells[5:]])
    samples = bring(log_of([*ROWS[:-1], moved])).samples
    np.testing.assert_array_equal(samples.status, [0, 0, 0, 0, 1])
    assert samples.why(4) == [REASONS[2], REASONS[3]]
    assert samples.truth is not None
    assert samples.truth.touch[-1] == -1
    assert samples.truth.force_N[-1] == 0.0


def test_forces_far_too_small_are_noted(bring: Import) -> None:
    said: list[str] = []
    rows = [",".join([*(c := r.split(","))[:6], f"{float(c[6]) / 50:g}", c[7]]) for r in ROWS]
    done = bring(log_of(rows), said=said)
    assert any("are the forces in N" in text for text in said)
    assert len(done.meta.notes["doubts"]) == 1


def test_rows_of_other_pictures_are_noted(bring: Import) -> None:
    """As where the numbers of the frames are one off."""
    said: list[str] = []
    cells = [row.split(",") for row in ROWS]
    later = [",".join([row[0], str(int(row[1]) % 5 + 1), *row[2:]]) for row in cells]
    done = bring(log_of(later), said=said)
    assert any("do its rows belong to these pictures" in text for text in said)
    assert len(done.meta.notes["doubts"]) == 1


def test_a_log_that_was_cut_off_in_a_number_is_noted(bring: Import) -> None:
    said: list[str] = []
    bring(log_of(ROWS).rstrip("\n"), said=said)
    assert sum("may have been cut off" in text for text in said) == 1


def test_a_camera_that_moved_is_flagged(bring: Import, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    shutil.copytree(EXAMPLE / "frames", frames)
    image = cv2.imread(str(frames / "frame_0003.jpg"))
    cv2.imwrite(str(frames / "frame_0003.jpg"), np.roll(image, 2, axis=1))
    samples = bring(frames=frames).samples
    np.testing.assert_array_equal(samples.status, [0, 0, 1, 0, 0])
    assert samples.why(2) == [REASONS[1]]


def test_all_problems_of_a_log_in_one_error(bring: Import, tmp_path: Path) -> None:
    rows = [f"{k},{k},{k},0,20,18,nan,4" for k in range(1, 6)]
    rows += [f"{k},{k},{k},0,20,18,3,4" for k in range(6, 13)]
    with pytest.raises(InputError) as caught:
        bring(log_of(rows))
    text = str(caught.value)
    assert text.startswith("12 problems in ")
    assert "(12 samples): line 2: force_N is not a finite number (got 'nan'); line 3" in text
    assert text.count("line ") == 10
    assert "no single frame '6'" in text
    assert text.endswith("and 2 more; correct them, or leave these samples out with --skip-bad")
    with refused("rig-no-usable-samples"):
        bring(log_of(rows), skip_bad=True)
    assert not (tmp_path / "data").exists()


def test_one_bad_row_takes_its_sample_along(bring: Import) -> None:
    """A sample whose second contact is unknown has no truth."""
    bad = ROWS[4].replace("7.5,", "abc,")
    done = bring(log_of([*ROWS[:4], bad, ROWS[5]]), skip_bad=True)
    assert done.left_out == 1
    np.testing.assert_allclose(done.samples.total_N, [3.0, 6.0, 9.0, 12.0])
    np.testing.assert_allclose(done.samples.time_s, [0.0, 2.5, 5.0, 10.0])
    np.testing.assert_array_equal(done.samples.sequence, [0, 0, 1, 2])


def test_a_sample_without_contact(bring: Import) -> None:
    done = bring(log_of(["0,0,0,,,,0,", *ROWS]), radius_mm=4.0, skip_bad=True)
    assert done.left_out == 1  # its radius is no number
    done_log = log_of(["0,0,0,,,,0,4", *ROWS])
    with refused("output-exists"):
        bring(done_log)


def test_rest_samples_have_no_contacts(bring: Import) -> None:
    samples = bring(log_of(["0,0,0,,,,0,4", *ROWS])).samples
    np.testing.assert_array_equal(samples.contacts, [0, 1, 1, 1, 2, 1])
    assert samples.shift_px is not None
    assert np.abs(samples.shift_px[0]).max() < 1e-9


def test_rest_frames_identify_the_print(bring: Import, bundle: Path) -> None:
    rest_px, expected = bring().meta.rest_px, load_bundle(bundle).rest_px
    assert rest_px is not None
    assert np.nanmax(np.abs(rest_px - expected)) < 1.0
    assert np.isfinite(rest_px).all(axis=1).mean() > 0.9


def test_nothing_is_left_where_writing_fails(
    bring: Import, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("phytac_design.workflows.import_rig.write_samples", fail)
    with pytest.raises(KeyboardInterrupt):
        bring(keep="frames")
    assert [item.name for item in tmp_path.iterdir()] == ["log.csv"]


def test_lenses_are_compared(bring: Import, bundle: Path, tmp_path: Path) -> None:
    lens = load_bundle(bundle).camera.lens
    np.testing.assert_allclose(lens_difference_px(lens, lens), 0.0, atol=1e-9)
    longer = replace(lens, fx_px=1.005 * lens.fx_px, fy_px=1.005 * lens.fy_px)
    # Of 400 px from the centre to a corner half a per cent.
    assert lens_difference_px(lens, longer).max() == pytest.approx(2.0, rel=0.01)
    said: list[str] = []
    bring(cameras=(write_lens(lens, tmp_path / "a.yaml", "ros"),), said=said)
    assert not any("lens" in text for text in said)
    shutil.rmtree(tmp_path / "data")
    done = bring(cameras=(write_lens(longer, tmp_path / "b.yaml", "opencv"),), said=said)
    assert any("up to 2.0 px" in text for text in said)
    assert done.meta.notes["lenses"][0]["most_px"] == pytest.approx(2.0, rel=0.01)
    shutil.rmtree(tmp_path / "data")
    wrong = replace(lens, fx_px=1.05 * lens.fx_px, fy_px=1.05 * lens.fy_px)
    with refused("lens-differs"):
        bring(cameras=(write_lens(wrong, tmp_path / "c.yaml", "kalibr"),))
    other = replace(lens, width_px=1280, height_px=960)
    with refused("lens-image-size"):
        bring(cameras=(write_lens(other, tmp_path / "d.yaml", "ros"),))


def test_a_decoder_of_another_design(bundle: Path, tmp_path: Path) -> None:
    other = DESIGN.model_copy(update={"description": "other"})
    with refused("decoder-of-other-design"):
        import_rig(
            other,
            EXAMPLE / "log.csv",
            frames=[EXAMPLE / "frames"],
            bundle=bundle,
            out=tmp_path / "data",
        )
    with refused("camera-count"):
        import_rig(DESIGN, EXAMPLE / "log.csv", frames=[], bundle=bundle, out=tmp_path / "data")
