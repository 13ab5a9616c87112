"""Export of a decoder's cascade network to ONNX."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from phytac_decoder.estimation.cascade_network import INPUTS, CascadeNetwork, fade_mm
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_design.training.training_data import bundle_hash
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError, NumericalError, OutputError

OPSET, IR_VERSION = 17, 8
"""Versions of 2022, which current run times support."""
BASE_FORCES = {"stiffness": "(K·U)_i", "key_nodes": "ForceModel.base_forces('key_nodes', …)_i"}
"""What networks add to, by their base."""
INPUT, OUTPUT, ROWS = "features_mm", "stiffness_N_per_mm", "key_nodes"


def export_onnx(bundle: Path, out: Path, *, estimator: str = "fem_nn") -> float:
    """Write a decoder's network as ONNX, if the file computes the same as numpy.

    Parameters
    ----------
    bundle : Path
        The decoder's folder.
    out : Path
        File to write; an existing one is replaced.
    estimator : str
        Estimator of the network: ``fem_nn`` or ``fem_nn_identity``.

    Returns
    -------
    float
        Largest difference to numpy's over the largest stiffness, on the compared rows.

    Raises
    ------
    InputError
        If the decoder cannot be read or has no such network.
    NumericalError
        If the file would not compute the same; then none is written.
    OutputError
        If the file cannot be written.
    """
    decoder = load_bundle(bundle)
    network = decoder.model.networks.get(estimator)
    if network is None:
        known = ", ".join(sorted(decoder.model.networks)) or "none"
        raise InputError(
            "network-unknown",
            f"the decoder in {bundle} has no network {estimator!r} (its networks: {known}); name "
            "one of them, or train it with `phytac train`",
        )
    model = network_model(network, provenance(decoder, bundle_hash(bundle), estimator))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as folder:
            part = Path(folder) / out.name
            part.write_bytes(model.SerializeToString(deterministic=True))
            difference = max_difference(part, network)
            part.replace(out)
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {out}: {error.strerror or error}; choose another file",
        ) from None
    return difference


def provenance(decoder: Bundle, sha256: str, estimator: str) -> dict[str, str]:
    """Return the metadata of the file."""
    return {
        "what": f"stiffness that estimator {estimator} adds at a key node: force_N = "
        f"{BASE_FORCES[decoder.model.networks[estimator].base]} + {OUTPUT} · u_i",
        "estimator": estimator,
        "activation": decoder.model.networks[estimator].activation,
        "design": decoder.design,
        "design_hash": decoder.design_hash,
        "bundle_sha256": sha256,
        "input": f"{INPUT} ({ROWS}, {INPUTS}) float64, mm: apparent inward displacement u of the "
        "node and of its eight neighbours, height z; scales included",
        "output": f"{OUTPUT} ({ROWS},) float64, N/mm; scales included",
        "opset": str(OPSET),
    }


def network_model(network: CascadeNetwork, notes: Mapping[str, str]) -> onnx.ModelProto:
    """Return the network as an ONNX model: features (m, 10) mm to stiffness (m,) N/mm.

    The same operations as :meth:`CascadeNetwork.__call__`, in double precision.

    Raises
    ------
    NumericalError
        If ONNX's checker rejects it.
    """
    far = np.full(INPUTS, 1e300)
    low = -far if network.low is None else network.low
    high = far if network.high is None else network.high
    constants = {
        **network.layers(),
        "scale_in": network.scale_in,
        "scale_out": np.asarray(network.scale_out),
        "low": low,
        "high": high,
        "fade": fade_mm(low, high),
    }
    nodes = [
        helper.make_node("Div", [INPUT, "scale_in"], ["x"]),
        *_layer("x", 1, "first", network),
        helper.make_node("Concat", ["x", "first"], ["both"], axis=1),
        *_layer("both", 2, "second", network),
        helper.make_node("Concat", ["both", "second"], ["every"], axis=1),
        helper.make_node("Gemm", ["every", "w3", "b3"], ["column"], transB=1),
        helper.make_node("Mul", ["column", "scale_out"], ["scaled"]),
        helper.make_node("Squeeze", ["scaled", "last"], ["stiffness"]),
        helper.make_node("Max", [INPUT, "low"], ["raised"]),
        helper.make_node("Min", ["raised", "high"], ["limited"]),
        helper.make_node("Sub", [INPUT, "limited"], ["beyond"]),
        helper.make_node("Abs", ["beyond"], ["away"]),
        helper.make_node("Div", ["away", "fade"], ["faded"]),
        helper.make_node("ReduceMax", ["faded"], ["farthest"], axes=[1], keepdims=0),
        helper.make_node("Min", ["farthest", "one"], ["missing"]),
        helper.make_node("Sub", ["one", "missing"], ["learnt"]),
        helper.make_node("Mul", ["stiffness", "learnt"], [OUTPUT]),
    ]
    tensors = [
        numpy_helper.from_array(np.asarray(array, dtype=np.float64), name)
        for name, array in constants.items()
    ]
    tensors.append(numpy_helper.from_array(np.array([1], dtype=np.int64), "last"))
    tensors.append(numpy_helper.from_array(np.array(1.0), "one"))
    graph = helper.make_graph(
        nodes,
        "cascade",
        [helper.make_tensor_value_info(INPUT, TensorProto.DOUBLE, [ROWS, INPUTS])],
        [helper.make_tensor_value_info(OUTPUT, TensorProto.DOUBLE, [ROWS])],
        tensors,
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="phytac-design",
        doc_string=notes.get("what", ""),
    )
    helper.set_model_props(model, dict(notes))
    try:
        onnx.checker.check_model(model, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise NumericalError(
            "onnx-model-invalid",
            f"the network is not a valid ONNX model: {error}; please report this",
        ) from None
    return model


def _layer(source: str, number: int, result: str, network: CascadeNetwork) -> list[onnx.NodeProto]:
    """A hidden layer: affine, then the network's activation."""
    kind = "Relu" if network.activation == "rectified" else "Identity"
    affine = f"{result}_affine"
    return [
        helper.make_node("Gemm", [source, f"w{number}", f"b{number}"], [affine], transB=1),
        helper.make_node(kind, [affine], [result]),
    ]


def max_difference(path: Path, network: CascadeNetwork, tolerance: float = 1e-6) -> float:
    """Return the largest difference of a file to the network, over the largest stiffness.

    Raises
    ------
    NumericalError
        If it is more than ``tolerance``.
    """
    rng = np.random.default_rng(0)
    # Four times the scales of the inputs: both sides of every kink.
    features = 4.0 * network.scale_in * rng.standard_normal((256, INPUTS))
    features[0] = 0.0
    if network.low is not None and network.high is not None:
        features[64:] = rng.uniform(network.low, network.high, (192, INPUTS))
    wanted = network(features)
    worst = 0.0
    for rows in (features, features[:1]):
        found = run(path, rows)
        if found.shape != (len(rows),):
            raise NumericalError(
                "onnx-model-differs",
                f"the ONNX file gives an array of shape {found.shape} for {len(rows)} key nodes; "
                "it is not kept, please report this",
            )
        gap = np.abs(found - wanted[: len(rows)]).max() / max(np.abs(wanted).max(), 1e-300)
        worst = max(worst, float(gap)) if np.isfinite(gap) else float("inf")
    if not worst <= tolerance:
        raise NumericalError(
            "onnx-model-differs",
            f"the ONNX file differs from the network by {worst:.2g} of the largest stiffness, more "
            f"than {tolerance:g}; it is not kept, please report this",
        )
    return worst


def run(path: Path, features_mm: FloatArray) -> FloatArray:
    """Return the stiffness (m,) N/mm of features (m, 10) mm, by ONNX's reference evaluator."""
    (out,) = ReferenceEvaluator(str(path)).run(None, {INPUT: features_mm})
    return np.asarray(out, dtype=np.float64)
