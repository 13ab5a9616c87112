"""``phytac cache``: contents of the stage cache, and eviction."""

import re
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.output import print_json
from phytac_shapes.errors import DesignError


def cache(
    prune: Annotated[
        str | None,
        typer.Option(
            help="Delete the least recently used results down to this size: 2GB, 500MB, 0."
        ),
    ] = None,
    older_than: Annotated[
        str | None, typer.Option(help="Delete results that were not used for this long: 7d, 12h.")
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check every file, and delete damaged results.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the cache of finished stages, or delete results from it."""
    from phytac_design.core.cache_folder import cache_root
    from phytac_design.engine import cache as store

    limit = float("inf") if prune is None else size_bytes(prune)
    oldest_s = float("inf") if older_than is None else duration_s(older_than)
    damaged = store.damaged() if verify else []
    kept = [folder for folder in damaged if not store.drop(folder)]
    done = None
    if prune is not None or older_than is not None:
        done = store.prune(limit_bytes=limit, older_than_s=oldest_s)
    every = store.entries()
    total = sum(entry.size_bytes for entry in every)
    stages = {
        name: [entry for entry in every if entry.stage == name]
        for name in sorted({entry.stage for entry in every})
    }
    facts = {
        "folder": str(cache_root()),
        "bytes": total,
        "limit_bytes": store.limit_bytes(),
        "results": len(every),
        "stages": {
            name: {
                "results": len(group),
                "bytes": sum(entry.size_bytes for entry in group),
                "seconds": round(sum(entry.seconds for entry in group), 3),
            }
            for name, group in stages.items()
        },
    }
    if verify:
        facts["damaged"] = len(damaged)
    if done is not None:
        facts["pruned"] = {
            "results": done.dropped,
            "bytes": done.freed_bytes,
            "leftovers": done.leftovers,
            "in_use": done.in_use,
        }
    if kept:
        say(f"warning: {len(kept)} damaged results are read by a running build and stay for now")
    if as_json:
        print_json(facts)
        return
    if verify:
        typer.echo(f"{len(damaged)} damaged results dropped; the next build makes them again")
    if done is not None:
        stay = f"; {done.in_use} stay, a build reads them" if done.in_use else ""
        typer.echo(f"dropped {done.dropped} results, {done.freed_bytes / 1e6:.1f} MB{stay}")
    typer.echo(
        f"{cache_root()}: {len(every)} results, {total / 1e6:.1f} MB; builds keep it within "
        f"{store.limit_bytes() / 1e9:g} GB (PHYTAC_CACHE_GB)"
    )
    for name, group in stages.items():
        size = sum(entry.size_bytes for entry in group) / 1e6
        spent = sum(entry.seconds for entry in group)
        typer.echo(f"  {name:12s} {len(group):5d} results {size:9.1f} MB  {spent:9.1f} s to make")


def size_bytes(text: str) -> float:
    """Read a size: ``2GB``, ``500 MB``, ``0``.

    Raises
    ------
    DesignError
        If it is not one.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMG]?)B?\s*", text)
    if not match or (not match[2] and float(match[1])):
        raise DesignError("cache-size-invalid", f"no size {text!r}; write it as 2GB, 500MB or 0")
    return float(match[1]) * {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}[match[2]]


def duration_s(text: str) -> float:
    """Read a time: ``90s``, ``12h``, ``7d``.

    Raises
    ------
    DesignError
        If it is not one.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([smhd])\s*", text)
    if not match:
        raise DesignError("duration-invalid", f"no time {text!r}; write it as 90s, 30m, 12h or 7d")
    return float(match[1]) * {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}[match[2]]
