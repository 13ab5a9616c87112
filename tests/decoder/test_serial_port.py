"""A serial port: how it is set up, and what goes out of it to whoever listens late."""

import contextlib
import os
import termios
import threading
import time
from pathlib import Path

from phytac_decoder.io.serial_port import SerialPort
from phytac_decoder.serving.force_server import ClientLimits, StreamServer
from phytac_decoder.serving.wire_protocol import Message, MessageSplitter


def test_settings_of_an_earlier_user_go() -> None:
    master, slave = os.openpty()
    before = termios.tcgetattr(slave)
    before[2] |= termios.CSTOPB | termios.CRTSCTS | termios.PARENB | termios.PARODD
    termios.tcsetattr(slave, termios.TCSANOW, before)
    port = SerialPort(Path(os.ttyname(slave)))
    flags = termios.tcgetattr(slave)[2]
    assert not flags & (termios.CSTOPB | termios.CRTSCTS | termios.PARENB)
    assert flags & termios.CSIZE == termios.CS8
    assert flags & termios.CLOCAL
    port.close()
    os.close(slave)
    os.close(master)


def test_hello_is_repeated_even_on_a_full_port() -> None:
    """Frames come faster than they go out, so that two always wait."""
    limits = ClientLimits(hello_again_s=0.09)
    master, slave = os.openpty()
    port = SerialPort(Path(os.ttyname(slave)))
    hello = {"type": "hello", "name": "x" * 100}
    got: list[Message] = []
    done = threading.Event()

    def read() -> None:
        splitter = MessageSplitter("lines")
        os.set_blocking(master, False)
        while not done.is_set():
            with contextlib.suppress(BlockingIOError):
                got.extend(splitter.feed(os.read(master, 256)))
            time.sleep(0.002)

    reader = threading.Thread(target=read)
    reader.start()
    with StreamServer(hello, port=0, serial=port, limits=limits) as server:
        # Eight take 0.8 s, and longer on a busy machine.
        until = time.monotonic() + 5.0
        sent = 0
        while sum(message["type"] == "hello" for message in list(got)) < 8 and (
            time.monotonic() < until
        ):
            server.publish({"type": "frame", "sequence": sent, "pad": "y" * 5000})
            sent += 1
            time.sleep(0.005)
        hellos = [message for message in got if message["type"] == "hello"]
        frames = [message for message in got if message["type"] == "frame"]
        done.set()
    reader.join()
    assert len(hellos) >= 8
    # Hello drives out no frame: what is missing between two of them was dropped, or waits.
    assert frames[-1]["dropped"] - frames[0]["dropped"] == (
        frames[-1]["sequence"] - frames[0]["sequence"] + 1 - len(frames)
    )
    os.close(slave)
    os.close(master)
