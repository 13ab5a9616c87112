"""The shipped prototype, its markers, mesh and model."""

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import pytest

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes import Surface


@dataclass(frozen=True, kw_only=True)
class Prototype:
    design: Design
    surface: Surface
    markers: Markers
    mesh: ShellMesh
    model: ShellModel


@pytest.fixture(scope="session")
def cylinder60() -> Prototype:
    text = (files("phytac_design") / "data" / "designs" / "cylinder60.toml").read_text(
        encoding="utf-8"
    )
    design = Design.model_validate(tomllib.loads(text))
    surface = design.surface()
    markers = make_markers(design, surface)
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=4)
    model = clamped_model(
        mesh, modulus_MPa=design.material.modulus_MPa, poisson=design.material.poisson
    )
    return Prototype(design=design, surface=surface, markers=markers, mesh=mesh, model=model)
