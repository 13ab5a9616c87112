"""A force stream as MCAP with ROS 2 messages, for Foxglove, ``ros2 bag`` and RViz.

Messages of others' MCAP files are read here, too.
"""

import contextlib
import time
from collections.abc import Collection, Iterator
from os import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.ros2_messages import (
    camera_messages,
    cdr_bytes,
    frame_messages,
    schema_text,
)
from phytac_shapes.errors import InputError, MissingPartError, OutputError, cause_of

TOPICS = "/phytac/"
"""What the names of topics begin with."""
CHUNK_s = 0.5
"""Seconds of a chunk: what a killed program may lose, and less than the second that is promised."""
CAMERA_INFO_s = 1.0
"""Seconds between messages that describe the cameras."""
MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file that was closed."""


class McapRecorder:
    """Writes messages of each frame as it comes; chunks are closed twice a second.

    Parameters
    ----------
    path : Path
        File to make.
    bundle : Bundle
        The sensor's decoder.
    started_unix_s : float
        Unix time at which the frames' ``timestamp_s`` is 0.

    Raises
    ------
    MissingPartError
        If mcap is not installed.
    OutputError
        If the file exists, or cannot be written.
    """

    def __init__(self, path: Path, bundle: Bundle, started_unix_s: float) -> None:
        writer = _library()
        self._path, self._bundle = path, bundle
        # A float holds nanoseconds since 1970 to some hundreds.
        self._started_ns = 1000 * round(1e6 * started_unix_s)
        self._schemas, self._channels = dict[str, int](), dict[str, int]()
        self.rows, self._closed_s, self._shown_s = 0, time.monotonic(), -CAMERA_INFO_s
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise OutputError(
                "output-exists",
                f"{path} is there already; choose another name, or remove it",
            ) from None
        except OSError as error:
            raise OutputError(
                "output-not-writable", f"{path} cannot be written ({error.strerror})"
            ) from None
        self._writer = writer(self._file)
        self._writer.start(profile="ros2", library="phytac-design")
        self._broken = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with contextlib.suppress(OSError):  # of a full disk, which was reported
            if not self._broken:
                self._writer.finish()
        with contextlib.suppress(OSError):
            self._file.close()

    def add(self, message: Message) -> None:
        """Write a frame's messages; raises OutputError if the disk is full."""
        stamp_ns, decoded_ns = (
            self._started_ns + round(1e9 * message[name]) for name in ("timestamp_s", "decoded_s")
        )
        messages = list(frame_messages(message, stamp_ns, len(self._bundle.position_mm)))
        now = time.monotonic()
        if now - self._shown_s >= CAMERA_INFO_s:
            self._shown_s = now
            messages += camera_messages(self._bundle.cameras, stamp_ns)
        try:
            for topic, type_name, fields in messages:
                self._writer.add_message(
                    channel_id=self._channel(topic, type_name),
                    log_time=stamp_ns,
                    publish_time=max(decoded_ns, stamp_ns),
                    sequence=message["sequence"] % 2**32,
                    data=cdr_bytes(type_name, fields),
                )
            if now - self._closed_s >= CHUNK_s:
                self._closed_s = now
                self._writer.flush()
        except OSError as error:
            self._broken = True
            raise OutputError(
                "output-not-writable", f"{self._path} cannot be written ({error.strerror})"
            ) from None
        self.rows += 1

    def _channel(self, topic: str, type_name: str) -> int:
        """Number of a topic's channel, made at its first message."""
        if type_name not in self._schemas:
            text, name = schema_text(type_name), type_name.replace("/", "/msg/")
            self._schemas[type_name] = self._writer.register_schema(name, "ros2msg", text.encode())
        if topic not in self._channels:
            schema = self._schemas[type_name]
            self._channels[topic] = self._writer.register_channel(TOPICS + topic, "cdr", schema)
        return self._channels[topic]


def _library() -> Any:
    """The writer of MCAP files.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise MissingPartError.of_library("MCAP", "mcap", "recordings") from None
    return Writer


class McapMessage(NamedTuple):
    """A message of a file: its topic, when it was recorded (Unix time, ns), and its fields."""

    topic: str
    recorded_ns: int
    fields: Any


def mcap_topics(path: Path) -> dict[str, str]:
    """Topics of a file, and the types of their messages.

    Raises
    ------
    MissingPartError
        If mcap-ros2-support is not installed.
    InputError
        If the file cannot be read.
    """
    found = {}
    with _reading(path) as (reader, closed):
        summary = reader.get_summary() if closed else None
        if summary is not None:
            schemas = summary.schemas
            pairs = [(schemas.get(one.schema_id), one) for one in summary.channels.values()]
        else:
            pairs = [each[:2] for each in _to_its_end(reader.iter_messages(log_time_order=False))]
        for schema, channel in pairs:
            found[channel.topic] = schema.name if schema else "no type"
    return found


def mcap_messages(path: Path, topics: Collection[str]) -> Iterator[McapMessage]:
    """Messages of some topics, in no order; of a file that was not closed those that are whole.

    Raises
    ------
    MissingPartError
        If mcap-ros2-support is not installed.
    InputError
        If the file cannot be read, or a message is not of ROS 2.
    """
    with _reading(path) as (reader, _):
        messages = reader.iter_decoded_messages(topics, log_time_order=False)
        for _, channel, message, fields in _to_its_end(messages):
            yield McapMessage(channel.topic, message.log_time, fields)


def _to_its_end(messages: Iterator[Any]) -> Iterator[Any]:
    """Messages up to the end of a file, even where a record is cut off there."""
    from mcap.exceptions import EndOfFile

    with contextlib.suppress(EndOfFile):
        yield from messages


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[tuple[Any, bool]]:
    """Reader of a file, and whether the file was closed; raises as :func:`mcap_messages` does."""
    try:
        from mcap.exceptions import DecoderNotFoundError
        from mcap.reader import NonSeekingReader, SeekingReader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise MissingPartError.of_library(
            "Reading MCAP", "mcap-ros2-support", "recordings"
        ) from None
    try:
        with path.open("rb") as file:
            closed = _is_closed(file, path)
            kind = SeekingReader if closed else NonSeekingReader
            yield kind(file, validate_crcs=True, decoder_factories=[DecoderFactory()]), closed
    except InputError:
        raise
    except OSError as error:
        raise InputError("file-unreadable", f"no MCAP at {path} ({error.strerror})") from None
    except DecoderNotFoundError:
        raise InputError(
            "file-unreadable",
            f"{path}: messages are read with the definitions of ROS 2 alone (cdr with ros2msg); a "
            "topic that was asked for has another encoding",
        ) from None
    except Exception as error:  # decompression, records and fields: no common class
        raise InputError(
            "file-unreadable",
            f"{path} is damaged ({cause_of(error) or type(error).__name__})",
        ) from error


def _is_closed(file: BinaryIO, path: Path) -> bool:
    """Whether a file has its end; it is read from its beginning afterwards."""
    if file.read(len(MAGIC)) != MAGIC:
        raise InputError("file-unreadable", f"{path} is no MCAP file")
    file.seek(-len(MAGIC), SEEK_END)
    closed = file.read() == MAGIC
    file.seek(0)
    return closed
