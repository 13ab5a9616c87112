"""The paper's end-to-end baseline: a convolutional network from camera frame to contact forces.

Five convolutions of 3 × 3 halve the image each, rectified linear. At a marker's position in the
image without load, the difference of the image to that image and all five layers are interpolated;
these 299 numbers and the position go through two hidden layers to the marker's force. That is
758 361 parameters, the paper's 758.4 K, whose layers are not published.

The network knows no mechanics. As for the FEM-NN, the switches that are on are given, and the
network estimates how much force each of them carries. (With as many parameters and one output per
marker, 598 samples taught nothing: held-out errors were those of the mean.)

It serves the comparison in ``decoder_cnn.py``; no command and no bundle uses it.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional

from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.datasets.samples_file import FRAMES
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

FRAME_PX = (160, 120)
"""Width and height of the reduced frame."""
COLOURS = 3
CHANNELS = (16, 24, 64, 64, 128)
"""Channels of the convolutions; with the hidden layers chosen for the paper's number."""
HIDDEN = 656
KERNEL = 3


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Settings of the training.

    Attributes
    ----------
    epochs : int
        Largest number of passes through the training frames.
    patience : int
        Training ends after so many epochs without a lower validation loss; the best one is kept.
    batch : int
        Frames per step.
    rate, decay : float
        Learning rate and weight decay of AdamW; the rate falls to a third after
        ``patience`` / 3 epochs without improvement.
    dropout : float
        Share of inputs dropped before each hidden layer in training.
    added : float
        Share of training frames to which another one is added, with its forces: the effects of
        contacts on an image are nearly additive.
    threads : int
        Processor threads; with one the result does not depend on their number.
    """

    epochs: int = 150
    patience: int = 24
    batch: int = 16
    rate: float = 1e-3
    decay: float = 1e-2
    dropout: float = 0.2
    added: float = 0.5
    threads: int = 1


@dataclass(frozen=True, kw_only=True)
class TrainedCnn:
    """A trained network, how long it took, and its errors per marker (root mean square).

    Attributes
    ----------
    rest : (h, w, 3) float32
        Frame without load, blue, green, red: the median of the training frames.
    places : (n, 2) float
        Positions of the markers in it, from -1 to 1 across and down.
    scale_in, scale_out_N : float
        Divisor of pixel differences, and factor on outputs.
    weights : dict of array
        Weights by the layer's name.
    seconds : float
        Training time.
    rounds : int
        Epochs until the best.
    rmse_train_N, rmse_validation_N : float
        Errors on receptors whose switches are on.
    """

    rest: FloatArray
    places: FloatArray
    scale_in: float
    scale_out_N: float
    weights: dict[str, FloatArray]
    seconds: float
    rounds: int
    rmse_train_N: float
    rmse_validation_N: float

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return sum(array.size for array in self.weights.values())

    def forces(self, images: FloatArray, on: BoolArray) -> FloatArray:
        """Inward force, (s, n) N and not negative, on markers whose switch is on; 0 on others.

        Parameters
        ----------
        images : (s, h, w, 3) float32
            Reduced frames of the size that was trained on.
        on : (s, n) bool
            Switches.
        """
        size = (len(images), len(self.places))
        model = network()
        model.load_state_dict({k: torch.from_numpy(v) for k, v in self.weights.items()})
        x = _differences(images, self.rest, self.scale_in)
        places = torch.from_numpy(self.places.astype(np.float32))
        found = _run(model, _Part(x, torch.zeros(size), torch.from_numpy(on), places))
        out = np.zeros(size)
        out[on] = np.maximum(found * self.scale_out_N, 0.0)
        return out


def network(dropout: float = 0.0) -> Any:
    """Layers of the network, with random weights."""
    layers: dict[str, Any] = {}
    before = COLOURS
    for k, channels in enumerate(CHANNELS):
        layers[f"conv{k}"] = nn.Conv2d(before, channels, KERNEL, stride=2, padding=KERNEL // 2)
        before = channels
    layers["drop"] = nn.Dropout(dropout)
    layers["first"] = nn.Linear(COLOURS + sum(CHANNELS) + 2, HIDDEN)
    layers["second"] = nn.Linear(HIDDEN, HIDDEN)
    layers["head"] = nn.Linear(HIDDEN, 1)
    # Channels last takes a third less time on a processor.
    return nn.ModuleDict(layers).to(memory_format=torch.channels_last)


def outputs(model: Any, x: Any, places: Any, sample: Any, marker: Any) -> Any:
    """Scaled force (k,) on some markers of some frames x (s, 3, h, w); places are (n, 2)."""
    values = [_sample_at(x, places, sample, marker)]
    for k in range(len(CHANNELS)):
        x = functional.relu(model[f"conv{k}"](x))
        values.append(_sample_at(x, places, sample, marker))
    values.append(places[marker])
    out = model["drop"](torch.cat(values, dim=1))
    out = model["drop"](functional.relu(model["first"](out)))
    return model["head"](functional.relu(model["second"](out)))[:, 0]


def _sample_at(layer: Any, places: Any, sample: Any, marker: Any) -> Any:
    """Values (k, c) of a layer (s, c, h, w) at markers' places, between its pixels."""
    at = places.expand(len(layer), -1, -1)[:, :, None]
    values = functional.grid_sample(layer, at, padding_mode="border", align_corners=False)
    return values[sample, :, marker, 0]


def parameter_count() -> int:
    """Number of parameters, 758 361."""
    return sum(p.numel() for p in network().parameters())


def train_cnn(
    images: FloatArray,
    on: BoolArray,
    force_N: FloatArray,
    *,
    places: FloatArray,
    training: IntArray,
    validation: IntArray,
    seed: int,
    settings: TrainingSettings | None = None,
) -> TrainedCnn:
    """Train the baseline; on one machine the same inputs give the same network.

    The loss is the mean squared error of the force on receptors whose switches are on.

    Parameters
    ----------
    images : (s, h, w, 3) float32
        Reduced frames.
    on : (s, n) bool
        Switches that are on.
    force_N : (s, n) float
        True force on every receptor.
    places : (n, 2) float
        Positions of the markers in the frame without load.
    training, validation : (t,), (v,) int
        Training samples, and validation samples that decide when to stop.
    seed : int
        Seed of the initial weights, the order of frames, additions and dropout.
    settings : TrainingSettings, optional
        Settings.
    """
    settings = settings or TrainingSettings()
    begin = time.perf_counter()
    rest = np.median(images[training], axis=0)
    scale_in = max(float((images[training] - rest).std()), 1e-9)
    carried = force_N[training][on[training]]
    scale_out = float(np.sqrt((carried**2).mean()))
    whole = _Part(
        _differences(images, rest, scale_in),
        torch.from_numpy((force_N / scale_out).astype(np.float32)),
        torch.from_numpy(on),
        torch.from_numpy(places.astype(np.float32)),
    )
    with torch.random.fork_rng(devices=[]), _threads(settings.threads):
        torch.manual_seed(seed)
        best = _fit(
            network(settings.dropout), whole.take(training), whole.take(validation), settings
        )
    return TrainedCnn(
        rest=rest,
        places=places,
        scale_in=scale_in,
        scale_out_N=scale_out,
        weights=best.weights,
        seconds=time.perf_counter() - begin,
        rounds=best.rounds,
        rmse_train_N=scale_out * best.loss_train**0.5,
        rmse_validation_N=scale_out * best.loss_validation**0.5,
    )


class _Best(NamedTuple):
    weights: dict[str, FloatArray]
    rounds: int
    loss_train: float
    loss_validation: float


class _Part(NamedTuple):
    """Scaled frames, scaled forces, switches, and places of all markers."""

    x: Any
    y: Any
    on: Any
    places: Any

    def take(self, rows: Any) -> "_Part":
        """Return some of the samples."""
        return _Part(self.x[rows], self.y[rows], self.on[rows], self.places)

    def outputs(self, model: Any) -> Any:
        """Return scaled forces (k,) of a network on the switches that are on."""
        sample, marker = torch.nonzero(self.on, as_tuple=True)
        return outputs(model, self.x, self.places, sample, marker)

    def added(self, pool: "_Part", share: float) -> "_Part":
        """Add other samples of a pool to a share of the samples."""
        other = pool.take(torch.randint(len(pool.x), (len(self.x),)))
        use = torch.rand(len(self.x)) < share
        return _Part(
            self.x + use[:, None, None, None] * other.x,
            self.y + use[:, None] * other.y,
            self.on | (use[:, None] & other.on),
            self.places,
        )


def _fit(model: Any, training: _Part, validation: _Part, settings: TrainingSettings) -> _Best:
    optimiser = torch.optim.AdamW(model.parameters(), lr=settings.rate, weight_decay=settings.decay)
    schedule = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser, factor=1.0 / 3.0, patience=max(settings.patience // 3, 1)
    )
    best = _Best({}, 0, float("inf"), float("inf"))
    for number in range(1, settings.epochs + 1):
        model.train()
        for rows in torch.randperm(len(training.x)).split(settings.batch):
            part = training.take(rows).added(training, settings.added)
            if not part.on.any():
                continue
            optimiser.zero_grad()
            ((part.outputs(model) - part.y[part.on]) ** 2).mean().backward()
            optimiser.step()
        found = _loss(model, validation)
        schedule.step(found)
        if found < best.loss_validation:
            best = _Best(_numbers(model), number, _loss(model, training), found)
        elif number - best.rounds >= settings.patience:
            break
    return best


def _numbers(model: Any) -> dict[str, FloatArray]:
    return {name: value.numpy().copy() for name, value in model.state_dict().items()}


def _loss(model: Any, part: _Part) -> float:
    return float(((_run(model, part) - part.y[part.on].numpy()) ** 2).mean())


def _run(model: Any, part: _Part) -> FloatArray:
    """Return outputs of the network without dropout, in the order of the switches that are on."""
    model.eval()
    rows = torch.arange(len(part.x)).split(64)
    with torch.no_grad():
        found = [part.take(some).outputs(model).numpy() for some in rows]
    return np.concatenate([np.zeros(0, dtype=np.float32), *found])


def _differences(images: FloatArray, rest: FloatArray, scale: float) -> Any:
    """Scaled differences to the frame without load, (s, 3, h, w)."""
    out = (images - rest.astype(np.float32)).astype(np.float32) / np.float32(scale)
    return torch.from_numpy(out).permute(0, 3, 1, 2)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def places_in_frame(rest_px: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Places (n, 2) from -1 to 1 of pixel positions (n, 2) in frames of a width and height."""
    return np.asarray((rest_px + 0.5) / np.asarray(size_px) * 2.0 - 1.0)


def reduced(frame: ImageArray) -> FloatArray:
    """A frame (h, w, 3) at the network's size, float32, by averaging areas."""
    whole = frame.astype(np.float32)
    return np.asarray(cv2.resize(whole, FRAME_PX, interpolation=cv2.INTER_AREA))


def read_frames(folder: Path, samples: IntArray) -> FloatArray:
    """Reduced frames (s, h, w, 3) of some samples of a data set that kept its frames."""
    out = np.zeros((len(samples), FRAME_PX[1], FRAME_PX[0], COLOURS), dtype=np.float32)
    for k, sample in enumerate(samples.tolist()):
        path = folder / FRAMES / f"{sample:06d}.png"
        frame = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert frame is not None, f"{path} is missing or no picture; keep frames of one camera"
        out[k] = reduced(np.asarray(frame, dtype=np.uint8))
    return np.asarray(out)


def marker_forces(samples: Samples) -> FloatArray:
    """True force on every receptor whose switch is on, 0 on the others, (s, n) N."""
    assert samples.truth is not None
    out = np.zeros((samples.count, samples.markers))
    np.add.at(out, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    out[samples.status == FAILED] = 0.0
    return out
