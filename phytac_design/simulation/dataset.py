"""Simulated data sets: contacts, their truth, and what was measured."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import network_features
from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.datasets.samples import KeyNodeData
from phytac_design.simulation.contacts import Contacts, Switching
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """One data set.

    Attributes
    ----------
    contacts : Contacts
        What was pressed.
    switching : Switching
        What the switches did, and the truth per receptor.
    shift_px : (samples, n, 2) float
        Measured marker shifts, noise included.
    """

    contacts: Contacts
    switching: Switching
    shift_px: FloatArray

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], name: str) -> "Dataset":
        """Read the set ``name`` from a stage's arrays (keys ``name.field``)."""
        part = {key.removeprefix(f"{name}."): arrays[key] for key in arrays if key.startswith(name)}

        def fields_of(kind: type) -> dict[str, Any]:
            return {item.name: part[item.name] for item in fields(kind) if item.name in part}

        return cls(
            contacts=Contacts(**fields_of(Contacts), samples=len(part["bits"])),
            switching=Switching(**fields_of(Switching)),
            shift_px=part["shift_px"],
        )

    def arrays(self, name: str) -> dict[str, Any]:
        """Arrays for a stage, keys ``name.field``."""
        held = vars(self.contacts) | vars(self.switching) | {"shift_px": self.shift_px}
        # How far tips are out shows in pictures alone.
        left = {"samples", "out"}
        return {f"{name}.{key}": value for key, value in held.items() if key not in left}


def key_node_data(model: ForceModel, data: Dataset) -> KeyNodeData:
    """One training row per switch that is on (paper, eq. 2), with forces on key nodes as base."""
    sample, marker = np.nonzero(data.switching.bits)
    apparent = np.stack(
        [
            model.pressed_mm(shift, np.flatnonzero(bits))
            for shift, bits in zip(data.shift_px, data.switching.bits, strict=True)
        ]
    )
    features = [
        network_features(apparent[s], model.neighbours, model.height_z_mm, np.flatnonzero(bits))
        for s, bits in enumerate(data.switching.bits)
    ]
    base = [
        model.base_forces("key_nodes", data.shift_px[s], apparent[s], np.flatnonzero(bits))
        for s, bits in enumerate(data.switching.bits)
    ]
    return KeyNodeData(
        features=np.concatenate(features),
        apparent_mm=apparent[sample, marker],
        stiffness_force_N=np.concatenate(base),
        force_N=data.switching.receptor_force_N[sample, marker],
        sample=sample,
    )


def decode_points(model: ForceModel, data: Dataset, estimator: str) -> FloatArray:
    """Decoded receptor forces (samples, n) N of one estimator, from measured shifts and bits."""
    read = data.switching.bits & (not model.without_switches)
    return np.stack(
        [
            model.forces(estimator, shift, np.flatnonzero(bits))
            for shift, bits in zip(data.shift_px, read, strict=True)
        ]
    )
