"""Exported URDF and SDF as the programs for them have it: yourdfpy, PyBullet and libsdformat."""

import json
import logging
import shutil
import subprocess
import sys
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from phytac_design.fabrication.simulators.model_files import FORMATS, piece_file, visual_file
from phytac_design.fabrication.simulators.simulator_part import SimulatorPart
from phytac_design.fabrication.simulators.xml_values import obj_text
from phytac_shapes.arrays import FloatArray

SDF_PROGRAM = Path(__file__).with_name("sdf_report.cpp")
BULLET = """
import json, sys
import pybullet as bullet
bullet.connect(bullet.DIRECT)
body = bullet.loadURDF(sys.argv[1], flags=bullet.URDF_USE_INERTIA_FROM_FILE)
facts = bullet.getDynamicsInfo(body, -1)
pieces = bullet.getCollisionShapeData(body, -1)
print(json.dumps({"mass": facts[0], "moments": facts[2], "pieces": len(pieces)}))
"""
"""In a process of its own: Bullet warns on the standard output."""
GREETING = "pybullet build time"


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A part as a program has it.

    Attributes
    ----------
    said : list of str
        Warnings and errors.
    mass_kg : float
        Of the base.
    moments : (3,) float
        Its principal moments of inertia, kg m², ascending.
    pieces : int
        Collision shapes that it loaded, -1 where it leaves meshes to others.
    receptors_m : (n, 3) float or None
        Origins of the receptors' frames in the base's, where the file has them.
    """

    said: list[str]
    mass_kg: float
    moments: FloatArray
    pieces: int = -1
    receptors_m: FloatArray | None = None


class Listener(logging.Handler):
    """Keeps what a library logs."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message."""
        self.said.append(record.getMessage())


def written(part: SimulatorPart, folder: Path, to: str, *, receptors: bool) -> Path:
    """Write a part with its meshes; returns the model's file."""
    folder.mkdir()
    meshes = {visual_file(name): mesh for name, (mesh, _) in part.visuals.items()}
    meshes |= {piece_file(number): mesh for number, mesh in enumerate(part.pieces)}
    for name, mesh in meshes.items():
        (folder / name).write_text(obj_text(mesh), encoding="ascii")
    for name, text in FORMATS[to](part, receptors=receptors, prefix="").items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / ("model.sdf" if to == "sdf" else f"{part.name}.urdf")


def in_yourdfpy(path: Path, receptors: int) -> Loaded:
    """Load a URDF with all meshes by yourdfpy."""
    import yourdfpy

    listener = Listener()
    logging.getLogger().addHandler(listener)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            robot = yourdfpy.URDF.load(
                str(path),
                build_collision_scene_graph=True,
                load_collision_meshes=True,
                force_mesh=False,
                force_collision_mesh=False,
            )
            robot.validate()
    finally:
        logging.getLogger().removeHandler(listener)
    said = listener.said + [str(one.message) for one in caught] + [str(e) for e in robot.errors]
    base = robot.link_map["base"]
    places = [robot.get_transform(f"receptor_{k}", "base")[:3, 3] for k in range(receptors)]
    return Loaded(
        said=said,
        mass_kg=float(base.inertial.mass),
        moments=np.linalg.eigvalsh(base.inertial.inertia),
        pieces=len(robot.collision_scene.geometry),
        receptors_m=np.array(places),
    )


def in_bullet(path: Path) -> Loaded:
    """Load a URDF by PyBullet, with the inertia that the file states."""
    words = [sys.executable, "-c", BULLET, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    *said, last = done.stdout.splitlines()
    facts = json.loads(last)
    lines = said + done.stderr.splitlines()
    return Loaded(
        said=[line for line in lines if line and not line.startswith(GREETING)],
        mass_kg=facts["mass"],
        moments=np.sort(facts["moments"]),
        pieces=facts["pieces"],
    )


def has_sdformat() -> bool:
    """Whether libsdformat and a compiler are here."""
    if not (shutil.which("pkg-config") and shutil.which("g++")):
        return False
    return subprocess.call(["pkg-config", "--exists", "sdformat12"]) == 0


@cache
def sdf_program() -> Path:
    """Compile the program that asks libsdformat (Debian: libsdformat-dev)."""
    program = Path(mkdtemp()) / "sdf_report"
    flags = ["pkg-config", "--cflags", "--libs", "sdformat12"]
    found = subprocess.run(flags, capture_output=True, text=True, check=True).stdout.split()
    words = ["g++", "-std=c++17", "-O0", str(SDF_PROGRAM), "-o", str(program), *found]
    subprocess.run(words, check=True)
    return program


def in_sdformat(path: Path) -> Loaded:
    """Load an SDF model by libsdformat, which leaves meshes to the simulator."""
    words = [str(sdf_program()), str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    rows = [line.split(maxsplit=1) for line in done.stdout.splitlines()]
    stated = {key: text for key, text in rows if key in {"mass", "centre"}}
    inertia = np.array([text.split() for key, text in rows if key == "inertia"], dtype=float)
    frames = [text.split() for key, text in rows if key == "frame"]
    places = [frame[1:] for frame in frames if frame[0].startswith("receptor_")]
    return Loaded(
        said=done.stderr.splitlines() + [text for key, text in rows if key == "error"],
        mass_kg=float(stated["mass"]),
        moments=np.asarray(np.linalg.eigvalsh(inertia), dtype=np.float64),
        receptors_m=np.array(places, dtype=np.float64),
    )
