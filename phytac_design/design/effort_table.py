"""The table ``[effort]`` of a design file: hand work and prices, not part of the sensor itself."""

from pydantic import Field

from phytac_design.design.base_table import Section, assumed


class EffortSection(Section):
    """Hand work in seconds, and prices in any currency; 0 where they are not known.

    Printers and curing rubber need no hands: their time is not counted.
    """

    print_s: float = assumed(900.0, ge=0.0, le=1e6)
    """A printed part: start the printer, take it off, wash it, cure it, remove its supports."""
    paint_s: float = assumed(20.0, ge=0.0, le=1e6)
    """A receptor's end face and band, inside the shell: find it on the paint map, paint it."""
    sprue_s: float = assumed(30.0, ge=0.0, le=1e6)
    """A sprue of inserts: find its row or column, break its bar off, look for leftover necks."""
    insert_s: float = assumed(6.0, ge=0.0, le=1e6)
    """An insert on its sprue: push it in, put a drop of glue on it. Boothroyd and Dewhurst allow
    4 s for a part that is easy to hold and snaps in; 2 s are for the glue."""
    insert_single_s: float = assumed(12.0, ge=0.0, le=1e6)
    """An insert that is broken off its sprue first, and whose receptor is next to the last one."""
    silicone_s: float = assumed(2700.0, ge=0.0, le=1e6)
    """Both silicone halves of a set of trays: weigh, mix, degas, pour, take off, test."""
    cast_s: float = assumed(1710.0, ge=0.0, le=1e6)
    """A casting: 510 s of stirring and degassing (the paper's recipe); 1200 s to weigh, fill,
    close and open the mold."""
    trim_s: float = assumed(15.0, ge=0.0, le=1e6)
    """A switch: take it out of the mold, cut off what has set in its vent, sort it."""
    tip_s: float = assumed(8.0, ge=0.0, le=1e6)
    """A switch: paint its tip red."""
    glue_s: float = assumed(45.0, ge=0.0, le=1e6)
    """A switch: find its receptor, put its stem through, glue its rim, hold it."""
    strip_trim_s: float = assumed(30.0, ge=0.0, le=1e6)
    """A strip of switches: take it out of the mold, cut along its edges, sort it."""
    strip_stem_trim_s: float = assumed(4.0, ge=0.0, le=1e6)
    """A stem on a strip: cut off what has set in its vent; no part is picked up."""
    strip_tip_s: float = assumed(20.0, ge=0.0, le=1e6)
    """A strip: dip all its tips in red, wipe them, lay it down."""
    strip_glue_s: float = assumed(60.0, ge=0.0, le=1e6)
    """A strip: find its place, lay glue on its web and rims, press it on."""
    strip_stem_s: float = assumed(5.0, ge=0.0, le=1e6)
    """A stem on a strip: thread it into the hole beside the one before."""
    fit_s: float = assumed(60.0, ge=0.0, le=1e6)
    """A printed or bought part of the hardware: fit it in its place."""
    screw_s: float = assumed(9.8, ge=0.0, le=1e6)
    """A screw or insert: 1.8 s of handling and 8 s of driving (Boothroyd and Dewhurst, manual
    assembly, codes 11 and 39)."""
    price_hour: float = Field(0.0, ge=0.0, le=1e9)
    """An hour of hand work."""
    price_resin_kg: float = Field(0.0, ge=0.0, le=1e9)
    """A kilogram of printed resin."""
    price_rubber_kg: float = Field(0.0, ge=0.0, le=1e9)
    """A kilogram of the switches' rubber."""
    price_silicone_kg: float = Field(0.0, ge=0.0, le=1e9)
    """A kilogram of silicone."""
    price_camera: float = Field(0.0, ge=0.0, le=1e9)
    """A camera."""
