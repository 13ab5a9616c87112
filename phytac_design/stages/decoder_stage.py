"""Train the paper's network, evaluate all estimators on held-out contacts, write the bundle."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.camera.camera_motion import MOUNTS, tabulate_camera_motion
from phytac_decoder.estimation.cascade_network import Activation
from phytac_decoder.estimation.contact_fit import MarkerNoise
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle import Bundle, CameraView, save_bundle, stamp_bundle
from phytac_decoder.io.sensor_limits import limits_of
from phytac_decoder.vision.switch_detection import RED_RATIO_MIN, RED_AREA_MIN_px, TipModel
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.engine.stage import EXPORT, Context, Stage, write_arrays, write_facts
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.layout.region_chart import design_regions
from phytac_design.simulation.dataset import Dataset, decode_points, key_node_data
from phytac_design.simulation.force_errors import contact_forces, score_contacts
from phytac_design.simulation.imaging.nominal_view import bundle_covers, bundle_marks, colour_model
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.simulation.switch_law import switch_law
from phytac_design.stages.places_stage import locator_of
from phytac_design.stages.response_stage import readers_of
from phytac_design.training.levenberg_marquardt import split_samples, train_network
from phytac_shapes.arrays import BoolArray, FloatArray


def untrained_model(context: Context) -> ForceModel:
    """Return the force model of the stages ``response`` and (if it ran) ``places`` alone."""
    response, readers = context.arrays("response"), readers_of(context)
    motion = tabulate_camera_motion(
        readers.cameras,
        readers.read_by,
        context.markers.tip_mm,
        MOUNTS["bench"],
    )
    return ForceModel(
        shift_to_mm=response["shift_to_mm"],
        stiffness=response["stiffness"],
        compliance_px=response["compliance_px"],
        height_z_mm=context.markers.mid_mm[:, 2].copy(),
        neighbours=context.markers.neighbours,
        networks={},
        locator=_locator(context) if "places" in context.folders else None,
        footprint_px=response["footprint_px"],
    ).with_camera_motion(motion, context.design.camera.noise_centroid_px)


def _locator(context: Context) -> ContactLocator:
    """Return the estimator ``auto`` by design, with its noise and its unreadable switches."""
    played, views = played_in(context), context.arrays("views")
    locator = locator_of(context)
    noise = MarkerNoise(
        still_px=views["noise_still_px"].reshape(-1), moved_px=views["noise_moved_px"].reshape(-1)
    )
    return replace(
        locator,
        noise=replace(locator.noise, markers=noise),
        blind=_tips(context, "tip_", played).blind(played),
    )


def _tips(context: Context, prefix: str, played: BoolArray, camera: int | None = None) -> TipModel:
    """Return the tips as the cameras see them; of all arrays of a prefix, or of one camera's."""
    views = context.arrays("views")
    own = slice(None) if camera is None else camera
    on, red_rest, red_on = (
        views[prefix + name][own] for name in ("on_px", "red_rest_px", "red_on_px")
    )
    tips = tips_in_play(on, red_rest, red_on, played)
    gradual = switch_law(context.design, context.markers).gradual
    return replace(tips, gradual=gradual) if gradual.any() else tips


def assemble_bundle(context: Context, model: ForceModel, notes: dict[str, Any]) -> Bundle:
    """Return the bundle of the stages ``views`` and ``response`` and a force model.

    It has no design name yet, see :func:`finish`.

    Parameters
    ----------
    context : Context
        Context with the results of both stages.
    model : ForceModel
        Model of :func:`untrained_model`, trained or not.
    notes : dict
        Provenance, plain JSON.
    """
    design, views = context.design, context.arrays("views")
    colours, classes = colour_model(design)
    readers = readers_of(context)
    played, law = played_in(context), switch_law(design, context.markers)
    shown = tuple(
        CameraView(rest_px=rest_px, tips=_tips(context, "shown_tip_", played, camera))
        for camera, rest_px in enumerate(views["shown_rest_px"])
    )
    return Bundle(
        design="",
        design_hash="",
        cameras=readers.cameras,
        read_by=readers.read_by,
        colours=colours,
        colour=classes[context.markers.colour],
        position_mm=context.surface.point(context.markers.uv),
        head_mm=context.markers.tip_mm,
        rest_px=views["rest_px"],
        tip_bias_px=views["tip_bias_px"],
        covers=bundle_covers(views),
        tips=_tips(context, "tip_", played),
        model=model,
        # No force explains a switch out of play, so it is reported as faulty in every frame: its
        # threshold is the largest force of a design.
        threshold_N=np.where(played, law.on_N, 1e4),
        noise_centroid_px=design.camera.noise_centroid_px,
        force_max_N=design.training.force_max_N,
        shown=shown if len(shown) > 1 else (),
        marks=bundle_marks(context.sensor, views),
        notes=notes,
    )


def played_in(context: Context) -> BoolArray:
    """Return the receptors (n,) that the decoder reads: in a scene those in play."""
    scope = scope_of(context)
    if scope is None:
        return np.ones(context.markers.count, dtype=np.bool_)
    return scope.in_play(context.markers)


def tips_in_play(
    on_px: FloatArray, red_rest_px: FloatArray, red_on_px: FloatArray, played: BoolArray
) -> TipModel:
    """Return tips as the decoder reads them.

    An unreadable switch out of play needs more red than any tip shows: otherwise the motion, which
    means nothing there, would decide.
    """
    tips = TipModel(on_px=on_px, red_rest_px=red_rest_px, red_on_px=red_on_px)
    never = 4.0 * (RED_RATIO_MIN * red_rest_px + RED_AREA_MIN_px)
    return replace(tips, red_on_px=np.where(played | tips.readable, red_on_px, never))


def run(context: Context, folder: Path) -> None:
    """Write ``decoder/bundle.{json,safetensors}`` and the table of estimators."""
    twin = context.arrays("twin")
    model = untrained_model(context)
    training: dict[str, Any] = {"key_nodes": 0, "samples": 0}
    wanted = context.scene is None or context.scene.networks
    if wanted and not model.without_switches:
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
    """Return the notes of a scene's bundle, which reads forces on receptors in play alone."""
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
    """Train the networks of the paper into ``model``; return figures of the fit."""
    # The data are of a linear shell.
    rows = key_node_data(model.linear, data)
    first, second, third = split_samples(data.contacts.samples, seed=context.seed)
    training: dict[str, Any] = {"key_nodes": len(rows.force_N), "samples": data.contacts.samples}
    # Both readings of the paper's "linear unit".
    activations: dict[str, Activation] = {"fem_nn": "rectified", "fem_nn_identity": "identity"}
    for name, activation in activations.items():
        context.progress(f"decoder: training {name}")
        fit = train_network(
            rows.take(first),
            rows.take(second),
            activation=activation,
            seed=context.seed,
            base="key_nodes",
        )
        model.networks[name] = fit.network
        training[name] = {
            "seconds": fit.seconds,
            "rounds": fit.rounds,
            "rmse_train_N": fit.rmse_train_N,
            "rmse_validation_N": fit.rmse_validation_N,
            "rmse_test_split_N": rows.take(third).rmse_N(fit.network),
        }
    return training


def evaluate_estimators(
    context: Context, model: ForceModel, twin: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Return scores of every estimator on both held-out sets, and the decoded forces (c,), N."""
    scores: dict[str, Any] = {}
    arrays: dict[str, FloatArray] = {}
    for name in ("test", "anywhere"):
        held_out = Dataset.from_arrays(twin, name)
        height = along_mm(context.surface, held_out.contacts.uv)
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
                middle_mm=middle_mm(context.surface),
            ) | {"milliseconds_per_frame": 1e3 * seconds / held_out.contacts.samples}
    return scores, arrays


def limit_facts(bundle: Bundle) -> dict[str, Any]:
    """Return the limits of the sensor: noise of K·u in N, marker ids, sentences."""
    noise = bundle.noise_centroid_px * bundle.model.stiffness_noise_N_px
    inverse = bundle.noise_centroid_px * bundle.model.inverse_noise_N_px
    unusable = ~bundle.stiffness_usable
    sensitivity = np.linalg.norm(bundle.model.shift_to_mm, axis=1)
    observed = sensitivity > 0.0
    # A scene's bundle reads forces on receptors in play alone.
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
        "sentences": limits_of(bundle),
    }


def finish(design: Design, out: Path) -> None:
    """Write the design's name, hash and regions into the exported bundle."""
    stamp_bundle(
        out / "decoder",
        design=design.name,
        design_hash=design_hash(design),
        regions=design_regions(design),
    )


DECODER = Stage(
    name="decoder",
    design_fields=("markers", "cameras", "trips", "camera.noise_centroid_px", "touch", "paints"),
    depends_on=("views", "response", "places", "twin"),
    seeded=True,
    scene=("name", "networks", "regions", "reach_mm"),
    finish=finish,
    run=run,
)
