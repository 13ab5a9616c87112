"""A studio on a free port in a folder of its own, in a thread; and plain requests to it."""

import http.client
import json
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from phytac_design.studio.server import StudioServer
from tests.studio.checks import exact_without_bowls

DESIGN = """# A short sensor.
name = "short"        # in exports

[shape]
kind = "cylinder"
diameter_outer_mm = 60.0   # as published
length_mm = 60.0

[layout]
rows = 8
columns = 14
# Far ones are taller.
height_far_mm = 6.0

[camera]
width_px = 648
height_px = 486
focal_px = 242.5
"""

PROGRAM = """
import sys, time
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
print("[0/2] views …", flush=True); print("[1/2] views 0.1 s", flush=True)
print("[1/2] report …", flush=True)
mode = Path("mode").read_text()
Path("pid").write_text(str(__import__("os").getpid()))
Path("given.toml").write_text(Path(sys.argv[4]).read_text())
if mode == "long":
    import subprocess
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    Path("child").write_text(str(child.pid))
    time.sleep(60)
if mode == "stubborn":
    import signal
    signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Path("ready").write_text("")
    time.sleep(60)
if mode == "bad":
    print("error[wall-too-thin]: the wall is too thin; thicken it", file=sys.stderr); sys.exit(2)
if mode == "crash":
    raise ValueError("deep inside")
(out / "report").mkdir(parents=True, exist_ok=True)
(out / "report" / "report.html").write_text("<h1>Report of it</h1>")
"""
"""Stands in for `phytac build`: says what it says, without the work."""


def stand_in(root: Path, mode: str) -> Path:
    """Put a program in a folder that stands in for Python when a build is started."""
    path = root / "python"
    path.write_text(f"#!{sys.executable}\n{PROGRAM}")
    path.chmod(0o755)
    (root / "mode").write_text(mode)
    return path


@contextmanager
def studio(root: Path, design: str = "") -> Iterator[StudioServer]:
    """Run a studio while the block lasts."""
    path = root / "short.toml"
    if not path.exists():
        path.write_text(DESIGN, encoding="utf-8")
    with mock.patch("phytac_design.studio.web_app.exact_in_worker", exact_without_bowls):
        running = StudioServer(root, design or str(path))
    ready = threading.Event()
    thread = threading.Thread(target=lambda: running.run(ready=lambda _: ready.set()))
    thread.start()
    try:
        assert ready.wait(60.0)
        yield running
    finally:
        running.stop()
        thread.join(60.0)
        assert not thread.is_alive()


class Client:
    """Requests as the page makes them, or with other headers."""

    def __init__(self, running: StudioServer) -> None:
        self.port, self.token = running.port, running.token

    def ask(
        self,
        method: str,
        path: str,
        body: Any = None,
        *,
        raw: bytes | None = None,
        heads: dict[str, str] | None = None,
        token: str | None = None,
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        data = raw if raw is not None else None if body is None else json.dumps(body).encode()
        own = {"content-type": "application/json"} if data is not None else {}
        address = f"/{self.token if token is None else token}/{path}"
        connection.request(method, address, data, {**own, **(heads or {})})
        answer = connection.getresponse()
        out = answer.status, dict(answer.getheaders()), answer.read()
        connection.close()
        return out

    def post(self, path: str, body: Any) -> tuple[int, Any]:
        """Status and JSON."""
        status, _, text = self.ask("POST", path, body)
        return status, json.loads(text)

    def get(self, path: str) -> tuple[int, Any]:
        """Status and JSON."""
        status, _, text = self.ask("GET", path)
        return status, json.loads(text)
