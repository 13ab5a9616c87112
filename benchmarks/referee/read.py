"""The solved contacts of a design: one ``.npz`` with reproducible bytes.

A file holds ``about`` (JSON: the sensor's hash and, for each contact, what was solved and how it
went), and, one contact's after the other's, the arrays ``ids`` (receptors), ``motion`` (their tips'
displacement in steps of the contact's ``step_mm``), ``kept`` and ``turn`` (receptors modelled with
their tubes, and the rotation of their end faces in steps of ``step_rad``).
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.referee.contacts import DATA, Contact
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

MOTION_MIN_SHARE = 1e-3
"""Tips that move less than this share of the peak are left out."""
STEPS = 30_000
"""The largest component of an array is this many steps."""
ARRAYS = ("ids", "motion", "kept", "turn")


@dataclass(frozen=True, kw_only=True)
class Solved:
    """One solved contact.

    Attributes
    ----------
    index : int
        Its place in the frozen list.
    contact : Contact
        The load.
    motion_mm : (n, 3) float
        Displacement of the centre of every receptor's end face; 0 where below ``MOTION_MIN_SHARE``.
    kept : (k,) int
        Receptors that were modelled with tube and hole; the others stand on a smeared wall.
    turn_rad : (k, 3) float
        Rotation vectors of the end faces of those.
    facts : mapping
        ``peak_mm`` (largest motion of a tip), ``factor`` (of the load, 1), ``residual``,
        ``correction``, ``increments``, ``iterations``, ``nodes``, ``tets``, ``resultant_N``,
        ``ccx``, ``gmsh``, ``script`` (hash of the code that made it), ``key`` (of its inputs).
    """

    index: int
    contact: Contact
    motion_mm: FloatArray
    kept: IntArray
    turn_rad: FloatArray
    facts: Mapping[str, Any]

    @property
    def peak_mm(self) -> float:
        """Largest motion of a tip."""
        return float(self.facts["peak_mm"])

    @property
    def largest_N(self) -> float:
        """Force of the strongest patch."""
        return max(self.contact.force_N)


def sensor_hash(design: Design, markers: Markers) -> str:
    """Hash of what the mechanics of a sensor depend on: wall, material, receptors' places."""
    # Places count as the same within 1e-5 mm.
    places = np.rint(np.concatenate([markers.mid_mm, markers.tip_mm]) / 1e-5).astype("<i8")
    facts = {
        "shape": design.shape.model_dump(mode="json"),
        "thickness_mm": design.wall.thickness_mm,
        "diameters_mm": [design.receptor.diameter_outer_mm, design.receptor.diameter_hole_mm],
        "material": [design.material.modulus_MPa, design.material.poisson],
    }
    text = json.dumps(facts, sort_keys=True).encode()
    return hashlib.sha256(text + places.tobytes()).hexdigest()


def data_file(name: str) -> Path:
    """File of a design's solved contacts."""
    return DATA / f"{name}.npz"


def read_solved(path: Path, design: Design, markers: Markers) -> list[Solved]:
    """Solved contacts in the order of the frozen list.

    Raises
    ------
    DesignError
        If the file cannot be read or belongs to another sensor.
    """
    about, arrays = _load(path)
    if about["sensor"] != sensor_hash(design, markers):
        raise DesignError(
            "referee-sensor-differs",
            f"{path.name} was solved for another sensor than {design.name!r} is now: its shape, "
            "wall, material or receptors differ; solve it again with benchmarks.referee.solve",
        )
    out, first = [], {"ids": 0, "kept": 0}
    for row in about["contacts"]:
        part = {
            name: arrays[name][first[by] : first[by] + row[by]]
            for name, by in (("ids", "ids"), ("motion", "ids"), ("kept", "kept"), ("turn", "kept"))
        }
        first = {by: first[by] + row[by] for by in first}
        out.append(_unpack(row, part, markers.count))
    return out


def write_solved(path: Path, design: Design, markers: Markers, solved: list[Solved]) -> None:
    """Write solved contacts; the same ones give the same bytes. The file is replaced as a whole."""
    packed = [_pack(item) for item in sorted(solved, key=lambda one: one.index)]
    rows = [row for row, _ in packed]
    arrays: dict[str, Any] = {
        name: np.concatenate([mine[name] for _, mine in packed]) for name in ARRAYS
    }
    about = {"schema": 1, "sensor": sensor_hash(design, markers), "contacts": rows}
    text = np.frombuffer(json.dumps(about, sort_keys=True).encode(), dtype=np.uint8)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, about=text, **arrays)
    part.replace(path)


def _load(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    try:
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays.pop("about").tobytes())
    except Exception as error:  # zip, zlib, JSON and numpy each raise their own
        raise DesignError(
            "referee-file-invalid", f"{path} is no referee file ({error!r}); restore it"
        ) from error
    return about, arrays


def _pack(item: Solved) -> tuple[dict[str, Any], dict[str, Any]]:
    size = np.linalg.norm(item.motion_mm, axis=1)
    ids = np.flatnonzero(size >= MOTION_MIN_SHARE * item.peak_mm)
    motion, step_mm = _steps(item.motion_mm[ids])
    turn, step_rad = _steps(item.turn_rad)
    row = {
        "index": item.index,
        "kind": item.contact.kind,
        "uv": item.contact.uv,
        "radius_mm": item.contact.radius_mm,
        "force_N": item.contact.force_N,
        "step_mm": step_mm,
        "step_rad": step_rad,
        "ids": len(ids),
        "kept": len(item.kept),
        "facts": dict(item.facts),
    }
    kept = item.kept.astype("<u2")
    return row, {"ids": ids.astype("<u2"), "motion": motion, "kept": kept, "turn": turn}


def _steps(values: FloatArray) -> tuple[Any, float]:
    step = float(np.abs(values).max(initial=0.0)) / STEPS
    return np.rint(values / (step or 1.0)).astype("<i2"), step


def _unpack(row: Mapping[str, Any], part: Mapping[str, Any], count: int) -> Solved:
    motion = np.zeros((count, 3))
    motion[part["ids"]] = part["motion"] * row["step_mm"]
    return Solved(
        index=row["index"],
        contact=Contact(
            kind=row["kind"],
            uv=tuple((float(u), float(v)) for u, v in row["uv"]),
            radius_mm=tuple(row["radius_mm"]),
            force_N=tuple(row["force_N"]),
        ),
        motion_mm=motion,
        kept=part["kept"].astype(np.int64),
        turn_rad=part["turn"] * row["step_rad"],
        facts=row["facts"],
    )
