"""Only this machine's own page is answered; whatever comes instead, the studio lives on."""

import http.client
import json
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from phytac_design.studio.access_control import BODY_MAX
from phytac_design.studio.server import StudioServer
from tests.studio.place import Client, studio


def alive(client: Client) -> bool:
    return client.get("api/build")[0] == 200


def test_it_listens_on_this_machine_alone(running: StudioServer) -> None:
    assert running.listener.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("token", ["", "wrong", "x" * 500, "..", "%00"])
def test_without_the_token_nothing_is_answered(client: Client, token: str) -> None:
    for path in ("", "api/start", "static/main.js"):
        status, _, body = client.ask("GET", path, token=token)
        assert status == 403
        assert client.token.encode() not in body


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "", "127.0.0.1.nip.io:{port}"]
)
def test_a_name_that_was_made_to_point_here_is_refused(client: Client, host: str) -> None:
    heads = {"Host": host.format(port=client.port)}
    assert client.ask("GET", "api/start", heads=heads)[0] == 403


def test_its_own_names_are_not(client: Client) -> None:
    for name in ("127.0.0.1", "localhost", "[::1]"):
        heads = {"Host": f"{name}:{client.port}"}
        assert client.ask("GET", "api/build", heads=heads)[0] == 200


@pytest.mark.parametrize(
    "heads",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_another_sites_page_may_not_post(client: Client, heads: dict[str, str]) -> None:
    status, _, _ = client.ask("POST", "api/open", {"name": "cylinder60"}, heads=heads)
    assert status == 403
    assert client.ask("POST", "api/open", {"name": "cylinder60"})[0] == 200


def test_a_form_cannot_post(client: Client) -> None:
    for kind in ("text/plain", "application/x-www-form-urlencoded", ""):
        heads = {"content-type": kind}
        assert client.ask("POST", "api/open", {"name": "cone"}, heads=heads)[0] == 415


def test_every_answer_keeps_to_itself(client: Client) -> None:
    for path in ("", "static/main.js", "api/build", "nothing"):
        heads = {key.lower(): value for key, value in client.ask("GET", path)[1].items()}
        assert heads["referrer-policy"] == "no-referrer"
        assert heads["x-content-type-options"] == "nosniff"
        assert "default-src 'none'; script-src 'self';" in heads["content-security-policy"]


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"", "not JSON"),
        (b"{", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b'{"name": NaN}', "NaN is no number"),
        (b'{"name": 1e999}', "valid string"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[1, 2]", "the request"),
        (b'{"name": "cone", "more": 1}', "unknown field 'more'"),
        (b"{}", "name: field required"),
        (b'{"name": ' + b"9" * 5000 + b"}", "not JSON"),
        (b'{"name": "no-such"}', "no design 'no-such'"),
        (b'{"name": "../../etc/passwd"}', "is not in the folder"),
        (b'{"name": "/etc/passwd"}', "is not in the folder"),
        (b'{"name": "a\\u0000b"}', "is not in the folder"),
    ],
)
def test_what_is_no_request_is_said_so(client: Client, raw: bytes, said: str) -> None:
    status, _, body = client.ask("POST", "api/open", raw=raw)
    text = json.loads(body)["error"]
    assert status == 400
    assert said in text
    assert "Traceback" not in text
    assert alive(client)


def test_a_giant_body_is_refused_before_and_while_it_comes(client: Client) -> None:
    heads = {"content-length": str(BODY_MAX + 1)}
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=10.0)
    connection.putrequest("POST", f"/{client.token}/api/open")
    for key, value in {**heads, "content-type": "application/json"}.items():
        connection.putheader(key, value)
    connection.endheaders()
    assert connection.getresponse().status == 413
    connection.close()

    # In chunks, which say no length.
    with socket.create_connection(("127.0.0.1", client.port), timeout=30.0) as line:
        head = f"POST /{client.token}/api/open HTTP/1.1\r\nHost: 127.0.0.1:{client.port}\r\n"
        line.sendall((head + "Content-Type: application/json\r\n").encode())
        line.sendall(b"Transfer-Encoding: chunked\r\n\r\n")
        piece = b"%x\r\n" % 1_000_000 + b" " * 1_000_000 + b"\r\n"
        answer = b""
        try:
            for _ in range(BODY_MAX // 1_000_000 + 2):
                line.sendall(piece)
            answer = line.recv(100)
        except ConnectionError:  # it hung up before it was read
            answer = b"HTTP/1.1 413"
    assert b" 413" in answer
    assert alive(client)


def test_slow_clients_are_disconnected(tmp_path: Path) -> None:
    with studio(tmp_path, timeout_s=1.0) as running:
        client = Client(running)
        head = f"POST /{client.token}/api/open HTTP/1.1\r\nHost: 127.0.0.1:{client.port}\r\n"
        whole = head + "Content-Type: application/json\r\nContent-Length: 50\r\n\r\n{"
        lines = []
        for text in ("", "GE", head, whole):
            line = socket.create_connection(("127.0.0.1", client.port), timeout=30.0)
            line.sendall(text.encode())
            lines.append(line)
        start = time.monotonic()
        assert alive(client)
        assert time.monotonic() - start < 20.0
        answers = [line.recv(1000) for line in lines]
        assert answers[:3] == [b"", b"", b""]
        assert b" 408" in answers[3]
        for line in lines:
            line.close()


def test_clients_that_receive_nothing_are_disconnected(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Though closing such a line would wait for its last byte to be taken."""
    with studio(tmp_path, timeout_s=0.5) as running:
        ask = (
            f"GET /{running.token}/viewer/three.bundle.min.js HTTP/1.1\r\n"
            f"Host: 127.0.0.1:{running.port}\r\n\r\n"
        )
        lines = []
        for _ in range(3):
            line = socket.socket()
            line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            line.connect(("127.0.0.1", running.port))
            line.sendall(ask.encode() * 40)
            lines.append(line)
        there = running.server.server_state.connections
        until = time.monotonic() + 20.0
        while len(there) < 3 and time.monotonic() < until:
            time.sleep(0.01)
        assert len(there) == 3
        while there and time.monotonic() < until:
            time.sleep(0.05)
        assert not there
        assert alive(Client(running))
        for line in lines:
            line.close()
    assert "Traceback" not in caplog.text


def test_a_slow_receiver_gets_all(tmp_path: Path) -> None:
    with studio(tmp_path, timeout_s=0.5) as running, socket.socket() as line:
        path = f"/{running.token}/viewer/three.bundle.min.js"
        size = len(Client(running).ask("GET", "viewer/three.bundle.min.js")[2])
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        line.settimeout(30.0)
        line.connect(("127.0.0.1", running.port))
        count = 20
        line.sendall(
            f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{running.port}\r\n\r\n".encode() * count
        )
        taken = 0
        begin = time.monotonic()
        while taken < count * size and (piece := line.recv(size)):
            taken += len(piece)
            # As a line of some megabytes a second.
            time.sleep(max(0.0, begin + 2.0 * taken / (count * size) - time.monotonic()))
        assert taken >= count * size > 10_000_000


def test_many_silent_clients_block_nobody(client: Client) -> None:
    lines = [socket.create_connection(("127.0.0.1", client.port)) for _ in range(60)]
    try:
        assert alive(client)
    finally:
        for line in lines:
            line.close()


@pytest.mark.parametrize("text", [b"\x00" * 1000, b"GET / HTTP/9.9\r\n\r\n", b"A" * 100_000])
def test_what_is_no_http_is_refused(client: Client, text: bytes) -> None:
    with socket.create_connection(("127.0.0.1", client.port), timeout=30.0) as line:
        line.sendall(text)
        try:
            answer = line.recv(1000)
        except ConnectionResetError:
            answer = b""
        assert answer == b"" or answer.startswith(b"HTTP/1.1 4")
    assert alive(client)


def test_pages_of_a_build_are_shut_off(client: Client, place: Path) -> None:
    folder = place / "exports" / "one"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.html").write_text("<script>parent.studio</script>")
    (folder / "weights.safetensors").write_bytes(b"1")
    (folder / ".secret.html").write_text("x")
    status, heads, _ = client.ask("GET", "files/exports/one/report.html")
    assert status == 200
    policy = {key.lower(): value for key, value in heads.items()}["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in policy
    for path in (
        "exports/one/weights.safetensors",
        "exports/one/.secret.html",
        "exports",
        "no.html",
    ):
        assert client.ask("GET", f"files/{path}")[0] == 404
    (place.parent / "outside.html").write_text("x")
    (folder / "link.html").symlink_to(place.parent / "outside.html")
    for path in ("exports/one/link.html", "%2e%2e/outside.html", "/etc/passwd"):
        assert client.ask("GET", f"files/{path}")[0] in {400, 404}


def test_a_fault_of_the_program_is_no_traceback(
    client: Client, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr("phytac_design.studio.web_app.studies", broken)
    status, body = client.get("api/studies")
    assert status == 500
    assert "ZeroDivisionError" in body["error"]
    assert "secret" not in body["error"]
    assert "secret detail" in capsys.readouterr().err
    assert alive(client)
