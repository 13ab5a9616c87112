"""Only this machine's own page is answered; whatever comes instead, the studio lives on."""

import http.client
import json
import socket
from pathlib import Path
from typing import Any

import pytest

from phytac_design.studio.access_control import BODY_MAX
from phytac_design.studio.server import StudioServer
from tests.studio.place import Client


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


@pytest.mark.parametrize("dest", ["", "empty", "script", "image", "iframe", "object"])
def test_another_sites_page_may_embed_nothing_but_lead_here(client: Client, dest: str) -> None:
    heads = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": dest}
    assert client.ask("GET", "", heads=heads)[0] == 403
    assert client.ask("GET", "", heads=heads | {"Sec-Fetch-Dest": "document"})[0] == 200


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
        (b"", "Invalid JSON"),
        (b"{", "Invalid JSON"),
        (b"\xff\xfe", "Invalid JSON"),
        (b'{"name": NaN}', "valid string"),
        (b'{"name": 1e999}', "valid string"),
        (b"[" * 100_000, "recursion limit"),
        (b"[1, 2]", "the request"),
        (b'{"name": "cone", "more": 1}', "more: Extra inputs"),
        (b"{}", "name: Field required"),
        (b'{"name": ' + b"9" * 5000 + b"}", "the request"),
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


@pytest.mark.parametrize(
    ("heads", "status"),
    [({"content-length": str(BODY_MAX + 1)}, 413), ({"transfer-encoding": "chunked"}, 411)],
)
def test_a_body_that_is_giant_or_of_unknown_length_is_refused_before_it_comes(
    client: Client, heads: dict[str, str], status: int
) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=10.0)
    connection.putrequest("POST", f"/{client.token}/api/open")
    for key, value in {**heads, "content-type": "application/json"}.items():
        connection.putheader(key, value)
    connection.endheaders()
    assert connection.getresponse().status == status
    connection.close()
    assert alive(client)


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
