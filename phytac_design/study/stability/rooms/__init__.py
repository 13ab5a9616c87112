"""The rooms, in the order of every table."""

from phytac_design.study.stability.case import Room
from phytac_design.study.stability.rooms import (
    design_file,
    drawn,
    estimators,
    large,
    layout,
    lenses,
    print_rules,
    readers,
    sensor_shell,
    shell,
    solids,
    surfaces,
    switches,
    twin,
    visibility,
)

ROOMS: dict[str, Room] = {
    room.name: room
    for room in (
        design_file.ROOM,
        surfaces.ROOM,
        layout.ROOM,
        print_rules.ROOM,
        solids.ROOM,
        lenses.ROOM,
        visibility.ROOM,
        shell.ROOM,
        sensor_shell.ROOM,
        large.ROOM,
        switches.ROOM,
        twin.ROOM,
        estimators.ROOM,
        readers.ROOM,
        drawn.ROOM,
    )
}
"""By name."""
