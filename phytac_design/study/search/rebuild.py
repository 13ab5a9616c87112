"""From a row of a study's results back to its design."""

from pathlib import Path

from phytac_design.design.design_file import design_hash, parse_design
from phytac_design.design.spec import Design
from phytac_design.study.search.space import make_space
from phytac_design.study.search.study_folder import read_columns, read_study
from phytac_shapes.errors import DesignError, InputError


def rebuild(folder: Path, trial: int) -> Design:
    """Design of a candidate, exactly; its name is the study's with the trial's number.

    Parameters
    ----------
    folder : Path
        A study's folder, or a file in it.
    trial : int
        Number of the candidate.

    Raises
    ------
    InputError
        If the folder holds no such candidate.
    DesignError
        If this version of the program makes another design of it.
    """
    folder = folder.parent if folder.is_file() else folder
    study, base, _ = read_study(folder)
    fields = [variable.field for variable in study.variable]
    columns = read_columns(folder, ["trial", *fields, "design"])
    rows = [row for row, number in enumerate(columns["trial"]) if int(number) == trial]
    if not rows:
        raise InputError(
            f"{folder} has no trial {trial}; it has {len(columns['trial'])}, counted from 0"
        )
    space = make_space(study, Path(), parse_design(base, f"base of {study.name}"))
    params = {
        axis.field: int(value)
        if axis.whole and not isinstance(value, str)
        else value
        if isinstance(value, str)
        else float(value)
        for axis in space.axes
        for value in [columns[axis.field][rows[0]]]
    }
    design, known = space.design(params), columns["design"][rows[0]]
    if known and design_hash(design) != known:
        raise DesignError(
            f"trial {trial} of {folder} is another design in this version of the program (hash "
            f"{design_hash(design)[:12]}, then {known[:12]}); build it with the version of its row"
        )
    # The name is no part of what was looked at.
    name = f"{study.name}-{trial}"[-64:].lstrip("_.-")
    return parse_design(design.model_dump(mode="json") | {"name": name}, f"trial {trial}")
