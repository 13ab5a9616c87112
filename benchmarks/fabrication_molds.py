"""Molds of every shipped design, both ways, judged from the files as they are printed.

The STL files are read back, shrunk as print, silicone and rubber shrink, and closed: the cavity
between the halves must be the switch.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fabrication_outside import repair_row, slice_row
from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, write_facts
from phytac_design.fabrication.molds.audit import Audit, audit_set, fine_sections, releases_of
from phytac_design.fabrication.molds.make import TURNED, MoldSet, make_molds
from phytac_design.fabrication.molds.rules import rule_rows
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import make_markers
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.design import design_switch
from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
from phytac_design.mechanics.switch.switch_report import switch_dict
from phytac_design.solids.solid_mesh import to_manifold
from phytac_design.stages.build import copy_of
from phytac_design.stages.mold_stage import MOLD
from phytac_design.stages.switch_stage import switches_of

WAYS = ("rigid", "silicone-master")
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
    row = f"{label}: watertight, one body, one hole for each stem and no other"
    add(row, float(sound), "-", 1, f"{len(made.sets)} sets, manifold3d on the STL files", "== 1")
    row = f"{label}: rays along the pull that are caught"
    source = "rays, 0.1 mm apart, all parts"
    add(row, sum(audit.caught for audit in audits), "-", rays, source, "== 0")
    row = f"{label}: least draft of any face"
    source = "mold.draft_deg; files are in single precision"
    value = min(audit.draft_deg for audit in audits)
    add(row, value, "deg", section.draft_deg, source, f">= {section.draft_deg - 2e-3:g}")
    row = f"{label}: volume that closed parts share"
    source = "boolean intersection; single precision of the files times the area of contact"
    add(row, max(audit.shared_mm3 for audit in audits), "mm3", 0, source, "<= 0.05")
    row = f"{label}: clearance of the keys against what is asked"
    source = "least distance of peg and socket"
    value = max(abs(audit.key_gap_mm - section.key_clearance_mm) for audit in audits)
    add(row, value, "mm", section.key_clearance_mm, source, "<= 0.001")
    row = f"{label}: volume of the cavities, worst error"
    source = "kinds of switches, each one's section revolved; cavities shrunk"
    value = 100.0 * max(audit.volume_error for audit in audits)
    add(row, value, "%", len(switches.kinds), source, "<= 0.5")
    row = f"{label}: Hausdorff distance of the shrunk cavities from the switches"
    source = "tolerance of the mesh"
    value = max(audit.hausdorff_mm for audit in audits)
    add(row, value, "mm", tolerance, source, f"<= {tolerance:g}")


def size_rows(table: Table, label: str, made: Made) -> None:
    """Plates against the bed and the rules, triangles, files, time."""
    rules = made.context.design.print_rules
    sizes = [
        (np.ptp(each.printed(name).vertices_mm, axis=0), len(mesh.triangles))
        for each in made.sets
        for name, mesh in each.parts.items()
    ]
    add = table.add
    source = f"largest side, mm; {len(sizes)} parts"
    value = max(max(size[:2] / sorted(rules.bed_mm[:2], reverse=True)) for size, _ in sizes)
    reference = max(float(size.max()) for size, _ in sizes)
    add(f"{label}: largest plate over the bed", value, "ratio", reference, source, "<= 1")
    source = "cavities of the fullest set"
    value = max(count for _, count in sizes)
    target = "<= 1000000"
    add(
        f"{label}: triangles of the largest plate",
        value,
        "-",
        max(each.plan.cavities for each in made.sets),
        source,
        target,
    )
    wrong = [row["detail"] for row in rule_rows(made.sets[0].sizes) if not row["holds"]]
    source = ", ".join(wrong) or f"details checked, {rules.process}"
    add(
        f"{label}: details against the printer's rules",
        len(wrong),
        "-",
        len(rule_rows(made.sets[0].sizes)),
        source,
        "== 0",
    )
    source = "cavities; audit and files included"
    add(
        f"{label}: stage mold, {len(made.sets)} sets",
        made.seconds,
        "s of one core",
        sum(each.plan.cavities for each in made.sets),
        source,
        "<= 15",
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
        row = f"{label}: {text}, rays caught here and by Embree agree"
        source = f"of {len(hit)} rays caught by Embree; {ours.caught} here"
        value = float((ours.caught > 0) == bool(hit.any()))
        table.add(row, value, "-", int(hit.sum()), source, "== 1")


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
    row = f"{label}: stems 0.1 mm longer than their holes, Hausdorff distance"
    table.add(row, audit.hausdorff_mm, "mm", 0.1, "planted", ">= 0.095")


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes one small design at the draft preset."""
    preset = "draft" if quick else "standard"
    for name in ["hemisphere"] if quick else shipped_designs():
        design = load_design(name)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            fitted(design, folder / "switch")
            for way in WAYS:
                label = f"{name}, {way}"
                made = make(design, way, preset, folder)
                closed_rows(table, label, made)
                size_rows(table, label, made)
                slices = 99 if name in SMALL and not quick else int(way == "rigid")
                files = [made.file(each, part) for each in made.sets for part in each.parts]
                repair_row(table, f"{label}: ", files)
                files.sort(key=lambda path: -path.stat().st_size)
                slice_row(table, f"{label}: ", files[:slices], *COARSE)
                if name == "hemisphere":
                    follow_row(table, label, made)
                    if way == "rigid":
                        embree_row(table, label, made)
