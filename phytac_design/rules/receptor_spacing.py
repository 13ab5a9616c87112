"""Rules on where receptors stand: off the open edges, apart from each other."""

import numpy as np

from phytac_design.geometry.boundary_loops import edge_distance_mm
from phytac_design.layout.receptor_distances import nearest_pair, smallest_receptor_gap_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.clearance import lower_heights
from phytac_design.rules.refusal import SLACK_mm, fewer, refuse


def check_ends(sensor: Sensor) -> None:
    """Check that tubes and switch footprints stay within the open edges of the surface."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    receptor, switch = design.receptor, design.switch
    sizes = [("tube", "receptor.diameter_outer_mm", receptor.diameter_tube_mm / 2.0)]
    if design.has_switches and design.wall.rim_length_mm > 0.0 and design.wall.rim_flange_mm > 0.0:
        # Only a rim that stands out meets the bowls on the outer face.
        foot = switch.footprint_diameter_mm / 2.0
        sizes.append(("switch footprint", "switch.footprint_diameter_mm", foot))
    for axis, end in surface.edges():
        widest = max(radius for _, _, radius in sizes)
        distance = edge_distance_mm(surface, markers.uv, axis, end, within_mm=widest)
        # Of markers equally near but for rounding the first is named.
        worst = int(np.argmin(np.round(distance, 9)))
        for what, field, radius in sizes:
            if distance[worst] < radius - SLACK_mm:
                edge = "end" if axis == 0 else "side"
                fix = {
                    "phyllotaxis": f"lower {field}",
                    "explicit": f"move it inward or lower {field}",
                }.get(
                    design.layout.kind,
                    f"lower layout.{'columns' if axis else 'rows'} or {field}",
                )
                refuse(
                    "receptor-cuts-rim",
                    f"receptor {markers.name(worst)} lies {distance[worst]:.2f} mm from the {edge} "
                    f"of the surface, less than the radius of its {what} ({radius:.2f} mm): it "
                    f"cuts the rim; {fix}",
                )


def check_receptor_gaps(sensor: Sensor) -> None:
    """Check that tubes keep the printer's gap between each other.

    The gap is the distance between the axes' segments less one diameter: exact for sides that
    meet, up to a few hundredths of a millimetre too small where flat ends are nearest.
    """
    design, markers = sensor.design, sensor.markers
    gap, pair = smallest_receptor_gap_mm(design, markers)
    least = design.print_rules.gap_min_mm
    if pair is None or gap >= least - SLACK_mm:
        return
    first, second = markers.name(pair[0]), markers.name(pair[1])
    state = f"overlap by {-gap:.2f} mm" if gap < 0.0 else f"are {gap:.2f} mm apart"
    one_row = markers.row[pair[0]] == markers.row[pair[1]]
    spacing = fewer(design, "columns" if one_row else "rows or columns")
    fix = lower_heights(sensor)
    refuse(
        "receptors-too-close",
        f"receptors {first} and {second} meet: they {state} (the printer needs a gap of "
        f"{least:g} mm); {fix + ', or ' if fix else ''}{spacing} "
        "receptor.diameter_outer_mm",
    )


def check_footprints(sensor: Sensor) -> None:
    """Check that the bowls of neighbouring switches do not overlap on the outer face."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    if markers.count < 2 or not design.has_switches:
        return
    apart, (low, high) = nearest_pair(surface.point(markers.uv))
    size = design.switch.footprint_diameter_mm
    if apart < size - SLACK_mm:
        refuse(
            "switches-overlap",
            f"switches {markers.name(low)} and {markers.name(high)} overlap on the outer face "
            f"(footprint {size:g} mm, centres {apart:.2f} mm apart); {fewer(design)} "
            f"switch.footprint_diameter_mm to {np.floor(apart * 10.0) / 10.0:g}",
        )
