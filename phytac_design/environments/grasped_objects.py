"""What the gripper of the environments holds; sizes and limits without a source are choices.

The paper holds a thin plastic cup with a robot, and in virtual reality an egg that is crushed at
50 N and a soft ball that gives between 5 and 20 N.
"""

from dataclasses import dataclass
from typing import Literal

from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class GraspedObject:
    """An object between two fingers.

    Attributes
    ----------
    name : str
        As in the id of its environment.
    shape : {"cylinder", "sphere"}
        Upright cylinder, or sphere.
    radius_mm : float
        Of either.
    mass_kg : float
        Empty.
    filling_kg : float
        What is poured in while it is held.
    stiffness_N_mm : (float, float)
        Range that its stiffness between the fingers is drawn from in each episode.
    friction : float
        Coefficient against both fingers.
    force_max_N : float
        Grip above which it is crushed.
    force_min_N : float
        Grip below which it does not count as squeezed.
    lifted : bool
        Whether it is to be lifted; else it is to be squeezed where it stands.
    """

    name: str
    shape: Literal["cylinder", "sphere"]
    radius_mm: float
    mass_kg: float
    stiffness_N_mm: tuple[float, float]
    friction: float
    force_max_N: float
    filling_kg: float = 0.0
    force_min_N: float = 0.0
    lifted: bool = True


OBJECTS = {
    thing.name: thing
    for thing in (
        # As in examples/uses/cup.py: it slips below 3.5 N when full.
        GraspedObject(
            name="cup",
            shape="cylinder",
            radius_mm=35.0,
            mass_kg=0.06,
            filling_kg=0.19,
            stiffness_N_mm=(0.5, 3.0),
            friction=0.35,
            force_max_N=12.0,
        ),
        GraspedObject(
            name="egg",
            shape="sphere",
            radius_mm=22.0,
            mass_kg=0.06,
            stiffness_N_mm=(8.0, 12.0),
            friction=0.35,
            force_max_N=50.0,  # the paper
        ),
        GraspedObject(
            name="ball",
            shape="sphere",
            radius_mm=33.0,
            mass_kg=0.03,
            stiffness_N_mm=(0.8, 1.5),
            friction=0.6,
            force_min_N=5.0,  # both from the paper
            force_max_N=20.0,
            lifted=False,
        ),
    )
}


def grasped_object(name: str) -> GraspedObject:
    """Return the object of a name; raises InputError if there is none."""
    if name not in OBJECTS:
        raise InputError(
            "grasped-object-unknown", f"no object {name!r}; known: {', '.join(OBJECTS)}"
        )
    return OBJECTS[name]
