"""Training from data sets: shared out, learnt, written, refused."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.estimation.cascade_network import ACTIVATIONS, CascadeNetwork, parameter_count
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_design.cli.app import app
from phytac_design.datasets.samples import THEORIES, Samples, inputs_alone, key_nodes
from phytac_design.datasets.samples_file import read_samples, write_samples
from phytac_design.design.design_file import design_hash, to_toml
from phytac_design.engine.stage import Context
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import assemble_bundle, untrained_model
from phytac_design.training.evaluation.decoded_contacts import decode_contacts
from phytac_design.training.fem_calibration import _fit, fit_mechanics
from phytac_design.training.join_datasets import join_samples, select_samples
from phytac_design.training.levenberg_marquardt import (
    CascadeDerivatives,
    KeyNodeData,
    train_network,
)
from phytac_design.training.training_data import SHARES, DataSet, read_data_sets, split_data_sets
from phytac_design.workflows import train_decoder
from phytac_design.workflows.train_decoder import MECHANICS, TABLE, train
from phytac_shapes.errors import DesignError
from tests.decoder.drawn_samples import assert_same, drawn
from tests.designs import changed, small
from tests.drawn_presses import meta_of, presses
from tests.places_alone import places_alone
from tests.refusals import refused

DESIGN = small(
    name="tiny",
    shape={"length_mm": 40.0},
    layout={"rows": 5, "columns": 10, "height_far_mm": 4.0},
    camera={"width_px": 432, "height_px": 324, "focal_px": 161.0},
)
HASH = design_hash(DESIGN)
SOFTER = 1.25
"""The data's sensor against the decoder's mechanics: what there is to learn."""
LITTLE = 20
BUNDLE = ("bundle.json", "bundle.safetensors")


@pytest.fixture(autouse=True, scope="module")
def _places_alone() -> Iterator[None]:
    """Most of the time of ``auto``; how well it decodes is measured in ``tests/decoder``."""
    with places_alone():
        yield


@pytest.fixture(scope="module")
def context() -> Context:
    """Views and response of the design."""
    stages = select_stages(MECHANICS)
    options = {"accuracy": "draft", "seed": 0, "force": True, "progress": lambda _: None}
    return run_stages(DESIGN, stages, **options)[0]


def pressed(context: Context, count: int, seed: int, **options: float) -> Samples:
    """Presses on a sensor that is softer than the decoder's mechanics says."""
    settings = {"softer": SOFTER, "noise_px": 0.01} | options
    return presses(untrained_model(context), context.markers.uv, count=count, seed=seed, **settings)


@pytest.fixture(scope="module")
def data(context: Context, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of 200 presses."""
    out = tmp_path_factory.mktemp("data") / "points"
    write_samples(out, pressed(context, 200, 0), meta_of("tiny", HASH))
    return out


@pytest.fixture(scope="module")
def little(context: Context, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As few presses as a decoder can be trained on, for what does not depend on how well."""
    out = tmp_path_factory.mktemp("little") / "points"
    write_samples(out, pressed(context, LITTLE, 0), meta_of("tiny", HASH))
    return out


@pytest.fixture
def learn(context: Context, data: Path, tmp_path: Path) -> Callable[..., Path]:
    """Train quietly; the decoder's folder."""

    def run(*sets: Path, name: str = "decoder", **options: object) -> Path:
        settings = {"accuracy": "draft", "progress": lambda _: None} | options
        train(DESIGN, sets or [data], tmp_path / name, **settings)
        return tmp_path / name

    return run


@pytest.fixture(scope="module")
def with_auto(little: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A decoder of few presses with all that can be learnt, by Python."""
    out = tmp_path_factory.mktemp("with-auto") / "decoder"
    train(DESIGN, [little], out, accuracy="draft", progress=lambda _: None)
    return out


@pytest.fixture
def networks_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the calibration of ``auto``, most of the time, for what does not depend on it."""
    chosen = [item for item in train_decoder.TRAINERS if item[0] != "auto"]
    monkeypatch.setattr(train_decoder, "TRAINERS", chosen)


def test_the_wall_of_the_design_is_handed_to_the_trainer(
    learn: Callable[..., Path], little: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(
        train_decoder, "uneven_wall_of", lambda context: asked.append(context.design.name)
    )
    out = learn(little)
    assert asked == [DESIGN.name]
    assert json.loads((out / TABLE).read_text())["trainers"]["auto"]["wall"] == {
        "even": "its mesh is too large"
    }


@pytest.mark.usefixtures("networks_alone")
def test_a_decoder_is_trained_and_better_than_the_mechanics_alone(
    learn: Callable[..., Path], context: Context
) -> None:
    out = learn()
    bundle, facts = load_bundle(out), json.loads((out / TABLE).read_text())
    plain = assemble_bundle(context, untrained_model(context), {})
    assert set(bundle.model.networks) == {"fem_nn", "fem_nn_identity"}
    np.testing.assert_array_equal(bundle.rest_px, plain.rest_px)
    # Softer throughout, by contacts as large as cells.
    fitted = facts["trainers"]["mechanics"]
    assert fitted["modulus"] == pytest.approx(1.0 / SOFTER, rel=0.02)
    assert fitted["spread"] == pytest.approx(1.0, abs=0.1)
    ratio = bundle.model.stiffness.diagonal() / plain.model.stiffness.diagonal()
    assert np.median(ratio) == pytest.approx(1.0 / SOFTER, rel=0.03)
    assert facts["samples"] == {"training": 170, "validation": 10, "test": 20}
    test = facts["test"]
    before = decode_contacts(plain.model, pressed(context, 40, 7), estimators=["koi_inverse"])
    on = before.tripped
    assert (before.decoded_N["koi_inverse"] - before.force_N)[on].mean() > 0.2 * 12.0
    assert abs(test["koi_inverse"]["bias_N"]) < 0.2
    assert test["fem_nn"]["relative_error"] < 0.7 * test["fem"]["relative_error"]
    assert facts["trainers"]["fem_nn"]["base"] == "key_nodes"
    error = facts["trainers"]["fem_nn"]["rmse_test_N"]
    assert error == pytest.approx(test["fem_nn"]["rmse_N"], rel=1e-6)
    assert bundle.notes["training_samples"] == 170
    relative = bundle.notes["test_relative_error"]["fem_nn"]
    assert relative == test["fem_nn"]["relative_error"]


def test_mechanics_find_how_far_forces_spread(context: Context) -> None:
    model = untrained_model(context)
    assert model.footprint_px is not None
    for spread in (0.0, 0.4):
        between = model.footprint_px + spread * (model.compliance_px - model.footprint_px)
        real = replace(model, compliance_px=between)
        samples = presses(real, context.markers.uv, count=60, seed=3, softer=1.1, noise_px=0.01)
        fit = fit_mechanics(model, model.footprint_px, samples, pressed(context, 3, 1))
        assert fit.spread == pytest.approx(spread, abs=0.1)
        assert fit.modulus == pytest.approx(1.0 / 1.1, rel=0.03)
        assert fit.error_N < 0.4
        assert fit.tip_sd_px < 0.1
        apparent = np.einsum(
            "ni,nim->nm",
            model.shift_to_mm,
            fit.model.compliance_px.reshape(context.markers.count, 2, -1),
        )
        np.testing.assert_allclose(
            fit.model.stiffness @ apparent, np.eye(context.markers.count), atol=1e-8
        )


def test_too_few_key_nodes_leave_the_mechanics_as_designed(context: Context) -> None:
    model = untrained_model(context)
    assert model.footprint_px is not None
    few = pressed(context, 3, 0)
    fit = fit_mechanics(model, model.footprint_px, few, few)
    assert (fit.modulus, fit.spread, fit.columns) == (1.0, 1.0, 0)
    assert fit.model is model


@pytest.mark.usefixtures("networks_alone")
def test_a_modulus_beyond_its_range_is_reported(context: Context, tmp_path: Path) -> None:
    said: list[str] = []
    for softer in (1.5, 3.0):
        out = tmp_path / f"{softer:g}"
        samples = pressed(context, LITTLE, 0, softer=softer)
        write_samples(out / "points", samples, meta_of("tiny", HASH))
        said.clear()
        train(DESIGN, [out / "points"], out / "decoder", accuracy="draft", progress=said.append)
        warned = [text for text in said if "modulus beyond 0.5 to 2 times" in text]
        assert len(warned) == (softer == 3.0)
    facts = json.loads((out / "decoder" / TABLE).read_text())["trainers"]["mechanics"]
    assert facts["modulus"] == 0.5
    assert facts["warning"] in warned[0]


def uneven_print(model: ForceModel, number: int) -> ForceModel:
    """A print whose markers move otherwise than by design, each by 15 % under each force."""
    count = len(model.height_z_mm)
    factor = 1.0 + 0.15 * np.random.default_rng(number).standard_normal((count, count))
    return replace(model, compliance_px=factor.repeat(2, axis=0) * model.compliance_px)


def test_columns_of_an_uneven_print_are_measured(context: Context) -> None:
    """Where markers move otherwise than by design, the forces of several contacts come right."""
    model = untrained_model(context)
    assert model.footprint_px is not None
    count, real = context.markers.count, uneven_print(model, 5)
    samples, validation, test = (
        presses(real, context.markers.uv, count=each, seed=seed, noise_px=0.003)
        for each, seed in ((300, 0), (30, 1), (60, 2))
    )
    # One that was not found measures nothing.
    assert samples.shift_px is not None
    samples.shift_px[::7, 4] = np.nan
    fit = fit_mechanics(model, model.footprint_px, samples, validation)
    assert fit.columns == count
    # Columns hold what moved key nodes otherwise: their own shifts count for more than before.
    before_sd_px = _fit(model, model.footprint_px, validation).tip_sd_px
    assert fit.tip_sd_px == fit.model.tip_sd_px < before_sd_px
    sound = fit.model.response_px - real.compliance_px
    before = fit.model.compliance_px - real.compliance_px
    assert np.linalg.norm(sound) < 0.45 * np.linalg.norm(before)
    errors = []
    for each in (fit.model, replace(fit.model, measured=None)):
        found = decode_contacts(each, test, estimators=["koi_inverse"])
        errors.append(np.abs(found.decoded_N["koi_inverse"] - found.force_N)[found.tripped].mean())
    assert errors[0] < 0.4 * errors[1]


def test_columns_stay_by_design_where_measured_ones_are_no_better(context: Context) -> None:
    model = untrained_model(context)
    assert model.footprint_px is not None
    samples, validation = (
        presses(uneven_print(model, number), context.markers.uv, count=100, seed=number)
        for number in (1, 2)
    )
    fit = fit_mechanics(model, model.footprint_px, samples, validation)
    assert fit.columns == 0
    assert fit.model.measured is None


def test_the_error_of_linear_data_is_kept(
    with_auto: Path, little: Path, learn: Callable[..., Path], tmp_path: Path
) -> None:
    def limits(folder: Path) -> list[str]:
        return [text for text in load_bundle(folder).limits() if text.startswith("linear-tables")]

    (words,) = limits(with_auto)
    assert "simulated by linear theory" in words
    locator = load_bundle(with_auto).model.locator
    assert locator is not None
    assert locator.as_if_linear
    samples, info = read_samples(little)
    large = np.full(samples.count, THEORIES.index("large"))
    write_samples(tmp_path / "large", replace(samples, theory=large), info)
    assert limits(learn(tmp_path / "large")) == []


@pytest.mark.usefixtures("networks_alone")
def test_another_seed_gives_another_bundle(
    learn: Callable[..., Path], with_auto: Path, little: Path
) -> None:
    other = learn(little, name="other", seed=1)
    for name in BUNDLE:
        assert (with_auto / name).read_bytes() != (other / name).read_bytes()
        assert (other / name).stat().st_mode & 0o044 == (other / TABLE).stat().st_mode & 0o044
    assert sorted(path.name for path in other.iterdir()) == [*BUNDLE, TABLE]
    # What is not learnt differs by the split alone.
    plain = [json.loads((out / TABLE).read_text())["test"]["fem"] for out in (with_auto, other)]
    assert plain[0] != plain[1]


@pytest.mark.usefixtures("networks_alone")
def test_fewer_samples_can_be_used(learn: Callable[..., Path]) -> None:
    facts = json.loads((learn(samples=LITTLE) / TABLE).read_text())
    assert sum(facts["samples"].values()) == LITTLE
    with refused("training-data-too-few"):
        learn(samples=201)


@pytest.mark.usefixtures("networks_alone")
def test_inputs_alone_train_networks_that_add_to_the_designs_own_mechanics(
    learn: Callable[..., Path], context: Context, tmp_path: Path
) -> None:
    samples = pressed(context, 200, 0)
    rows = key_nodes(untrained_model(context), samples, noise_px=1e-4)
    write_samples(tmp_path / "inputs", inputs_alone(samples, rows), meta_of("tiny", HASH))
    points, inputs = learn(), learn(tmp_path / "inputs", name="inputs-decoder")
    facts = [json.loads((out / TABLE).read_text()) for out in (points, inputs)]
    assert facts[1]["test"] is None
    a, b = (item["trainers"]["fem_nn"]["rmse_test_N"] for item in facts)
    trainers = [item["trainers"] for item in facts]
    assert [item["fem_nn"]["base"] for item in trainers] == ["key_nodes", "stiffness"]
    assert "left" in trainers[1]["mechanics"]
    assert a < b < 0.5 * np.abs(rows.stiffness_force_N - rows.force_N).mean()
    # Inputs of the designed mechanics beside points: the mechanics stay as designed.
    write_samples(tmp_path / "more", pressed(context, LITTLE, 5), meta_of("tiny", HASH))
    both = learn(tmp_path / "more", tmp_path / "inputs", name="both")
    trained = json.loads((both / TABLE).read_text())["trainers"]
    assert "left" in trained["mechanics"]
    assert trained["fem_nn"]["base"] == "stiffness"
    made_finer = meta_of("tiny", HASH, notes={"accuracy": "fine"})
    write_samples(tmp_path / "finer", inputs_alone(samples, rows), made_finer)
    with refused("inputs-other-accuracy") as caught:
        learn(tmp_path / "finer", name="finer-decoder")
    caught.match("--accuracy fine")
    low = replace(rows, height_z_mm=rows.height_z_mm + 1.0)
    write_samples(tmp_path / "low", inputs_alone(samples, low), meta_of("tiny", HASH))
    with refused("inputs-other-heights"):
        learn(tmp_path / "low", name="low-decoder")


@pytest.mark.usefixtures("networks_alone")
def test_several_sets_are_used_together(
    learn: Callable[..., Path], context: Context, little: Path, tmp_path: Path
) -> None:
    write_samples(tmp_path / "more", pressed(context, 20, 1), meta_of("tiny", HASH))
    facts = json.loads((learn(little, tmp_path / "more") / TABLE).read_text())
    assert sum(facts["samples"].values()) == LITTLE + 20
    with refused("data-set-duplicate"):
        learn(little, tmp_path / "more", little)
    # As a longer run of one seed holds a shorter one's samples.
    samples = pressed(context, LITTLE, 0)
    write_samples(tmp_path / "part", select_samples(samples, np.arange(10)), meta_of("tiny", HASH))
    with refused("data-sets-overlap"):
        learn(little, tmp_path / "part")
    for name, count in (("whole", LITTLE), ("first", 10)):
        kept = select_samples(samples, np.arange(count))
        rows = key_nodes(untrained_model(context), kept, noise_px=1e-4)
        write_samples(tmp_path / name, inputs_alone(kept, rows), meta_of("tiny", HASH))
    read = len(np.unique(rows.sample))
    with refused("data-sets-overlap") as caught:
        learn(tmp_path / "whole", tmp_path / "first")
    caught.match(f"^{read} samples of .*first are in .*whole as well")


@pytest.mark.usefixtures("networks_alone")
def test_another_decoder_is_a_start(
    learn: Callable[..., Path], little: Path, tmp_path: Path
) -> None:
    first = learn(little)
    out = learn(little, name="second", start=first, samples=15)
    bundle = load_bundle(out)
    assert bundle.notes["start"]["design"] == "tiny"
    assert json.loads((out / TABLE).read_text())["start"] == bundle.notes["start"]
    plain = learn(little, name="plain", samples=15)
    assert (out / BUNDLE[1]).read_bytes() != (plain / BUNDLE[1]).read_bytes()
    known = load_bundle(first)
    bare = replace(known, model=replace(known.model, networks={}))
    save_bundle(bare, tmp_path / "bare")
    with refused("network-unknown"):
        learn(little, name="third", start=tmp_path / "bare")


def rows(count: int, seed: int, size: float = 1.0) -> KeyNodeData:
    """Nodes whose stiffness depends on the sign of a neighbour's motion; in units of ``size``."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count, 10))
    k = 2.0 + 5.0 * np.maximum(x[:, 3], 0.0)
    return KeyNodeData(
        features=size * x,
        apparent_mm=size * x[:, 0],
        stiffness_force_N=x[:, 0],
        force_N=x[:, 0] * (1.0 + k),
        sample=np.arange(count),
    )


def test_a_start_is_used_instead_of_random_weights_and_takes_the_new_scales() -> None:
    first = train_network(rows(400, 0), rows(40, 1), activation="rectified", seed=0).network
    few, judge = rows(60, 2, size=0.1), rows(20, 3, size=0.1)
    started = [
        train_network(few, judge, activation="rectified", seed=seed, start=first) for seed in (0, 1)
    ]
    np.testing.assert_array_equal(started[0].network.parameters, started[1].network.parameters)
    fresh = train_network(few, judge, activation="rectified", seed=0)
    assert started[0].network.scale_in[0] == fresh.network.scale_in[0]
    # All in units a tenth as large: the same network, once it is scaled, is the answer already.
    assert started[0].rmse_validation_N < 0.2 * fresh.rmse_validation_N
    with refused("network-activation-differs"):
        train_network(few, judge, activation="identity", seed=0, start=first)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_derivatives_are_those_of_the_network(activation: str) -> None:
    rng = np.random.default_rng(5)
    flat, x = rng.normal(size=parameter_count()), rng.normal(size=(6, 10))
    rectified = activation == "rectified"
    net = CascadeNetwork(
        parameters=flat, activation=activation, scale_in=np.ones(10), scale_out=1.0
    )
    np.testing.assert_allclose(
        CascadeDerivatives(flat, x, rectified=rectified).value, net(x), atol=1e-12
    )
    step = 1e-6
    slopes = np.stack(
        [
            (net_at(flat + step * e, x, activation) - net_at(flat - step * e, x, activation))
            / (2.0 * step)
            for e in np.eye(len(flat))
        ],
        axis=1,
    )
    exact = CascadeDerivatives(flat, x, rectified=rectified).jacobian()
    np.testing.assert_allclose(exact, slopes, rtol=0.0, atol=1e-6 * np.abs(slopes).max())


def net_at(flat: np.ndarray, x: np.ndarray, activation: str) -> np.ndarray:
    """The run-time network at some parameters."""
    return CascadeNetwork(
        parameters=flat, activation=activation, scale_in=np.ones(10), scale_out=1.0
    )(x)


def test_picked_samples_joined_again_are_the_same() -> None:
    whole = drawn(4, count=9)
    whole = replace(whole, sequence=np.sort(whole.sequence))
    again = join_samples(
        [select_samples(whole, np.arange(4)), select_samples(whole, np.arange(4, 9))]
    )
    # Sequences are distinct between sets, and reasons come sorted.
    numbered = np.unique(whole.sequence[:4], return_inverse=True)[1]
    later = np.unique(whole.sequence[4:], return_inverse=True)[1] + numbered.max() + 1
    expected = replace(whole, sequence=np.concatenate([numbered, later]))
    assert [again.why(k) for k in range(9)] == [whole.why(k) for k in range(9)]
    fields = ("reasons", "reason_index", "reason_sample")
    assert_same(again, replace(expected, **{name: getattr(again, name) for name in fields}))


def test_a_pick_leaves_out_what_belongs_to_others() -> None:
    whole = drawn(5, count=9)
    part = select_samples(whole, np.array([2, 7]))
    assert part.touches is not None
    assert whole.touches is not None
    assert part.truth is not None
    np.testing.assert_array_equal(
        part.touches.force_N, whole.touches.force_N[np.isin(whole.touches.sample, [2, 7])]
    )
    owned = part.truth.touch >= 0
    assert owned.any()
    np.testing.assert_array_equal(
        part.touches.sample[part.truth.touch[owned]], part.truth.sample[owned]
    )
    with refused("data-sets-marker-count"):
        join_samples([whole, drawn(5, markers=8)])


def test_parts_share_no_sequence_and_hold_no_failed_sample(context: Context) -> None:
    model = untrained_model(context)
    samples = pressed(context, 90, 2)
    status = np.where(np.arange(90) < 10, 2, 0)
    samples = replace(
        samples,
        sequence=np.arange(90) // 3,
        status=status,
        reasons=("broken",),
        reason_sample=np.arange(10),
        reason_index=np.zeros(10, dtype=np.int64),
    )
    item = DataSet(folder=Path("x"), samples=samples, meta=meta_of("tiny", HASH), sha256="0")
    parts = split_data_sets([item], model, noise_px=0.04, seed=0)
    assert sum(part.count for part in parts) == 80
    assert abs(parts[0].count - SHARES[0] * 80) <= 3
    seen = [
        set(np.round(part.samples.time_s).astype(int).tolist())
        for part in parts
        if part.samples is not None
    ]
    assert sorted(k for times in seen for k in times) == list(range(10, 90))
    groups = [{k // 3 for k in times} for times in seen]
    assert sum(len(group) for group in groups) == len(set.union(*groups))
    few = split_data_sets([item], model, noise_px=0.04, seed=0, limit=30)
    times = [part.samples.time_s for part in few if part.samples is not None]
    assert sorted(np.concatenate(times)) == list(range(10, 40))


def test_data_that_cannot_be_used_are_rejected(
    learn: Callable[..., Path], context: Context, data: Path, tmp_path: Path
) -> None:
    samples = pressed(context, 20, 3)
    none = replace(samples, bits=None, bits_read=None, shift_px=None, touches=None, truth=None)
    write_samples(tmp_path / "bare", none, meta_of("tiny", HASH))
    with refused("data-set-without-inputs"):
        learn(tmp_path / "bare")
    assert not (tmp_path / "decoder").exists()
    write_samples(tmp_path / "other", samples, meta_of("other", "f" * 64))
    with refused("data-set-other-design"):
        learn(tmp_path / "other")
    unread = replace(samples, bits_read=np.zeros_like(samples.bits))
    write_samples(tmp_path / "unread", unread, meta_of("tiny", HASH))
    with refused("no-switch-tripped"):
        learn(tmp_path / "unread")
    (data.parent / "broken").mkdir(exist_ok=True)
    for path in data.iterdir():
        (data.parent / "broken" / path.name).write_bytes(path.read_bytes()[:-50])
    with refused("data-set-table-invalid"):
        learn(data.parent / "broken")
    with refused("data-set-missing"):
        train(DESIGN, [], tmp_path / "decoder", progress=lambda _: None)
    with refused("training-data-too-few"):
        learn(samples=2)


@pytest.mark.usefixtures("networks_alone")
def test_a_folder_of_something_else_is_kept(
    learn: Callable[..., Path], little: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "decoder"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    with refused("output-foreign"):
        learn(little)
    (folder / TABLE).write_text('{"design": "another"}')
    with refused("output-foreign"):
        learn(little)
    learn(little, force=True)
    learn(little)
    assert (folder / "mine.txt").read_text() == "mine"
    (tmp_path / "file").write_text("")
    with refused("output-not-writable"):
        learn(little, name="file/decoder")


def test_the_command(
    with_auto: Path,
    little: Path,
    data: Path,
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    (tmp_path / "tiny.toml").write_text(to_toml(DESIGN))
    words = ["train", str(tmp_path / "tiny.toml"), str(little), "--accuracy", "draft"]
    words += ["--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "koi_inverse" in done.output
    verdict, after = done.stdout.splitlines()[-2:]
    assert verdict.startswith("best estimator: ")
    assert "(the published sensor has 2.3 %)" in verdict
    assert "are few, 100 or more" in verdict
    assert after.startswith(f"next: phytac evaluate {tmp_path / 'out'} DATA")
    # The same inputs give the same files.
    for name in BUNDLE:
        assert (tmp_path / "out" / name).read_bytes() == (with_auto / name).read_bytes()
    request.getfixturevalue("networks_alone")
    done = CliRunner().invoke(app, [*words, "--json"])
    facts = json.loads(done.stdout)
    assert facts["out"] == str(tmp_path / "out")
    assert facts["trainers"]["fem_nn"]["seconds"] > 0.0
    refused = CliRunner().invoke(app, ["train", "nowhere", str(data)])
    assert isinstance(refused.exception, DesignError)


def test_sets_are_known_by_their_bytes(data: Path) -> None:
    (item,) = read_data_sets([data], design_hash=HASH)
    assert item.has_points
    assert item.facts()["samples"] == 200
    assert len(item.sha256) == 64


def test_a_sensor_without_switches_is_not_trained(little: Path, tmp_path: Path) -> None:
    posts = changed(receptor={"diameter_hole_mm": 0.0})
    with refused("training-without-switches"):
        train(posts, [little], tmp_path / "decoder", accuracy="draft", progress=lambda _: None)
    assert not (tmp_path / "decoder").exists()
