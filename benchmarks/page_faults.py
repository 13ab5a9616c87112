"""Builds and servers that are disturbed, as processes of their own.

Part of ``python -m benchmarks.page``. Each row is 1 if what ``docs/hardening.md`` says was seen,
and its note is what was seen. Where root may mount, a full disk is a file system of 150 kB and a
read-only folder one that is mounted so; elsewhere a limit of file sizes, and a folder's rights.
"""

import fcntl
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

from benchmarks.harness import Table
from benchmarks.page_faults_desk import Desk, Disk, Look, Run, files_of, kept
from benchmarks.page_faults_servers import stream, studio
from phytac_design.stages.build import MANIFEST, OLD_MANIFEST

WHOLE = "cylinder60"
STOPS = ("views", "step", "decoder")
"""Stages of the whole build in which it is ended, one run each."""
TRIES = 40
OTHER = ("modulus_MPa = 2000.0", "modulus_MPa = 1900.0")
"""A line of the small design, and what makes it another."""
DEADLINE_S = 60.0


def faults(table: Table, *, quick: bool) -> None:
    """Rows: each fault of a build, then of the studio's and the stream's clients."""
    with tempfile.TemporaryDirectory() as name:
        desk = Desk(Path(name))
        for case, work in CASES.items():
            look = Look(desk.root)
            work(desk, look)
            look.row(table, f"faults: {case}")
        if not quick:
            look = Look(desk.root)
            _whole(desk, look)
            look.row(table, f"faults: SIGTERM in stages and copying of a draft of {WHOLE}")
    studio(table, quick=quick)
    stream(table, quick=quick)


def again(desk: Desk, look: Look, out: Path, store: Path, *, only: str = "mesh") -> None:
    """Give the same command once more: it must finish, with the files of an undisturbed build."""
    code = desk.build(out, store, only=only).end()
    whole = files_of(out) == desk.reference[only] and (out / MANIFEST).is_file()
    look.true(f"the same command again: exit code {code}, every file as undisturbed", whole)


def unfinished(look: Look, out: Path) -> None:
    """Nothing may look finished."""
    left = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    shown = ", ".join(left[:4]) or "nothing"
    more = f" and {len(left) - 4} more" if len(left) > 4 else ""
    look.true(f"no {MANIFEST} (there is: {shown}{more})", MANIFEST not in left)


def _full_in_a_stage(desk: Desk, look: Look) -> None:
    out = desk.root / "full-stage"
    with Disk(desk.root / "disk-a") as disk:
        look.note(disk.how)
        store = disk.at / "cache"
        run = desk.build(out, store, before=disk.limited)
        look.refusal(run, "make room")
        look.true(f"the cache holds {len(kept(store))} files of the stage", not kept(store))
        unfinished(look, out)
        disk.grow()
        again(desk, look, out, store)


def _full_while_copying(desk: Desk, look: Look) -> None:
    with Disk(desk.root / "disk-b") as disk:
        look.note(disk.how)
        out = disk.at / "x"
        run = desk.build(out, desk.store, before=disk.limited)
        look.refusal(run, "make room")
        unfinished(look, out)
        look.true("no half-copied file", not list(out.rglob("*.part")))
        disk.grow()
        again(desk, look, out, desk.store)


def _read_only_folder(desk: Desk, look: Look) -> None:
    with Disk(desk.root / "disk-c") as disk:
        disk.grow()
        out = disk.at / "x"
        look.true(f"a first build: exit code {desk.build(out, desk.store).end()}", out.is_dir())
        before = files_of(out)
        look.note(disk.lock())
        run = desk.build(out, desk.store, design=desk.other)
        look.refusal(run, "cannot write")
        look.true("before any stage", "[1/" not in run.said)
        look.true("the build that was there is untouched", files_of(out) == before)
        look.true(f"and finished: {MANIFEST}", (out / MANIFEST).is_file())
        disk.unlock()
        code = desk.build(out, desk.store, design=desk.other).end()
        whole = files_of(out) == desk.reference["other"]
        look.true(f"writable again: exit code {code}, every file as undisturbed", whole)


def _read_only_cache(desk: Desk, look: Look) -> None:
    with Disk(desk.root / "disk-d") as disk:
        disk.grow()
        empty, filled = disk.at / "empty", disk.at / "filled"
        empty.mkdir()
        shutil.copytree(desk.store, filled)
        look.note(disk.lock())
        run = desk.build(desk.root / "ro-a", empty)
        look.refusal(run, "PHYTAC_CACHE")
        look.true("before any stage", "[1/" not in run.said)
        unfinished(look, desk.root / "ro-a")
        again(desk, look, desk.root / "ro-b", filled)
        look.note("that was from a cache that holds all, read-only")
        disk.unlock()


def _ended_in_a_stage(desk: Desk, look: Look) -> None:
    for sign, code, said in (
        (signal.SIGTERM, -signal.SIGTERM, ""),
        (signal.SIGINT, 130, "stopped; run the same command again"),
    ):
        store, out = desk.root / f"stage-cache-{sign}", desk.root / f"stage-{sign}"
        run = desk.build(out, store, only="views,mesh")
        look.true(f"{sign.name} in the stage views", run.until("views …"))
        time.sleep(0.5)
        found = run.end(sign)
        look.true(f"exit code {found} {said}".strip(), found == code and said in run.said)
        look.true("no traceback, no process left", "Traceback" not in run.said and run.gone())
        unfinished(look, out)
        again(desk, look, out, store, only="views,mesh")
        hidden = [path for path in store.rglob(".*") if path.is_dir()]
        look.true(f"the cache holds {len(hidden)} leftovers", not hidden)


def ended_while_copying(
    look: Look, start: Callable[[], Run], out: Path, sign: signal.Signals
) -> None:
    """End builds as they copy until one is caught between its first file and its manifest."""
    for number in range(1, TRIES + 1):
        shutil.rmtree(out, ignore_errors=True)
        run = start()
        while run.running() and not (out / "design.toml").exists():
            time.sleep(0.0002)
        code = run.end(sign)
        if not (out / MANIFEST).exists():
            look.true(f"{sign.name} while files are copied: exit code {code}", code != 0)
            look.note(f"caught at run {number}")
            unfinished(look, out)
            return
    look.true(f"caught while copying in {TRIES} runs", so=False)


def _ended_while_copying(desk: Desk, look: Look) -> None:
    for sign in (signal.SIGTERM, signal.SIGINT):
        out = desk.root / f"copying-{sign}"
        start = partial(desk.build, out, desk.store, only="views,mesh")
        ended_while_copying(look, start, out, sign)
        again(desk, look, out, desk.store, only="views,mesh")
        look.true("no half-copied file", not list(out.rglob("*.part")))


def _ended_over_an_old_build(desk: Desk, look: Look) -> None:
    """A build that is copied over another, which was finished: neither is now."""
    out = desk.root / "over"
    for number in range(1, TRIES + 1):
        shutil.rmtree(out, ignore_errors=True)
        desk.build(out, desk.store, design=desk.other).end()
        run = desk.build(out, desk.store)
        while run.running() and not (out / OLD_MANIFEST).exists():
            time.sleep(0.0002)
        code = run.end(signal.SIGTERM)
        if not (out / MANIFEST).exists():
            look.true(f"exit code {code}", code == -signal.SIGTERM)
            look.note(f"caught at run {number}")
            unfinished(look, out)
            break
    else:
        look.true(f"caught while copying in {TRIES} runs", so=False)
    again(desk, look, out, desk.store)


def _two_take_turns(desk: Desk, look: Look) -> None:
    """Two designs into one folder, which is held until both stand before it."""
    out = desk.root / "two"
    out.mkdir()
    handle = os.open(out, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    runs = [desk.build(out, desk.store, design=design) for design in (desk.design, desk.other)]
    until = time.monotonic() + DEADLINE_S
    while not all(run.has_open(out) for run in runs) and time.monotonic() < until:
        time.sleep(0.01)
    look.true("both stand before the folder", all(run.has_open(out) for run in runs))
    look.true("and write nothing while it is held", not files_of(out))
    os.close(handle)
    codes = [run.end() for run in runs]
    look.true(f"exit codes {codes}", codes == [0, 0])
    which = [name for name in ("mesh", "other") if files_of(out) == desk.reference[name]]
    look.true("the folder is one of them, whole", len(which) == 1)
    look.true("nothing half-copied", not list(out.rglob(".*")))


def _two_share_the_work(desk: Desk, look: Look) -> None:
    """One design, an empty cache: the second waits for the first one's results."""
    store, out = desk.root / "shared-cache", desk.root / "shared"
    runs = [desk.build(out, store, only="views,mesh")]
    look.true("the first is at work", runs[0].until("views …"))
    runs.append(desk.build(out, store, only="views,mesh"))
    codes = [run.end() for run in reversed(runs)]
    look.true(f"exit codes {codes}", codes == [0, 0])
    look.true("the second waits", "waiting for another build" in runs[1].said)
    made = [run.said.count("[1/2] views …") for run in runs]
    look.true(f"views made {sum(made)} time", sum(made) == 1)
    look.true("every file as undisturbed", files_of(out) == desk.reference["views,mesh"])


def _whole(desk: Desk, look: Look) -> None:
    """A whole draft, ended again and again, against one that nobody disturbs."""
    store, out = desk.root / "whole-cache", desk.root / "whole"
    for stage in STOPS:
        run = desk.whole(WHOLE, out, store)
        look.true(f"SIGTERM in {stage}", run.until(f"] {stage} …"))
        time.sleep(1.0)
        code = run.end(signal.SIGTERM)
        ok = code == -signal.SIGTERM and "Traceback" not in run.said and run.gone()
        look.true(f"exit code {code}, no process left", ok)
        look.true(f"no {MANIFEST}", not (out / MANIFEST).exists())
    # What is left of the work, so that the next run only copies.
    rest = desk.whole(WHOLE, desk.root / "whole-rest", store)
    code = rest.end()
    went = rest.said.count(" …\n")
    look.true(f"the run after goes on: exit code {code}, {went} stages left", code == 0)
    ended_while_copying(look, lambda: desk.whole(WHOLE, out, store), out, signal.SIGTERM)
    code = desk.whole(WHOLE, out, store).end()
    found = files_of(out)
    calm = desk.root / "calm"
    look.true(
        f"again: exit code {code}; undisturbed, with a cache of its own: exit code "
        f"{desk.whole(WHOLE, calm, desk.root / 'calm-cache').end()}",
        (out / MANIFEST).is_file() and (calm / MANIFEST).is_file(),
    )
    sound = files_of(calm)
    other = sorted(
        name for name in sound.keys() | found.keys() if sound.get(name) != found.get(name)
    )
    look.true(
        f"{len(sound) - len(other)} of {len(sound)} files the same, others hold the stages' times "
        f"({', '.join(other) or 'none'})",
        sound.keys() == found.keys() and all(name.startswith("report/") for name in other),
    )
    with suppress(OSError):
        shutil.rmtree(store)


CASES: dict[str, Callable[[Desk, Look], None]] = {
    "disk full while a stage runs": _full_in_a_stage,
    "disk full while files are copied": _full_while_copying,
    "read-only folder that holds another build": _read_only_folder,
    "read-only cache": _read_only_cache,
    "SIGTERM and Ctrl-C in a stage": _ended_in_a_stage,
    "SIGTERM and Ctrl-C while files are copied": _ended_while_copying,
    "SIGTERM while a build is copied over another": _ended_over_an_old_build,
    "two builds at once into one folder": _two_take_turns,
    "two builds at once of one design, empty cache": _two_share_the_work,
}
