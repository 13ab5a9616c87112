"""A build: which stages, in which order, from the cache where it can, into an exports folder."""

import fcntl
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from phytac_design.design.accuracy import Accuracy, preset_name, settings_of
from phytac_design.design.design_file import design_hash, parse_design, to_toml
from phytac_design.design.scene import Scene
from phytac_design.design.spec import Design
from phytac_design.engine import cache
from phytac_design.engine.cache import limit_bytes, prune
from phytac_design.engine.runner import GateError, StageCosts, StageRun
from phytac_design.engine.stage import EXPORT, Context, Stage
from phytac_design.report.provenance import package_versions
from phytac_design.rules.check import check_design
from phytac_design.stages import STAGES
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import DesignError, OutputError

MANIFEST = "manifest.json"
OLD_MANIFEST = f".{MANIFEST}.old"
"""Where it stands while files change: what is half-written never looks finished."""
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class BuildResult:
    """What a build did.

    Attributes
    ----------
    out : Path
        The exports folder.
    ran, cached : tuple of str
        Stages that ran, and those taken from the cache.
    seconds : float
        Wall time of this call.
    timing_s : dict
        Seconds each stage took when it ran.
    folders : dict
        Result folder of each stage in the cache.
    """

    out: Path
    ran: tuple[str, ...]
    cached: tuple[str, ...]
    seconds: float
    timing_s: dict[str, float]
    folders: dict[str, Path] = field(default_factory=dict)


def select_stages(only: Sequence[str] | None) -> list[Stage]:
    """Stages in order: all, or the named ones with everything they need.

    Raises
    ------
    DesignError
        If a name is not a stage.
    """
    known = {stage.name: stage for stage in STAGES}
    wanted = set(only or known)
    for name in sorted(wanted - set(known)):
        near = get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(
            "stage-unknown", f"unknown stage {name!r}{hint} (stages: {', '.join(known)})"
        )
    for stage in reversed(STAGES):
        if stage.name in wanted:
            wanted |= set(stage.depends_on)
    return [stage for stage in STAGES if stage.name in wanted]


def with_named(accuracy: Accuracy, only: Sequence[str] | None) -> Accuracy:
    """Settings in which the stages of ``only`` make their files; quick ones leave some out."""
    needed = {stage.only_with for stage in STAGES if stage.name in (only or ())} - {""}
    return replace(accuracy, **dict.fromkeys(needed, True))


def build(
    design: Design,
    out: Path,
    *,
    accuracy: str | Accuracy = "standard",
    only: Sequence[str] | None = None,
    stages: Sequence[Stage] | None = None,
    scene: Scene | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress = print,
    workers: int = 1,
    costs: Callable[[], StageCosts] | None = None,
) -> BuildResult:
    """Build a design into ``out``; the same inputs give the same files, by any number of workers.

    Parameters
    ----------
    only : sequence of str, optional
        Names of stages to build with those that they depend on; all by default.
    stages : sequence of Stage, optional
        The stages themselves, in order, in place of ``only``.
    scene : Scene, optional
        What the build is limited to; everything by default.
    workers : int
        Processes that run stages side by side; 1 runs them in this one. A script that asks for
        more must guard its own start with ``if __name__ == "__main__":``.
    costs : callable, optional
        Predicts the stages' costs, see :class:`phytac_design.engine.runner.StageRun`.

    Raises
    ------
    DesignError
        If the design cannot be built; nothing has been written then.
    OutputError
        If the folder is not writable, or holds another design and ``force`` is not set.
    """
    begin = time.perf_counter()
    stages = select_stages(only) if stages is None else stages
    wanted = settings_of(accuracy)
    check_design(design)
    limit = limit_bytes()
    _claim(out, design, force=force)
    with ExitStack() as keep:
        try:
            context, ran, timing = run_stages(
                design,
                stages,
                accuracy=with_named(wanted, only),
                scene=scene,
                seed=seed,
                force=force,
                progress=progress,
                keep=keep,
                workers=workers,
                costs=costs,
            )
        except GateError:
            if not any(out.iterdir()):
                out.rmdir()
            raise
        try:
            with _alone_in(out):
                # Another design's build may have ended there in the meantime.
                _claim(out, design, force=force)
                # Named parts are added to a build with these settings.
                _export(out, design, stages, replace(context, accuracy=wanted))
        except OSError as error:
            raise OutputError(
                "output-not-writable",
                f"cannot write {out}: {error.strerror or error}; make room, or choose another "
                "--out, and run the same command again: what was computed is kept",
            ) from None
        if ran:
            prune(limit_bytes=limit)
    return BuildResult(
        out=out,
        ran=tuple(ran),
        cached=tuple(stage.name for stage in stages if stage.name not in ran),
        seconds=time.perf_counter() - begin,
        timing_s=timing,
        folders=context.folders,
    )


def run_stages(
    design: Design,
    stages: Sequence[Stage],
    *,
    accuracy: str | Accuracy,
    seed: int,
    scene: Scene | None = None,
    force: bool = False,
    progress: Progress = print,
    keep: ExitStack | None = None,
    workers: int = 1,
    costs: Callable[[], StageCosts] | None = None,
) -> tuple[Context, list[str], dict[str, float]]:
    """Bring stages into the cache; nothing is exported.

    Results are protected from eviction until this returns, or until ``keep`` is closed. ``workers``
    and ``costs`` are those of :func:`build`.

    Returns
    -------
    context : Context
        With the folder of each stage.
    ran : list of str
        Stages that were not in the cache.
    timing_s : dict
        Seconds that each took when it ran.

    Raises
    ------
    GateError
        If a stage stops the build and ``force`` is not set.
    DesignError
        If the design cannot be built.
    NumericalError
        If the process of a stage died twice.
    """
    context = Context(
        design=design,
        accuracy=settings_of(accuracy),
        seed=seed,
        scene=scene,
        progress=progress,
    )
    with ExitStack() as own:
        run = StageRun(context, stages, keep=keep or own, force=force, costs=costs)
        run.run(workers)
    names = [stage.name for stage in stages]
    timing = {name: run.timing_s[name] for name in names}
    return context, [name for name in names if name in run.ran], timing


def _claim(out: Path, design: Design, *, force: bool) -> None:
    """Claim the folder before any long work; reject another design's or an unwritable one."""
    try:
        if (out / MANIFEST).is_file() or (out / OLD_MANIFEST).is_file():
            other = _old_manifest(out).get("design")
            name = other.get("name") if isinstance(other, dict) else None
            if name != design.name and not force:
                raise OutputError(
                    "output-foreign",
                    f"{out} holds the design {name!r}, not {design.name!r}; "
                    "choose another --out, or overwrite it with --force",
                )
        elif (
            out.is_dir()
            and any(out.iterdir())
            and not (out / "design.toml").is_file()
            and not force
        ):
            raise OutputError(
                "output-foreign",
                f"{out} is not empty and not a build; choose another --out, or use --force",
            )
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {out}: {error.strerror}; choose another --out"
        ) from None


@contextmanager
def _alone_in(out: Path) -> Iterator[None]:
    """Wait until no other build writes into the folder; sweep what a killed one left there."""
    handle = os.open(out, os.O_RDONLY)
    try:
        # Some network disks have no locks; there the user must avoid parallel builds.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        try:
            _sweep(out)
            yield
        except OSError:
            _sweep(out)
            raise
    finally:
        os.close(handle)


def _sweep(out: Path) -> None:
    for path in out.rglob(".*.part"):
        path.unlink(missing_ok=True)


def _old_manifest(out: Path) -> dict[str, Any]:
    """Manifest of the build before, finished or not; empty if there is none that can be read."""
    for name in (MANIFEST, OLD_MANIFEST):
        try:
            found = json.loads(read_text(out / name))
        except (OSError, ValueError, RecursionError):
            continue
        if isinstance(found, dict):
            return found
    return {}


def _export(
    out: Path,
    design: Design,
    stages: Sequence[Stage],
    context: Context,
) -> None:
    """Copy the stages' files, the resolved design and the manifest; drop stale files of ours."""
    if (out / MANIFEST).is_file():
        (out / MANIFEST).replace(out / OLD_MANIFEST)
    (out / "design.toml").write_text(to_toml(design), encoding="utf-8")
    files = [_entry(out, Path("design.toml"), "design", 0.0)]
    for stage in stages:
        source = context.folders[stage.name] / EXPORT
        made = cache.record(context.folders[stage.name])
        seconds, hashes = (
            float(made["seconds"]),
            {name: item[1] for name, item in made["files"].items()},
        )
        paths = [path.relative_to(source) for path in source.rglob("*") if path.is_file()]
        for path in sorted(paths):
            target = out / path
            target.parent.mkdir(parents=True, exist_ok=True)
            partial = target.with_name(f".{target.name}.part")
            shutil.copyfile(source / path, partial)
            _check_copy(partial, source / path, hashes[f"{EXPORT}/{path.as_posix()}"])
            partial.replace(target)
        if stage.finish:
            stage.finish(design, out)
        files += [_entry(out, path, stage.name, seconds) for path in sorted(paths)]
    kept = {item["path"] for item in files}
    identity = {
        "design": {"name": design.name, "hash": design_hash(design)},
        "accuracy": preset_name(context.accuracy),
        "settings": context.accuracy.as_dict(),
        "scene": context.scene.model_dump(mode="json") if context.scene else None,
        "seed": context.seed,
    }
    others = _settle_old_files(out, kept, {stage.name for stage in stages}, identity)
    manifest = identity | {
        "format": "phytac-exports",
        "schema_version": "1.0",
        "versions": package_versions(),
        "files": sorted(files + others, key=lambda item: str(item["path"])),
    }
    partial = out / f".{MANIFEST}.part"
    partial.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(out / MANIFEST)
    (out / OLD_MANIFEST).unlink(missing_ok=True)


def _check_copy(copy: Path, source: Path, digest: str) -> None:
    """Reject a copy that differs from what the stage wrote."""
    if cache.file_hash(copy) == digest:
        return
    copy.unlink()
    raise OutputError(
        "cache-entry-damaged",
        f"{source} was damaged while it was exported (its SHA-256 is not {digest[:12]}…); run the "
        "same command again, which computes it again, and check the disk if this happens again",
    )


def _settle_old_files(
    out: Path, kept: set[str], stages: set[str], identity: dict[str, Any]
) -> list[dict[str, Any]]:
    """Remove what no longer belongs; return the entries of other stages' files that still do.

    A file of an earlier build stays only if that build was of the same design, accuracy and seed
    and this build did not run its stage: no two files in a folder may disagree.
    """
    old = _old_manifest(out)
    try:
        entries = [item for item in old["files"] if item["path"] not in kept]
        named = all(isinstance(item[key], str) for item in entries for key in ("path", "stage"))
    except (KeyError, TypeError):
        return []
    if not named:
        return []
    same = all(old.get(name) == value for name, value in identity.items())
    staying = []
    for item in entries:
        path = out / item["path"]
        if same and item["stage"] not in stages and path.is_file():
            staying.append(item)
        elif path.resolve().is_relative_to(out.resolve()):
            if path.is_file() or path.is_symlink():
                path.unlink(missing_ok=True)
            if path.parent != out and path.parent.is_dir() and not any(path.parent.iterdir()):
                path.parent.rmdir()
    return staying


def _entry(out: Path, relative: Path, stage: str, seconds: float) -> dict[str, Any]:
    path = out / relative
    return {
        "path": relative.as_posix(),
        "sha256": cache.file_hash(path),
        "bytes": path.stat().st_size,
        "stage": stage,
        "seconds": seconds,
    }


def copy_of(design: Design, **tables: dict[str, Any]) -> Design:
    """Design with some fields changed: ``copy_of(design, layout={"kind": "straight"})``."""
    data = design.model_dump(mode="json")
    for name, changes in tables.items():
        data[name] = {**data[name], **changes}
    return parse_design(data, f"variant of {design.name}")
