"""A new rest frame while a stream runs: asked for by a client, a browser or a program."""

import http.client
import json
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.serving.force_server import StreamServer
from phytac_decoder.serving.live_view import LiveView
from phytac_decoder.serving.sensor_loop import Decode, follow_decoder, frame_decoder
from phytac_decoder.serving.tare import FRAMES, TareDecoder
from phytac_shapes.arrays import ImageArray
from tests.decoder.test_live_view import looking, messages
from tests.decoder.test_serve import Client, wait_until
from tests.decoder.test_stream import run
from tests.decoder.toy_sensor import toy_bundle, toy_frame, toy_recording
from tests.test_cli import phytac


def taring(*, follow: bool = False) -> TareDecoder:
    bundle = toy_bundle()

    def made(calibrated: Bundle, rest: Sequence[ImageArray]) -> Decode:
        return follow_decoder(calibrated, rest) if follow else frame_decoder(calibrated)

    return TareDecoder(bundle, made(bundle, [toy_frame({})]), made)


def frame(number: int, image: ImageArray | None) -> Frame:
    images = () if image is None else (image,)
    return Frame(number=number, timestamp_s=0.1 * number, images=images, ready_s=time.monotonic())


@pytest.mark.parametrize("follow", [False, True])
def test_what_presses_counts_as_nothing_afterwards(*, follow: bool) -> None:
    # A newton moves its marker by a pixel: 3 N on marker 7 without its switch, then 5 N with it.
    image, more, decode = (
        toy_frame({7: 3.0}, tips=False),
        toy_frame({7: 5.0}),
        taring(follow=follow),
    )
    before = decode(frame(0, more))
    decode.tare()
    for k in range(FRAMES):
        assert decode.result() is None
        decode(frame(1 + k, image))
    assert decode.result() == {"done": True}
    assert decode.result() is None
    moved = decode._decode
    after = decode(frame(50, more))
    assert before.forces_N[7] == pytest.approx(5.0, abs=0.2)
    assert after.forces_N[7] == pytest.approx(2.0, abs=0.3)
    assert decode._decode is moved


def test_a_tare_of_a_pressed_sensor_is_refused() -> None:
    decode = taring()
    decode.tare()
    for k in range(FRAMES):
        pressed = decode(frame(k, toy_frame({7: 3.0})))
    result = decode.result()
    assert result is not None
    assert (result["done"], result["code"]) == (False, "rest-frame-pressed")
    assert "receptors 7 (1 in all)" in result["reason"]
    assert pressed.forces_N[7] == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("lost", [False, True])
def test_a_tare_that_fails_leaves_the_old_rest_frame(*, lost: bool) -> None:
    decode = taring()
    decode.tare()
    images: list[ImageArray | None] = [toy_frame({}) for _ in range(FRAMES - 1)]
    images.append(None if lost else toy_frame({7: 3.0, 14: 4.0, 21: 5.0}))
    for number, image in enumerate(images):
        if image is None:
            with pytest.raises(Exception, match="frame"):
                decode(frame(number, image))
        else:
            reading = decode(frame(number, image))
    result = decode.result()
    assert result is not None
    assert (result["done"], result["code"]) == (
        False,
        "rest-frame-missing" if lost else "rest-frames-unsteady",
    )
    if not lost:
        assert reading.forces_N[7] == pytest.approx(3.0, abs=0.2)
    # It can be asked for again.
    decode.tare()
    for number in range(FRAMES):
        decode(frame(20 + number, toy_frame({})))
    assert decode.result() == {"done": True}


def test_the_frame_in_which_it_ended_says_so() -> None:
    decode, said = taring(), list[str]()
    decode.tare()
    sent, _ = run(
        [toy_frame({})] * (FRAMES + 2),
        decode=decode,
        tare_result=decode.result,
        report=said.append,
    )
    assert [number for number, one in enumerate(sent) if "tare" in one] == [FRAMES - 1]
    assert sent[FRAMES - 1]["tare"] == {"done": True}
    assert said == ["tare: a new rest frame was taken"]


def test_a_client_asks_by_one_line() -> None:
    asked: list[str] = []
    said: list[str] = []
    with StreamServer(
        {"type": "hello"}, port=0, tare=lambda: asked.append("tare"), report=said.append
    ) as server:
        client = Client(server)
        client.socket.sendall(b'{"type":"other"}\n{"ty')
        client.socket.sendall(b'pe":"tare"}\n')
        wait_until(lambda: len(asked) == 1)
        # What is no message is ignored, and the next line is read again.
        client.socket.sendall(b"\nno message\n[1]\n\xff\xfe\n")
        client.socket.sendall(b'{"type":"tare"}\nno message\n{"type":"tare"}\n')
        wait_until(lambda: len(asked) == 3)
        server.publish({"type": "frame", "sequence": 0})
        wait_until(lambda: any(one["type"] == "frame" for one in client.got))
    assert client.all()[-1]["type"] == "end"
    assert asked == ["tare"] * 3
    assert sum("sends what is ignored" in text for text in said) == 1


def test_the_live_view_has_a_button() -> None:
    asked: list[str] = []

    def post(view: LiveView, **headers: str) -> int:
        link = http.client.HTTPConnection("127.0.0.1", view.port, timeout=10.0)
        link.request(
            "POST", "/tare", headers={name.replace("_", "-"): x for name, x in headers.items()}
        )
        status = link.getresponse().status
        link.close()
        return status

    make = messages()
    with LiveView(make.hello(), port=0, tare=lambda: asked.append("tare")) as view:
        assert post(view) == 200
        # A page of another site may not.
        assert post(view, Origin="http://example.org") == 403
        assert post(view, Sec_Fetch_Site="cross-site") == 403
        assert post(view, Host="example.org") == 403
        assert asked == ["tare"]
        decode = taring()
        tared = make.frame(decode(frame(0, toy_frame({}))), sequence=0, timestamp_s=0.0)
        plain = make.frame(decode(frame(1, toy_frame({}))), sequence=1, timestamp_s=0.1)
        view.publish({**tared, "tare": {"done": True}})
        view.publish(plain)
        with looking(view) as events:
            next(events)
            # Browsers skip frames: the newest has the result.
            newest = next(events)
            assert (newest["sequence"], newest["tare"]) == (1, {"done": True})


def test_the_server_tares(tmp_path: Path) -> None:
    """A whole run: what moved marker 7 before its switch came on counts as nothing."""
    import threading

    _, folder = toy_recording(tmp_path, [{7: 5.0}] * 20)
    for number in range(15):
        cv2.imwrite(str(folder / f"frame_{number}.png"), toy_frame({7: 3.0}, tips=False))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    got: list[dict[str, Any]] = []

    def client() -> None:
        for _ in range(400):
            try:
                link = socket.create_connection(("127.0.0.1", port), timeout=10.0)
                break
            except OSError:
                time.sleep(0.02)
        link.sendall(b'{"type":"tare"}\n')
        with link, link.makefile() as lines:
            got.extend(json.loads(line) for line in lines)

    thread = threading.Thread(target=client)
    thread.start()
    done = phytac("serve", "decoder", "frames", "--port", str(port), "--fps", "80", "--wait",
                  "--every", "--estimator", "koi_inverse", cwd=tmp_path)  # fmt: skip
    thread.join(20.0)
    assert done.returncode == 0, done.stderr
    frames = [one for one in got if one["type"] == "frame"]
    ended = [one["sequence"] for one in frames if "tare" in one]
    assert len(ended) == 1
    assert frames[ended[0]]["tare"] == {"done": True}
    assert frames[-1]["total_N"] == pytest.approx(2.0, abs=0.3)
    assert "asks for a new rest frame" in done.stderr
