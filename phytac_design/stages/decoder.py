"""Train the paper's network, judge every estimator on held-out contacts, write the bundle."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phytac_decoder.estimation.cascade_network import Activation
from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.design.spec import Design
from phytac_design.engine.stage import EXPORT, Context, Stage, write_arrays, write_facts
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.simulation.dataset import Dataset, decode_points, key_node_data
from phytac_design.simulation.scene_scope import scope_of
from phytac_design.stages.places import locator_of
from phytac_design.stages.response import TOUCH, readers_of
from phytac_shapes.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from phytac_decoder.estimation.locator import ContactLocator
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.vision.switch_detection import TipModel

ACTIVATIONS: dict[str, Activation] = {"fem_nn": "rectified", "fem_nn_identity": "identity"}
"""Networks of the bundle: both readings of the paper's \"linear unit\"."""
UNREAD_N = 1e4
"""Threshold of switches that a scene's decoder does not read: the largest force of a design."""
UNREAD_RED = 4.0
"""Red over what tells on from off, that no such tip shows."""
MIDDLE = (0.125, 0.792)
"""Middle of the sensor as fractions of its length: heights 15 to 95 mm of 120 (paper)."""


def along_mm(context: Context, uv: FloatArray) -> FloatArray:
    """Distance of chart positions from the near rim along the unwrapped surface, mm."""
    low = context.surface.domain[0, 0]
    flat = context.surface.unwrap(uv)[:, 1]
    start = np.column_stack([np.full(len(uv), low), uv[:, 1]])
    return np.asarray(flat - context.surface.unwrap(start)[:, 1])


def length_mm(context: Context) -> float:
    """Length of the sensor from rim to rim, along v0, mm."""
    (_, u1), (v0, _) = context.surface.domain
    return float(along_mm(context, np.array([[u1, v0]]))[0])


def middle_mm(context: Context) -> tuple[float, float]:
    """Heights that count as the middle of this sensor."""
    length = length_mm(context)
    return MIDDLE[0] * length, MIDDLE[1] * length


def untrained_model(context: Context) -> ForceModel:
    """Force model of the stages ``response`` and (if it ran) ``places``, without networks."""
    response = context.arrays("response")
    return ForceModel(
        shift_to_mm=response["shift_to_mm"],
        stiffness=response["stiffness"],
        compliance_px=response["compliance_px"],
        height_z_mm=context.markers.mid_mm[:, 2].copy(),
        neighbours=context.markers.neighbours,
        networks={},
        locator=_locator(context) if "places" in context.folders else None,
    )


def _locator(context: Context) -> "ContactLocator":
    """The estimator ``auto`` by design, which knows what switches cannot be read."""
    played = played_in(context)
    return replace(locator_of(context), blind=_tips(context, played).blind(played))


def _tips(context: Context, played: BoolArray) -> "TipModel":
    """Tips as the cameras that read them see them."""
    views = context.arrays("views")
    return tips_in_play(
        views["tip_on_px"], views["tip_red_rest_px"], views["tip_red_on_px"], played
    )


def assemble_bundle(context: Context, model: ForceModel, notes: dict[str, Any]) -> "Bundle":
    """Bundle from the stages ``views`` and ``response`` and a force model; of no design by name.

    Parameters
    ----------
    context : Context
        With the folders of both stages.
    model : ForceModel
        As of :func:`untrained_model`, and what was trained on top of it.
    notes : dict
        Where it comes from, plain JSON.
    """
    from phytac_decoder.io.bundle import Bundle, CameraView
    from phytac_design.simulation.expected_image import colour_model

    design, views = context.design, context.arrays("views")
    colours, classes = colour_model(design)
    readers = readers_of(context)
    played = played_in(context)
    shown = [
        CameraView(rest_px=rest, tips=tips_in_play(on, red_rest, red_on, played))
        for rest, on, red_rest, red_on in zip(
            views["shown_rest_px"],
            views["shown_tip_on_px"],
            views["shown_tip_red_rest_px"],
            views["shown_tip_red_on_px"],
            strict=True,
        )
    ]
    return Bundle(
        design="",
        design_hash="",
        cameras=readers.cameras,
        read_by=readers.read_by,
        colours=colours,
        colour=classes[context.markers.colour],
        position_mm=context.surface.point(context.markers.uv),
        rest_px=views["rest_px"],
        tip_bias_px=views["tip_bias_px"],
        tips=_tips(context, played),
        model=model,
        # No force explains a switch out of play: it is doubted in every frame.
        threshold_N=np.where(played, thresholds_N(design, context.markers), UNREAD_N),
        noise_centroid_px=design.camera.noise_centroid_px,
        force_max_N=design.training.force_max_N,
        shown=tuple(shown) if len(shown) > 1 else (),
        notes=notes,
    )


def played_in(context: Context) -> BoolArray:
    """Receptors (n,) that the decoder reads: in a scene those in play."""
    scope = scope_of(context)
    if scope is None:
        return np.ones(context.markers.count, dtype=np.bool_)
    return scope.in_play(context.markers)


def tips_in_play(
    on_px: FloatArray, red_rest_px: FloatArray, red_on_px: FloatArray, played: BoolArray
) -> "TipModel":
    """Tips as the decoder reads them.

    Of a switch out of play that cannot be read anyway, no amount of red counts; motion alone,
    which explains nothing there, would else stand for it.
    """
    from phytac_decoder.vision.switch_detection import RED_RATIO_MIN, RED_AREA_MIN_px, TipModel

    tips = TipModel(on_px=on_px, red_rest_px=red_rest_px, red_on_px=red_on_px)
    never = UNREAD_RED * (RED_RATIO_MIN * red_rest_px + RED_AREA_MIN_px)
    return replace(tips, red_on_px=np.where(played | tips.readable, red_on_px, never))


def run(context: Context, folder: Path) -> None:
    """Write ``decoder/bundle.{json,safetensors}`` and the table of estimators."""
    from phytac_decoder.io.bundle import save_bundle

    twin = context.arrays("twin")
    model = untrained_model(context)
    training: dict[str, Any] = {"key_nodes": 0, "samples": 0}
    if context.scene is None or context.scene.networks:
        training = train_networks(context, model, Dataset.from_arrays(twin, "train"))
    scores, arrays = evaluate_estimators(context, model, twin)
    write_arrays(folder, arrays)
    bundle = assemble_bundle(
        context,
        model,
        {
            "data": context.facts("twin")["model"],
            "training_samples": training["samples"],
            "seed": context.seed,
            "test_relative_error": {
                name: scores["test"][name]["relative_error"] for name in model.estimators
            },
        }
        | scene_notes(context),
    )
    save_bundle(bundle, folder / EXPORT / "decoder")
    write_facts(folder, {"training": training, **scores, "limits": limit_facts(bundle)})


def scene_notes(context: Context) -> dict[str, Any]:
    """What the bundle of a scene says of itself: forces are read on receptors in play alone."""
    scene = context.scene
    if scene is None:
        return {}
    return {
        "scene": {
            "name": scene.name,
            "regions": [region.model_dump(mode="json") for region in scene.regions],
            "in_play": np.flatnonzero(played_in(context)).tolist(),
        }
    }


def train_networks(context: Context, model: ForceModel, data: Dataset) -> dict[str, Any]:
    """Train the networks of the paper into ``model``, and say how they fit."""
    from phytac_design.training.levenberg_marquardt import split_samples, train_network

    rows = key_node_data(model, data)
    first, second, third = split_samples(data.contacts.samples, seed=context.seed)
    training: dict[str, Any] = {"key_nodes": len(rows.force_N), "samples": data.contacts.samples}
    for name, activation in ACTIVATIONS.items():
        context.progress(f"decoder: training {name}")
        fit = train_network(
            rows.take(first), rows.take(second), activation=activation, seed=context.seed
        )
        model.networks[name] = fit.network
        training[name] = {
            "seconds": fit.seconds,
            "rounds": fit.rounds,
            "rmse_train_N": fit.rmse_train_N,
            "rmse_validation_N": fit.rmse_validation_N,
            "rmse_test_split_N": _rmse(fit.network, rows.take(third)),
        }
    return training


def evaluate_estimators(
    context: Context, model: ForceModel, twin: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Scores of every estimator on both held-out sets, and the forces (c,) that each decoded, N."""
    from phytac_design.simulation.force_errors import contact_forces, score_contacts

    scores: dict[str, Any] = {}
    arrays: dict[str, FloatArray] = {}
    for name in ("test", "anywhere"):
        held_out = Dataset.from_arrays(twin, name)
        height = along_mm(context, held_out.contacts.uv)
        scores[name] = {}
        for estimator in model.estimators:
            start = time.perf_counter()
            forces = decode_points(model.linear, held_out, estimator)
            seconds = time.perf_counter() - start
            arrays[f"{name}.{estimator}"] = contact_forces(
                forces, held_out.contacts, held_out.switching
            )
            scores[name][estimator] = score_contacts(
                forces,
                held_out.contacts,
                held_out.switching,
                height_mm=height,
                middle_mm=middle_mm(context),
            ) | {"milliseconds_per_frame": 1e3 * seconds / held_out.contacts.samples}
    return scores, arrays


def limit_facts(bundle: "Bundle") -> dict[str, Any]:
    """What the sensor cannot read, as figures: noise of K·u in N, marker ids, sentences."""
    noise = bundle.noise_centroid_px * bundle.model.stiffness_noise_N_px
    inverse = bundle.noise_centroid_px * bundle.model.inverse_noise_N_px
    unusable = ~bundle.stiffness_usable
    sensitivity = np.linalg.norm(bundle.model.shift_to_mm, axis=1)
    observed = sensitivity > 0.0
    # A scene's bundle reads no force off the receptors in play: their noise is no figure.
    in_play = bundle.notes.get("scene", {}).get("in_play", np.arange(len(noise)))
    noise, inverse = noise[in_play], inverse[in_play]
    return {
        "fem_noise_N_least": float(noise.min()),
        "fem_noise_N_median": float(np.median(noise)),
        "fem_unusable_count": int(unusable.sum()),
        "fem_unusable": np.flatnonzero(unusable).tolist(),
        "sensitivity_px_mm_least": float(1.0 / sensitivity.max()) if observed.all() else 0.0,
        "not_observable": np.flatnonzero(~observed).tolist(),
        "koi_inverse_noise_N_median": float(np.median(inverse)),
        "koi_inverse_noise_N_worst": float(inverse.max()),
        "force_unreadable": np.flatnonzero(~bundle.force_readable).tolist(),
        "switches_unreadable": np.flatnonzero(~bundle.tips.readable).tolist(),
        "sentences": bundle.limits(),
    }


def _rmse(network: Any, rows: Any) -> float:
    """Force error (root mean square, N) of a network on some key nodes."""
    error = rows.stiffness_force_N + network(rows.features) * rows.apparent_mm - rows.force_N
    return float(np.sqrt((error**2).mean())) if len(error) else float("nan")


def finish(design: Design, out: Path) -> None:
    """Mark the exported bundle with the design it is of, and its named regions."""
    from phytac_decoder.io.bundle_stamp import stamp_bundle
    from phytac_design.design.design_file import design_hash
    from phytac_design.layout.region_chart import design_regions

    stamp_bundle(
        out / "decoder",
        design=design.name,
        design_hash=design_hash(design),
        regions=design_regions(design),
    )


DECODER = Stage(
    name="decoder",
    reads=("markers", "cameras", "trips", "camera.noise_centroid_px", *TOUCH),
    needs=("views", "response", "places", "twin"),
    seeded=True,
    scene=("name", "networks", "regions", "reach_mm"),
    finish=finish,
    run=run,
)
