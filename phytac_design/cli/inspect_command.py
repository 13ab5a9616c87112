"""The command that compares a photo of an assembly with its design."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from phytac_design.cli.options import check_out, complete_design
from phytac_design.cli.output import next_step

if TYPE_CHECKING:
    from phytac_design.workflows.inspect_assembly import Inspection
    from phytac_shapes.arrays import ImageArray

NEXT = {
    "painted": "cast and glue the switches in, then run it again with --step assembled",
    "assembled": "close the sensor, then phytac camera checks the live picture",
}


def inspect(
    source: Annotated[
        str,
        typer.Argument(
            help="Folder of a build, a design file or a shipped design.",
            metavar="DESIGN_OR_BUILD",
            autocompletion=complete_design,
        ),
    ],
    photos: Annotated[
        list[Path],
        typer.Argument(
            help="Photo by the sensor's camera, at rest; two for two cameras, near end first.",
            show_default=False,
        ),
    ],
    step: Annotated[
        Literal["painted", "assembled"],
        typer.Option(
            help="Last step: the shell is painted or has its inserts, or has its switches as well."
        ),
    ] = "assembled",
    as_json: Annotated[
        Path | None,
        typer.Option("--json", help="File for the result as JSON.", callback=check_out),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            help="File for the photo with rings around the mistakes, PNG or JPEG; of a second "
            "photo the name ends in _1.",
            callback=check_out,
        ),
    ] = None,
) -> None:
    """Find markers and tips that are missing, swapped or badly painted in a photo."""
    import json

    from phytac_decoder.io.recorded_frames import read_image
    from phytac_design.core.json_values import finite
    from phytac_design.design.design_file import load_design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.workflows.inspect_assembly import annotated
    from phytac_design.workflows.inspect_assembly import inspect as inspect_photos
    from phytac_shapes.errors import InputError

    if picture and picture.suffix.lower() not in {".png", ".jpg", ".jpeg"}:
        raise InputError(
            "picture-format",
            f"--picture writes PNG or JPEG (got {picture.name}); end its name in .png or .jpg",
        )
    images = [read_image(path) for path in photos]
    result = inspect_photos(Sensor(load_design(_design_of(source))), images, step)
    if as_json:
        text = json.dumps(finite(result.to_dict()), indent=1, ensure_ascii=False)
        _write(as_json, f"{text}\n".encode())
    if picture:
        for number, image in enumerate(images):
            own = [one for one in result.mistakes if one.camera == number]
            name = picture if number == 0 else picture.with_stem(f"{picture.stem}_{number}")
            _write(name, _encoded(name.suffix, annotated(image, own)))
    typer.echo(_text(result))
    if result.mistakes:
        next_step("correct these, take a new photo and run the same command again")
        raise typer.Exit(InputError.exit_code)
    next_step(NEXT[step])


def _design_of(name: str) -> str:
    """Design file of a build's folder, or of its folder ``decoder``; else the name as it is."""
    folder = Path(name)
    for place in (folder, folder.parent):
        if folder.is_dir() and (place / "design.toml").is_file():
            return str(place / "design.toml")
    return name


def _text(result: "Inspection") -> str:
    """Table of the mistakes, notes and the verdict."""
    rows = [("receptor", "mistake", "measured", "allowed", "what to do")]
    rows += [
        (one.place, one.fault, one.measured, one.allowed, one.action) for one in result.mistakes
    ]
    width = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(text.ljust(size) for text, size in zip(row, width, strict=True)).rstrip()
        for row in rows
    ]
    lines = lines if result.mistakes else []
    lines += [f"note: {text}" for text in result.notes]
    count = len(result.mistakes)
    verdict = f"{count} mistake{'s' * (count != 1)}" if count else "no mistakes"
    lines.append(f"{verdict}: {result.judged} of {result.spots} markers and marks judged")
    return "\n".join(lines)


def _encoded(suffix: str, image: "ImageArray") -> bytes:
    import cv2

    return bytes(cv2.imencode(suffix.lower(), image)[1])


def _write(path: Path, data: bytes) -> None:
    from phytac_shapes.errors import OutputError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {path}: {error.strerror}; choose another file"
        ) from None
