"""Molds of every shipped design, both ways, judged from the files as they are printed.

The STL files are read back, shrunk as print, silicone and rubber shrink, and closed: what is left
between the halves must be the switch.
"""

import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table, arguments
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, write_facts
from phytac_design.fabrication.molds.audit import (
    Audit,
    audit_set,
    fine_sections,
    releases_of,
)
from phytac_design.fabrication.molds.make import TURNED, MoldSet, make_molds
from phytac_design.fabrication.molds.rules import rule_rows
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import make_markers
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.design import design_switch
from phytac_design.mechanics.switch.report import switch_dict
from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
from phytac_design.solids.solid_mesh import to_manifold
from phytac_design.stages.build import copy_of
from phytac_design.stages.mold import MOLD
from phytac_design.stages.switch import switches_of
from phytac_shapes.errors import PhytacError

WAYS = ("rigid", "silicone-master")
FAULTS = (
    "Degenerate facets", "Edges fixed", "Facets removed", "Facets added", "Facets reversed",
    "Backwards edges", "Normals fixed", "Total disconnected facets",
)  # fmt: skip
SLICE_s = 600.0
"""Longest time that the slicer gets for one plate."""
COARSE = ("--layer-height", "0.3", "--fill-density", "5%")  # fast; takes the same solids
SMALL = ("hemisphere", "patch", "plane")
"""Designs whose plates are all sliced; of the others the largest of the rigid mold."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """Molds of a design in one way: as built again, and the files of the stage."""

    context: Context
    sets: list[MoldSet]
    folder: Path
    seconds: float

    def file(self, each: MoldSet, name: str) -> Path:
        """STL of a part."""
        return self.folder / "export" / "mold" / f"{name}_{each.plan.number}.stl"


def context_of(design: Design, preset: str, switch: Path) -> Context:
    """Context of the mold's stage; ``switch`` is the result of the switch's."""
    return Context(
        design=design,
        accuracy=PRESETS[preset],
        seed=0,
        folders={"switch": switch},
        progress=lambda _: None,
    )


def fitted(design: Design, folder: Path) -> Path:
    """Fit a design's bowls; what the mold's stage reads of them."""
    surface, rubber, space = design.surface(), rubber_of(design), space_of(design)
    wanted = np.unique(thresholds_N(design, make_markers(design, surface)))
    made = [switch_dict(design_switch(float(force), rubber, space)) for force in wanted]
    folder.mkdir()
    write_facts(folder, {"switches": made})
    return folder


def make(design: Design, way: str, preset: str, folder: Path) -> Made:
    """Run the stage of one design and way."""
    context = context_of(copy_of(design, mold={"way": way}), preset, folder / "switch")
    target = folder / way
    target.mkdir()
    start = time.process_time()
    MOLD.run(context, target)
    seconds = time.process_time() - start
    sets = make_molds(
        context.design.mold,
        context.design.print_rules,
        switches_of(context),
        tolerance_mm=context.accuracy.cad_tolerance_mm,
    )
    return Made(context=context, sets=sets, folder=target, seconds=seconds)


def read_stl(path: Path) -> TriangleMesh:
    """Mesh of a binary STL file, equal corners joined."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(path.read_bytes()[84:], dtype=record)["corners"].reshape(-1, 3)
    points, ids = np.unique(corners, axis=0, return_inverse=True)
    return TriangleMesh(
        vertices_mm=points.astype(np.float64), triangles=ids.reshape(-1, 3).astype(np.int64)
    )


def used(made: Made, each: MoldSet) -> MoldSet:
    """Read a set's files, shrink them as printer (and silicone) do, and put them together."""
    section = made.context.design.mold
    shrunk = 1.0 - section.shrink_print
    if section.way == "silicone-master":
        shrunk *= 1.0 - section.shrink_silicone
    parts = {}
    for name, ideal in each.parts.items():
        mesh = read_stl(made.file(each, name))
        points = shrunk * mesh.vertices_mm * ([1.0, -1.0, -1.0] if name in TURNED else 1.0)
        points[:, 2] += ideal.vertices_mm[:, 2].min() - points[:, 2].min()
        parts[name] = TriangleMesh(vertices_mm=points, triangles=mesh.triangles)
    return MoldSet(plan=each.plan, sizes=each.sizes, parts=parts)


def closed_rows(table: Table, label: str, made: Made) -> None:
    """Closed molds from the files: release, mates, cavities."""
    section, tolerance = made.context.design.mold, made.context.accuracy.cad_tolerance_mm
    switches = switches_of(made.context)
    fine = fine_sections(switches)
    audits: list[Audit] = []
    sound = True
    for each in made.sets:
        real = used(made, each)
        for name, mesh in real.parts.items():
            solid = to_manifold(mesh)
            holes = each.plan.cavities if name == "core_plate" else 0
            sound &= len(solid.decompose()) == 1 and solid.genus() == holes
        audits.append(audit_set(real, fine))
    rays = sum(release.rays for audit in audits for release in audit.releases.values())
    add = table.add
    add(
        f"{label}: watertight, one body, one hole for each stem and no other",
        float(sound),
        "-",
        reference=1,
        source=f"{len(made.sets)} sets, manifold3d on the STL files",
        target="== 1",
    )
    add(
        f"{label}: rays along the pull that are caught",
        sum(audit.caught for audit in audits),
        "-",
        reference=rays,
        source="rays, 0.1 mm apart, all parts",
        target="== 0",
    )
    add(
        f"{label}: least draft of any face",
        min(audit.draft_deg for audit in audits),
        "deg",
        reference=section.draft_deg,
        source="mold.draft_deg; files are in single precision",
        target=f">= {section.draft_deg - 2e-3:g}",
    )
    add(
        f"{label}: volume that closed parts share",
        max(audit.shared_mm3 for audit in audits),
        "mm3",
        reference=0,
        source="boolean intersection; single precision of the files times the area of contact",
        target="<= 0.05",
    )
    add(
        f"{label}: clearance of the keys against what is asked",
        max(abs(audit.key_gap_mm - section.key_clearance_mm) for audit in audits),
        "mm",
        reference=section.key_clearance_mm,
        source="least distance of peg and socket",
        target="<= 0.001",
    )
    add(
        f"{label}: volume of the cavities, worst error",
        100.0 * max(audit.volume_error for audit in audits),
        "%",
        reference=len(switches.kinds),
        source="kinds of switches, each one's section revolved; cavities shrunk",
        target="<= 0.5",
    )
    add(
        f"{label}: Hausdorff distance of the shrunk cavities from the switches",
        max(audit.hausdorff_mm for audit in audits),
        "mm",
        reference=tolerance,
        source="tolerance of the mesh",
        target=f"<= {tolerance:g}",
    )


def size_rows(table: Table, label: str, made: Made) -> None:
    """Plates against the bed and the rules, triangles, files, time."""
    rules = made.context.design.print_rules
    sizes = [
        (np.ptp(each.printed(name).vertices_mm, axis=0), len(mesh.triangles))
        for each in made.sets
        for name, mesh in each.parts.items()
    ]
    add = table.add
    add(
        f"{label}: largest plate over the bed",
        max(max(size[:2] / sorted(rules.bed_mm[:2], reverse=True)) for size, _ in sizes),
        "ratio",
        reference=max(float(size.max()) for size, _ in sizes),
        source=f"largest side, mm; {len(sizes)} parts",
        target="<= 1",
    )
    add(
        f"{label}: triangles of the largest plate",
        max(count for _, count in sizes),
        "-",
        reference=max(each.plan.cavities for each in made.sets),
        source="cavities of the fullest set",
        target="<= 1000000",
    )
    wrong = [row["detail"] for row in rule_rows(made.sets[0].sizes) if not row["holds"]]
    add(
        f"{label}: details against the printer's rules",
        len(wrong),
        "-",
        reference=len(rule_rows(made.sets[0].sizes)),
        source=", ".join(wrong) or f"details checked, {rules.process}",
        target="== 0",
    )
    add(
        f"{label}: stage mold, {len(made.sets)} sets",
        made.seconds,
        "s of one core",
        reference=sum(each.plan.cavities for each in made.sets),
        source="cavities; audit and files included",
        target="<= 15",
    )


def repairs(path: Path) -> int:
    """All faults that admesh counts in a file."""
    report = subprocess.run(["admesh", str(path)], capture_output=True, text=True, check=True)
    lines = dict(line.split(":", 1) for line in report.stdout.splitlines() if ":" in line)
    counts = {key.strip(): value.split() for key, value in lines.items()}
    return sum(int(counts[row][0]) for row in FAULTS)


def outside_rows(table: Table, label: str, made: Made, *, slices: int) -> None:
    """Admesh on every file, prusa-slicer on the largest ones."""
    paths = [(made.file(each, name), name) for each in made.sets for name in each.parts]
    if shutil.which("admesh"):
        table.add(
            f"{label}: repairs by admesh",
            sum(repairs(path) for path, _ in paths),
            "-",
            reference=len(paths),
            source="files; all its counts of faults",
            target="== 0",
        )
    if not shutil.which("prusa-slicer"):
        return
    paths.sort(key=lambda item: -item[0].stat().st_size)
    for path, name in paths[:slices]:
        target = made.folder / f"{path.stem}.gcode"
        start = time.perf_counter()
        try:
            done = subprocess.run(
                ["prusa-slicer", *COARSE, "--export-gcode", str(path), "-o", str(target)],
                capture_output=True,
                check=False,
                timeout=SLICE_s,
            )
            sliced = done.returncode == 0 and target.stat().st_size > 100_000
        except (subprocess.TimeoutExpired, FileNotFoundError):
            sliced = False
        table.add(
            f"{label}: {path.stem} sliced by prusa-slicer",
            float(sliced),
            "-",
            reference=1,
            source=f"G-code of the {name} in {time.perf_counter() - start:.1f} s",
            target="== 1",
        )


def embree_row(table: Table, label: str, made: Made) -> None:
    """Our rays against Embree's through the same plate, good and with a planted bulge."""
    import trimesh

    each = made.sets[0]
    name = "core_plate"
    points = each.parts[name].vertices_mm.copy()
    cell = each.plan.runs[-1].cells[0]
    centre = each.plan.centre_mm([cell], each.sizes.pitch_mm)[0]
    off = points[:, :2] - centre
    reach = each.sizes.cavities[each.plan.runs[-1].kind].reach_mm
    end = (np.abs(points[:, 2] + reach) < 1e-9) & (np.hypot(*off.T) < 1.0)
    points[end, :2] += 0.5 * off[end]
    bad = TriangleMesh(vertices_mm=points, triangles=each.parts[name].triangles)
    for text, mesh in (("as made", each.parts[name]), ("planted undercut", bad)):
        ours = releases_of(MoldSet(plan=each.plan, sizes=each.sizes, parts={name: mesh}))[name]
        body = trimesh.Trimesh(mesh.vertices_mm, mesh.triangles, process=False)
        # Up from just above the faces of one stem hole: nothing of the plate may be in the way.
        middle = body.triangles_center
        wall = (np.hypot(*(middle[:, :2] - centre).T) < 1.5) & (middle[:, 2] > -reach + 1e-6)
        start = middle[wall] + 1e-4 * body.face_normals[wall]
        hit = body.ray.intersects_any(start, np.tile([0.0, 0.0, 1.0], (len(start), 1)))
        table.add(
            f"{label}: {text}, rays caught here and by Embree agree",
            float((ours.caught > 0) == bool(hit.any())),
            "-",
            reference=int(hit.sum()),
            source=f"of {len(hit)} rays caught by Embree; {ours.caught} here",
            target="== 1",
        )


def refusal_rows(table: Table, folder: Path, switch: Path) -> None:
    """What cannot be made is refused before anything is written."""
    base = load_design("hemisphere")
    for label, change in (
        ("a mold larger than the bed", {"print_rules": {"bed_mm": [30.0, 30.0, 100.0]}}),
        ("a mold taller than the printer", {"print_rules": {"bed_mm": [145.0, 145.0, 8.0]}}),
        ("a rubber that shrinks by half", {"mold": {"shrink_rubber": 0.5}}),
        ("silicone that grows", {"mold": {"shrink_silicone": -0.1}}),
        ("a print that shrinks to nothing", {"mold": {"shrink_print": 1.0}}),
        ("keys wider than their pads", {"mold": {"key_mm": 20.0}}),
    ):
        target = folder / label.replace(" ", "_")
        target.mkdir()
        said = ""
        try:
            MOLD.run(context_of(copy_of(base, **change), "draft", switch), target)
        except PhytacError as error:
            said = str(error)
        table.add(
            f"refused: {label}, nothing written",
            float(bool(said) and not any(target.iterdir())),
            "-",
            reference=1,
            source=said[:140].replace("\n", " "),
            target="== 1",
        )


def follow_row(table: Table, label: str, made: Made) -> None:
    """A planted disagreement is seen: longer stems."""
    each = made.sets[0]
    switches = switches_of(made.context)
    fine: dict[Any, Any] = {}
    for kind, section in fine_sections(switches).items():
        longer = section.copy()
        longer[-2:, 1] -= 0.1
        fine[kind] = longer
    audit = audit_set(each, fine)
    table.add(
        f"{label}: stems 0.1 mm longer than their holes, Hausdorff distance",
        audit.hausdorff_mm,
        "mm",
        reference=0.1,
        source="planted",
        target=">= 0.095",
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes one small design at the draft preset."""
    preset = "draft" if quick else "standard"
    for name in ["hemisphere"] if quick else shipped_designs():
        design = load_design(name)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            switch = fitted(design, folder / "switch")
            for way in WAYS:
                label = f"{name}, {way}"
                made = make(design, way, preset, folder)
                closed_rows(table, label, made)
                size_rows(table, label, made)
                slices = 99 if name in SMALL and not quick else int(way == "rigid")
                outside_rows(table, label, made, slices=slices)
                if name == "hemisphere":
                    follow_row(table, label, made)
                    if way == "rigid":
                        embree_row(table, label, made)
            if name == "hemisphere":
                refusal_rows(table, folder, switch)


if __name__ == "__main__":
    given = arguments((__doc__ or "").split("\n", 1)[0])
    add_rows(Table("fabrication_molds"), quick=given.quick)
