"""Networks as ONNX files: the same function, named and explained, or no file at all."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx.reference import ReferenceEvaluator
from typer.testing import CliRunner

from phytac_decoder.estimation.cascade_network import CascadeNetwork, parameter_count
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_design.cli.app import app
from phytac_design.training import onnx_export
from phytac_design.training.onnx_export import export_onnx
from phytac_design.training.training_data import bundle_hash
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError
from tests.decoder.toy_sensor import toy_bundle
from tests.refusals import refused

NAMES = {"fem_nn": "rectified", "fem_nn_identity": "identity"}
MM, N_PER_MM = 0.02, 40.0


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """A decoder with two networks whose inputs differ in scale."""
    rng = np.random.default_rng(1)
    networks = {
        name: CascadeNetwork(
            parameters=rng.normal(size=parameter_count()),
            activation=activation,  # type: ignore[arg-type]  # of a dict of words
            scale_in=np.append(np.full(9, MM), 120.0),
            scale_out=N_PER_MM,
        )
        for name, activation in NAMES.items()
    }
    plain = toy_bundle()
    folder = tmp_path / "decoder"
    save_bundle(replace(plain, model=replace(plain.model, networks=networks)), folder)
    return folder


def features(count: int) -> FloatArray:
    """Inputs in mm, with some far beyond the usual."""
    rng = np.random.default_rng(2)
    u = MM * rng.normal(size=(count, 9)) * 10.0 ** rng.uniform(-3.0, 2.0, (count, 1))
    return np.column_stack([u, rng.uniform(0.0, 120.0, count)])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [1, 2, 500])
def test_the_file_computes_what_numpy_does(
    bundle: Path, tmp_path: Path, name: str, count: int
) -> None:
    out = tmp_path / "deep" / "network.onnx"
    difference = export_onnx(bundle, out, estimator=name)
    network, x = load_bundle(bundle).model.networks[name], features(count)
    (answer,) = ReferenceEvaluator(str(out)).run(["stiffness_N_per_mm"], {"features_mm": x})
    found = np.asarray(answer, dtype=np.float64)
    wanted = network(x)
    assert found.shape == (count,)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12 * np.abs(wanted).max())
    assert difference <= 1e-12
    assert [path.name for path in out.parent.iterdir()] == ["network.onnx"]


def test_the_file_explains_itself(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "network.onnx"
    export_onnx(bundle, out)
    model = onnx.load(out)
    onnx.checker.check_model(model, full_check=True)
    assert [(item.domain, item.version) for item in model.opset_import] == [("", onnx_export.OPSET)]
    ends = (*model.graph.input, *model.graph.output)
    sizes = [[d.dim_param or d.dim_value for d in e.type.tensor_type.shape.dim] for e in ends]
    assert [e.name for e in ends] == ["features_mm", "stiffness_N_per_mm"]
    assert sizes == [["key_nodes", 10], ["key_nodes"]]
    notes = {item.key: item.value for item in model.metadata_props}
    decoder = load_bundle(bundle)
    assert notes["design_hash"] == decoder.design_hash
    assert notes["bundle_sha256"] == bundle_hash(bundle)
    assert (notes["estimator"], notes["activation"]) == ("fem_nn", "rectified")
    assert "mm" in notes["input"]
    assert "N/mm" in notes["output"]


def test_the_same_decoder_gives_the_same_file(bundle: Path, tmp_path: Path) -> None:
    first, again = tmp_path / "first.onnx", tmp_path / "again.onnx"
    export_onnx(bundle, first)
    export_onnx(bundle, again)
    assert first.read_bytes() == again.read_bytes()


def without_scale(model: onnx.ModelProto) -> None:
    (scale,) = [t for t in model.graph.initializer if t.name == "scale_out"]
    scale.CopyFrom(onnx.numpy_helper.from_array(np.asarray(N_PER_MM * (1.0 + 1e-5)), "scale_out"))


def without_kink(model: onnx.ModelProto) -> None:
    for node in model.graph.node:
        if node.op_type == "Relu":
            node.op_type = "Identity"


def without_numbers(model: onnx.ModelProto) -> None:
    (scale,) = [t for t in model.graph.initializer if t.name == "scale_out"]
    scale.CopyFrom(onnx.numpy_helper.from_array(np.asarray(np.nan), "scale_out"))


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("damage", [without_scale, without_kink, without_numbers])
def test_a_file_that_computes_something_else_is_not_left(
    bundle: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    damage: Callable[[onnx.ModelProto], None],
) -> None:
    make = onnx_export.network_model

    def wrong(network: CascadeNetwork, notes: dict[str, str]) -> onnx.ModelProto:
        model = make(network, notes)
        damage(model)
        return model

    out = tmp_path / "out" / "network.onnx"
    export_onnx(bundle, out)
    before = out.read_bytes()
    monkeypatch.setattr(onnx_export, "network_model", wrong)
    with refused("onnx-model-differs"):
        export_onnx(bundle, out)
    assert [path.name for path in out.parent.iterdir()] == ["network.onnx"]
    assert out.read_bytes() == before


def test_what_cannot_be_exported_is_rejected(bundle: Path, tmp_path: Path) -> None:
    known = r"has no network 'fem' .its networks: fem_nn, fem_nn_identity."
    with refused("network-unknown") as caught:
        export_onnx(bundle, tmp_path / "x.onnx", estimator="fem")
    caught.match(known)
    with refused("output-not-writable"):
        export_onnx(bundle, bundle)
    with pytest.raises(InputError):
        export_onnx(tmp_path / "none", tmp_path / "x.onnx")
    assert {path.name for path in tmp_path.iterdir()} == {"decoder"}


def test_the_command(bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "network.onnx"
    words = ["export-onnx", str(bundle), str(out), "--estimator", "fem_nn_identity"]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["out"] == str(out)
    assert facts["difference"] <= 1e-12
    assert "network of fem_nn_identity" in CliRunner().invoke(app, words).stdout
    mine = tmp_path / "mine.txt"
    mine.write_text("precious")
    wrong = CliRunner().invoke(app, ["export-onnx", str(bundle), str(mine)])
    assert isinstance(wrong.exception, InputError)
    assert "end its name in .onnx" in str(wrong.exception)
    assert mine.read_text() == "precious"
    monkeypatch.delitem(sys.modules, "phytac_design.training.onnx_export")
    monkeypatch.setitem(sys.modules, "onnx", None)
    lacking = CliRunner().invoke(app, words)
    # The command line names the extra that it is part of.
    assert isinstance(lacking.exception, ModuleNotFoundError)
