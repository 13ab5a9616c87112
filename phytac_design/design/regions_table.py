"""The tables ``[[regions]]`` of a design file: named parts of the surface, such as fingers."""

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section

Id = Annotated[int, Field(ge=0, strict=True)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class RegionSection(Section):
    """A named part of the surface: markers that meet all that is given; one name may come again."""

    name: str = Field(min_length=1, max_length=40)
    """Of the region; tables of one name make one region together."""
    along: tuple[Share, ...] = Field((), max_length=2)
    """From and to, as shares of the chart away from the camera."""
    around: tuple[Share, ...] = Field((), max_length=2)
    """From and to, as shares around; from above to runs over the seam of a closed surface."""
    rows: tuple[Id, ...] = Field((), max_length=2)
    """First and last row, from 0, for layouts with rows."""
    columns: tuple[Id, ...] = Field((), max_length=2)
    """First and last column."""
    markers: tuple[Id, ...] = Field((), max_length=50000)
    """Ids of markers."""
    point_mm: tuple[float, ...] = Field((), max_length=3)
    """Middle of a ball, sensor frame; with `radius_mm`."""
    radius_mm: float = Field(0.0, ge=0.0, le=1e5)
    """Radius of that ball; 0 where there is none."""

    @model_validator(mode="after")
    def _ball_is_whole(self) -> Self:
        if bool(self.point_mm) != bool(self.radius_mm):
            raise ValueError("point_mm and radius_mm go together")
        return self

    def table(self) -> dict[str, Any]:
        """What is given, as in a file of regions."""
        values = self.model_dump(mode="json")
        return {key: value for key, value in values.items() if value not in ([], 0.0)}
