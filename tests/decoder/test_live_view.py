"""The live view: a page of its own, frames as they come, and a sensor that never waits."""

import contextlib
import http.client
import json
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving import live_view
from phytac_decoder.serving.live_view import LiveView, unrolled
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from tests.decoder.toy_sensor import toy_bundle
from tests.refusals import refused

PATIENCE_S = 10.0


def messages() -> MessageBuilder:
    regions = (Region(name="thumb", markers=(7, 8)),)
    return MessageBuilder(bundle=toy_bundle(), estimator="fem", regions=regions)


def frame(make: MessageBuilder, number: int) -> Message:
    forces = np.zeros(30)
    forces[7] = 0.5 + 0.1 * number
    reading = Reading(koi=np.array([7]), forces_N=forces)
    return make.frame(reading, sequence=number, timestamp_s=number / 480.0)


@contextmanager
def looking(view: LiveView) -> Iterator[Iterator[dict[str, Any]]]:
    """Events as a browser gets them."""
    link = http.client.HTTPConnection("127.0.0.1", view.port, timeout=PATIENCE_S)
    try:
        link.request("GET", "/events")
        answer = link.getresponse()
        assert answer.status == 200, answer.reason
        assert answer.headers["Content-Type"] == "text/event-stream"

        def events() -> Iterator[dict[str, Any]]:
            until = time.monotonic() + PATIENCE_S
            for line in answer:
                # Signs of life alone are not what is waited for.
                assert time.monotonic() < until, "nothing comes"
                if line.startswith(b"data: "):
                    yield json.loads(line[6:])

        yield events()
        answer.close()
    finally:
        link.close()


def get(
    view: LiveView, path: str, host: str | None = None, heads: dict[str, str] | None = None
) -> tuple[int, bytes]:
    link = http.client.HTTPConnection("127.0.0.1", view.port, timeout=PATIENCE_S)
    link.request("GET", path, headers=({"Host": host} if host else {}) | (heads or {}))
    answer = link.getresponse()
    try:
        endless = answer.headers["Content-Type"] == "text/event-stream"
        return answer.status, b"" if endless else answer.read()
    finally:
        link.close()


def test_the_page_needs_nothing_from_the_network() -> None:
    with LiveView(messages().hello(), port=0) as view:
        status, page = get(view, "/")
        assert status == 200
        assert not re.findall(rb"https?://|<link|src=|@import|url\(", page)
        assert get(view, "/", f"localhost:{view.port}")[0] == 200
        assert get(view, "/other")[0] == 404
        # A page of another site that has its name point here may not read forces.
        assert get(view, "/", "evil.example")[0] == 403
        assert get(view, "/events", f"evil.example:{view.port}")[0] == 403
        assert view.url == f"http://127.0.0.1:{view.port}/"


@pytest.mark.parametrize(
    "heads",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "image"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "document"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_another_sites_page_takes_no_viewers_place(heads: dict[str, str]) -> None:
    with LiveView(messages().hello(), port=0) as view:
        assert get(view, "/events", heads=heads)[0] == 403
        assert view.viewers == 0
        own = f"127.0.0.1:{view.port}"
        assert get(view, "/", own, {"Origin": f"http://{own}"})[0] == 200
        assert get(view, "/", own, {"Sec-Fetch-Site": "same-origin"})[0] == 200
        linked = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "document"}
        assert get(view, "/", own, linked)[0] == 200


def test_a_request_that_comes_byte_by_byte_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_view._Handler, "timeout", 0.5)
    with LiveView(messages().hello(), port=0) as view:
        begun = time.monotonic()
        with socket.create_connection(("127.0.0.1", view.port), timeout=0.1) as link:
            closed = False
            for byte in b"GET / HTTP/1.0\r\nX: " + b"x" * 200:
                assert time.monotonic() - begun < PATIENCE_S
                try:
                    link.sendall(bytes([byte]))
                    closed = link.recv(1) == b""
                except TimeoutError:
                    continue
                except OSError:
                    closed = True
                if closed:
                    break
        assert closed
        assert 0.4 < time.monotonic() - begun < 5.0
        # A viewer stays, longer than that.
        with looking(view) as events:
            next(events)
            time.sleep(0.8)
            view.publish(frame(messages(), 1))
            assert next(events)["sequence"] == 1


def test_open_connections_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_view._Http, "connections_max", 4)
    with LiveView(messages().hello(), port=0) as view:
        address = ("127.0.0.1", view.port)
        silent = [socket.create_connection(address, timeout=PATIENCE_S) for _ in range(4)]
        with socket.create_connection(address, timeout=2.0) as link:
            assert link.recv(1) == b""
        for one in silent:
            one.close()
        until = time.monotonic() + PATIENCE_S
        status = 0
        while status != 200 and time.monotonic() < until:
            with contextlib.suppress(OSError, http.client.HTTPException):
                status, _ = get(view, "/")
        assert status == 200


def test_frames_come_with_every_point_of_the_curves() -> None:
    make = messages()
    with LiveView(make.hello(), port=0) as view, looking(view) as events:
        hello = next(events)
        assert hello["type"] == "hello"
        assert len(hello["unrolled_mm"]) == len(hello["positions_mm"]) == 30
        got: list[list[float]] = []
        for number in range(60):
            view.publish(frame(make, number))
            time.sleep(0.002)
        while len(got) < 60:
            message = next(events)
            got += message["curve"]
        assert message["sequence"] == 59
        assert message["contacts"][0]["id"] == 0
        assert [round(480.0 * point[0]) for point in got] == list(range(60))
        assert got[10][1:] == [1.5, 1.5]
        view.close("it is over")
        assert next(events) == {"type": "end", "reason": "it is over"}
        with pytest.raises(StopIteration):
            next(events)


def test_browsers_that_stall_or_leave_delay_nothing() -> None:
    make = messages()
    text = "x" * 20_000
    with LiveView(make.hello(), port=0) as view:
        stalled = [socket.create_connection(("127.0.0.1", view.port)) for _ in range(4)]
        for link in stalled:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.sendall(b"GET /events HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n")
        with looking(view) as events:
            next(events)
            until = time.monotonic() + PATIENCE_S
            while view.viewers < 5 and time.monotonic() < until:
                time.sleep(0.01)
            assert view.viewers == 5
            spent = []
            for number in range(300):
                begun = time.perf_counter()
                view.publish(frame(make, number) | {"warnings": [text]})
                spent.append(time.perf_counter() - begun)
            while next(events)["sequence"] < 299:
                pass
        # No waiting for the four; a fair part of a frame's period.
        assert float(np.median(spent)) < 1e-3
        for link in stalled:
            link.close()
        while view.viewers and time.monotonic() < until:
            view.publish(frame(make, 300))
            time.sleep(0.02)
        assert view.viewers == 0


def test_no_more_browsers_than_there_is_room_for() -> None:
    with LiveView(messages().hello(), port=0) as view:
        for _ in range(LiveView.viewers_max):
            assert view.count_viewer(1)
        status, body = get(view, "/events")
        assert status == 503
        assert b"8 browsers are connected already" in body
        for _ in range(LiveView.viewers_max):
            view.count_viewer(-1)


def test_a_late_browser_gets_curves_thinned_evenly() -> None:
    make = messages()
    with LiveView(make.hello(), port=0) as view:
        for number in range(1000):
            view.publish(frame(make, number))
        with looking(view) as events:
            next(events)
            curve = next(events)["curve"]
    numbers = [round(480.0 * point[0]) for point in curve]
    assert len(numbers) == LiveView.curve_max
    assert (numbers[0], numbers[-1]) == (0, 999)
    assert max(np.diff(numbers)) <= 17


def test_a_taken_port_is_named() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        refused("port-unavailable"),
    ):
        LiveView(messages().hello(), port=taken.getsockname()[1])


def test_markers_are_laid_out_flat() -> None:
    row, column = np.divmod(np.arange(96), 12)
    angle = 2.0 * np.pi * (column / 12.0 + 0.02 * row)
    tube = np.column_stack([30.0 * np.cos(angle), 30.0 * np.sin(angle), 7.0 * row])
    flat = unrolled(tube)
    assert np.ptp(flat[:, 0]) == pytest.approx(2.0 * np.pi * 30.0, rel=0.1)
    np.testing.assert_allclose(flat[:, 1], tube[:, 2])
    # A sheet keeps its distances, however it stands.
    sheet = np.column_stack([10.0 * column, np.zeros(96), 8.0 * row + 20.0])
    laid = unrolled(sheet)
    gaps = np.linalg.norm(sheet[:, None] - sheet[None], axis=2)
    np.testing.assert_allclose(np.linalg.norm(laid[:, None] - laid[None], axis=2), gaps, atol=1e-9)
    # A dome: nothing falls on another, the pole is in the middle.
    polar = np.radians(10.0 + 10.0 * row)
    dome = 20.0 * np.column_stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)]
    )
    seen = unrolled(dome)
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + 100.0 * np.eye(96)
    assert apart.min() > 1.0
    assert np.linalg.norm(seen, axis=1).argmin() < 12
