"""A force stream for Rerun: a file ``.rrd``, or its viewer."""

import contextlib
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.serving.wire_protocol import Message
from phytac_shapes.errors import MissingPartError, OutputError

ARROW_mm_N = 5.0
"""Length of a contact's arrow, as in the recordings with ROS 2 messages."""
VIEWER_PORT = 9876
"""Of Rerun's viewer on this machine, as Rerun has it."""
OPENS_s, SETTLES_s = 15.0, 0.5
"""Longest time in which a viewer opens; one without a display ends sooner than the second."""
GREY, RED, BLUE = (150, 150, 150), (220, 40, 40), (40, 90, 220)


class RerunRecorder:
    """Logs each frame as it comes; Rerun writes in the background, five times a second.

    Parameters
    ----------
    path : Path or None
        File to make; None shows the stream in the viewer of this machine, which is opened if none
        is. It listens to this machine alone.
    bundle : Bundle
        The sensor's decoder.
    started_unix_s : float
        Unix time at which the frames' ``timestamp_s`` is 0.

    Raises
    ------
    MissingPartError
        If rerun-sdk is not installed.
    OutputError
        If the file exists or cannot be written, or the viewer cannot be opened.
    """

    def __init__(self, path: Path | None, bundle: Bundle, started_unix_s: float) -> None:
        self._rerun = _library()
        self._position_mm, self._started_s = bundle.position_mm, started_unix_s
        self.rows = 0
        self._stream = self._rerun.RecordingStream(f"phytac {bundle.design}")
        try:
            if path is None:
                _open_viewer()
                self._stream.connect_grpc(f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy")
            else:
                path.open("xb").close()
                self._stream.save(path)
        except FileExistsError:
            raise OutputError(
                "output-exists", f"{path} is there already; choose another name, or remove it"
            ) from None
        except OSError as error:
            raise OutputError(
                "output-not-writable", f"{path} cannot be written ({error.strerror or error})"
            ) from None
        self._log("sensor/markers", "Points3D", self._position_mm, colors=GREY, static=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with contextlib.suppress(RuntimeError):  # a viewer that was closed
            self._stream.flush()
        self._stream.disconnect()

    def add(self, message: Message) -> None:
        """Log a frame: switches, contacts as arrows, forces as curves, warnings as text."""
        self._stream.set_time("frame", sequence=message["sequence"])
        self._stream.set_time("time", timestamp=self._started_s + message["timestamp_s"])
        for text in message["warnings"]:
            level = "WARN" if message["valid"] else "ERROR"
            self._log("warnings", "TextLog", text, level=level)
        self.rows += 1
        if not message["valid"]:
            return
        contacts = message["contacts"]
        places = np.array([one["position_mm"] for one in contacts]).reshape(-1, 3)
        normals = np.array([one["normal"] for one in contacts]).reshape(-1, 3)
        forces = np.array([one["force_N"] for one in contacts])
        arrows = ARROW_mm_N * forces[:, None] * normals
        self._log("sensor/switches", "Points3D", self._position_mm[message["koi"]], colors=RED)
        self._log(
            "sensor/contacts",
            "Arrows3D",
            vectors=-arrows,
            origins=places + arrows,
            colors=BLUE,
            labels=[_label(one) for one in contacts],
        )
        self._log("force/total_N", "Scalars", message["total_N"])
        self._log("force/net_N", "Scalars", message["net_force_N"])
        if "net_force_sd_N" in message:
            self._log("force/net_sd_N", "Scalars", message["net_force_sd_N"])
        for region in message.get("regions", []):
            self._log(["force", "regions", region["name"]], "Scalars", region["force_N"])

    def _log(
        self, entity: str | list[str], kind: str, *parts: Any, static: bool = False, **named: Any
    ) -> None:
        """Log an archetype; a list names an entity whose parts may hold any character."""
        self._stream.log(entity, getattr(self._rerun, kind)(*parts, **named), static=static)


def _label(contact: Message) -> str:
    """Text at a contact's arrow: its force and, where known, the standard deviation."""
    spread = f" ± {contact['sd_N']:.1f}" if "sd_N" in contact else ""
    return f"{contact['force_N']:.1f}{spread} N"


def _open_viewer() -> None:
    """Open Rerun's viewer on this machine, unless one listens.

    Raises
    ------
    OutputError
        If it does not open.
    """
    if _listens():
        return
    words = ("-m", "rerun", "--bind", "127.0.0.1", "--port", str(VIEWER_PORT))
    process = subprocess.Popen(
        [sys.executable, *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # it stays when the command ends
    )
    end_s = time.monotonic() + OPENS_s
    while process.poll() is None and time.monotonic() < end_s:
        if _listens():
            time.sleep(SETTLES_s)
            if process.poll() is None:
                return
        time.sleep(0.05)
    process.kill()
    process.wait()
    raise OutputError(
        "viewer-not-opened",
        "Rerun's viewer did not open; it needs a display. Record with --record FILE.rrd, and open "
        "that where there is one: rerun FILE.rrd",
    )


def _listens() -> bool:
    """Whether a viewer listens on this machine."""
    with socket.socket() as link:
        link.settimeout(0.5)
        return link.connect_ex(("127.0.0.1", VIEWER_PORT)) == 0


def _library() -> Any:
    """The package rerun.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import rerun
    except ImportError:
        raise MissingPartError.of_library("Rerun", "rerun-sdk", "rerun") from None
    return rerun
