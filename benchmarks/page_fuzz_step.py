"""Spoilt STEP files, on which OpenCASCADE may crash, but not the program."""

import random
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.page_fuzz_change import changed
from phytac_design.solids.step_surface import surface_from_step
from phytac_shapes.errors import PhytacError

HOSTILE = (
    b"",
    b"\0" * 10_000,
    b"ISO-10303-21;" + b"\xff" * 10_000,
    b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=X(" + b"(" * 100_000,
    b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n"
    + b"#1=CARTESIAN_POINT('',(1E999,NAN,#1));\n" * 20_000,
    b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=ADVANCED_FACE('',(#1),#1,.T.);\nENDSEC;\n",
)


def seeds(folder: Path) -> list[bytes]:
    """A free-form face and a box, as STEP."""
    from phytac_design.solids.cad_kernel import cadquery

    cq = cadquery()
    points = [
        [cq.Vector(x, y, 9 - 0.01 * x * y) for y in range(0, 50, 10)] for x in range(0, 50, 10)
    ]
    parts = (cq.Face.makeSplineApprox(points, tol=1e-6), cq.Workplane().box(10, 20, 30).val())
    out = []
    for part in parts:
        cq.exporters.export(cq.Workplane(part), str(folder / "seed.step"))
        out.append((folder / "seed.step").read_bytes())
    return out


def spoilt(number: int, sound: list[bytes]) -> bytes:
    """STEP file of a number; the first are those of ``HOSTILE``."""
    if number < len(HOSTILE):
        return HOSTILE[number]
    rng = random.Random(f"step {number}")  # noqa: S311 - nothing secret
    return changed(rng, rng.choice(sound), sound)


def outcome(path: Path) -> str:
    """What became of a file: ``read``, ``refused``, ``crashed``, ``no end``; or another error."""
    try:
        surface_from_step(path)
    except PhytacError as error:
        if "OpenCASCADE crashed" in str(error):
            return "crashed"
        return "no end" if "no end within" in str(error) else "refused"
    except Exception as error:  # noqa: BLE001 - every other one is what is looked for
        return f"{type(error).__name__}: {error}"
    return "read"


def outcomes(count: int, seconds: float) -> tuple[Counter[str], float]:
    """Count of each outcome, and files a second; ends after so many seconds."""
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        sound = seeds(Path(name))
        path = Path(name) / "x.step"
        begin = time.monotonic()
        for number in range(count):
            path.write_bytes(spoilt(number, sound))
            found[outcome(path)] += 1
            if time.monotonic() - begin > seconds:
                break
        rate = found.total() / (time.monotonic() - begin)
    return found, rate
