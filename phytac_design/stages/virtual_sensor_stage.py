"""A virtual print for simulators of robots, tabulated once and then taken from the cache."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, Stage, write_arrays, write_facts
from phytac_design.optics.exposure import Exposure
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import (
    ImagingSection,
    SensorInstanceSection,
    SolveSection,
)
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_design.stages.build import run_stages, select_stages
from phytac_shapes.errors import DesignError


def virtual_sensor(
    design: Design,
    *,
    unit: int = 0,
    seed: int = 0,
    accuracy: str = "standard",
    progress: Callable[[str], None] = lambda _: None,
) -> VirtualSensor:
    """Return a virtual print that answers contacts at once, from the cache or made now.

    Parameters
    ----------
    design : Design
        The sensor.
    unit, seed : int
        Which virtual print, as in ``phytac simulate --unit --seed``; unit 0 is the sensor as
        designed.
    accuracy : str
        Preset of the simulation's mesh.
    progress : callable
        Called with a short message at each step.

    Raises
    ------
    DesignError
        If there is no such print or preset, or the design breaks a rule.
    InputError
        If the print cannot be read.
    """
    if unit < 0 or seed < 0:
        raise DesignError(
            "unit-invalid", f"unit and seed are whole numbers from 0 on (got {unit} and {seed})"
        )
    stage = Stage(
        name=f"virtual-{unit}",
        design_fields=("mechanics", "touch", "trips", "pictures", "camera"),
        settings=("truth_refine", "place_share", "place_orders"),
        depends_on=("views",),
        seeded=True,
        run=partial(_run, unit),
    )
    context = run_stages(
        design,
        [*select_stages(["views"]), stage],
        accuracy=accuracy,
        seed=seed,
        force=True,
        progress=progress,
    )[0]
    arrays = context.arrays(stage.name)
    return VirtualSensor.from_arrays(arrays, design, context.surface, _instance(context, unit))


def _instance(context: Context, unit: int) -> SensorInstance:
    """The print, with the scatter that scenarios have by default."""
    section = SensorInstanceSection(number=unit)
    return draw_sensor_instance(context.sensor, section, context.seed)


def _run(unit: int, context: Context, folder: Path) -> None:
    """Measure the print at rest, and tabulate its wall."""
    design, surface = context.design, context.surface
    exposed = ImagingSection(noise_pixel=design.camera.noise_pixel)
    imaging = ImagingModel(
        design,
        surface,
        _instance(context, unit),
        exposure=Exposure(**exposed.model_dump()),
        views=context.arrays("views"),
        samples=SolveSection().samples_per_pixel,
    )
    context.progress("virtual sensor: at rest")
    made = VirtualSensor.of(imaging, design, surface, context.accuracy, context.progress)
    write_arrays(folder, made.arrays())
    write_facts(folder, {"unit": unit, "places": len(made.places.point_mm)})
