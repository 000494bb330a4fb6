"""Labelled frames from a renderer that runs as a child process and writes to its standard output.

The format, `boxline-stream/1`: first one line of ASCII JSON, padded with spaces before its newline,
    {"format":"boxline-stream/1","w":512,"h":384,"lw":256,"lh":192,"channels":9}
then for each frame: the seed (u64, little-endian), the length of the meta data (u32), the meta data (JSON),
h*w*3 bytes of RGB, and channels*lh*lw bytes of labels, one channel after the other, 0..255 for 0..1.

Needs numpy only.
"""

import json
import random
import shlex
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Iterator

import numpy as np

FORMAT = "boxline-stream/1"
CHANNELS = ("L1", "L2", "L3", "L4", "spill", "face_edge", "other_edge", "face_mask", "corner")
WORKSPACE = Path(__file__).resolve().parents[3]
FAKE_COMMAND = f"{shlex.quote(sys.executable)} {shlex.quote(str(Path(__file__).with_name('fake.py')))} --seed {{seed}}"
# cargo build --release -p boxline-cli
DEFAULT_COMMAND = "target/release/boxline render --stream --seed {seed}"
MAX_HEADER_BYTES = 4096
MAX_META_BYTES = 1 << 20
PIPE_BYTES = 1 << 20  # a frame's size, and the most that Linux gives without asking


class StreamError(Exception):
    """The stream is not what it should be: cut off, another format, or no renderer at all."""


@dataclass(frozen=True)
class Format:
    """Sizes in pixels; the labels are a smaller raster over the same view."""

    w: int
    h: int
    lw: int
    lh: int
    channels: int

    def header(self) -> bytes:
        return json.dumps({"format": FORMAT, **self.__dict__}, separators=(",", ":")).encode().ljust(127) + b"\n"


@dataclass
class Frame:
    seed: int
    meta: dict
    rgb: np.ndarray  # h, w, 3; u8
    labels: np.ndarray  # channels, lh, lw; u8


def read_header(file: BinaryIO) -> Format:
    line = file.readline(MAX_HEADER_BYTES)
    if not line:
        raise StreamError("the stream is empty: not even a header")
    try:
        header = json.loads(line)
    except ValueError:
        raise StreamError(f"the stream does not start with a header line but with {line[:60]!r}") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise StreamError(f"the stream is not {FORMAT} but {line[:80].decode('latin1').strip()}")
    try:
        sizes = {key: int(header[key]) for key in ("w", "h", "lw", "lh", "channels")}
    except (KeyError, TypeError, ValueError) as wrong:
        raise StreamError(f"the header lacks a size: {wrong}") from None
    if not all(0 < size <= 1 << 14 for size in sizes.values()):
        raise StreamError(f"the header has an impossible size: {sizes}")
    return Format(**sizes)


def read_exactly(file: BinaryIO, view: memoryview, what: str) -> int:
    """Fills the view; returns 0 if the stream ended before the first byte, else the view's length."""
    got = 0
    while got < len(view):
        count = file.readinto(view[got:])
        if not count:
            break
        got += count
    if 0 < got < len(view):
        raise StreamError(f"the stream is cut off in {what}: {got} of {len(view)} bytes")
    return got


def read_frame(file: BinaryIO, fmt: Format, rgb: np.ndarray | None = None, labels: np.ndarray | None = None) -> Frame | None:
    """The next frame, into the given arrays if there are any; None where the stream ends between two frames."""
    head = bytearray(12)
    if not read_exactly(file, memoryview(head), "a frame's head"):
        return None
    seed, length = struct.unpack("<QI", head)
    if length > MAX_META_BYTES:
        raise StreamError(f"frame {seed}: {length} bytes of meta data, more than {MAX_META_BYTES}: out of step?")
    meta = bytearray(length)
    rgb = np.empty((fmt.h, fmt.w, 3), np.uint8) if rgb is None else rgb
    labels = np.empty((fmt.channels, fmt.lh, fmt.lw), np.uint8) if labels is None else labels
    for view, what in ((memoryview(meta), "meta data"), (memoryview(rgb).cast("B"), "image"), (memoryview(labels).cast("B"), "labels")):
        if len(view) and not read_exactly(file, view, f"the {what} of frame {seed}"):
            raise StreamError(f"the stream is cut off before the {what} of frame {seed}")
    try:
        parsed = json.loads(meta) if meta else {}
    except ValueError:
        raise StreamError(f"frame {seed}: its meta data is not JSON: {bytes(meta[:60])!r}") from None
    return Frame(seed, parsed, rgb, labels)


def write_frame(file: BinaryIO, frame: Frame) -> None:
    meta = json.dumps(frame.meta, separators=(",", ":")).encode()
    file.write(struct.pack("<QI", frame.seed, len(meta)) + meta)
    file.write(np.ascontiguousarray(frame.rgb).tobytes())
    file.write(np.ascontiguousarray(frame.labels).tobytes())


class Renderer:
    """A running renderer. `command` is a command line in which {seed} stands for the first seed wanted."""

    def __init__(self, command: str, seed: int, log: BinaryIO | None = None):
        self.command = shlex.split(command.replace("{seed}", str(seed)))
        try:
            self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=log, cwd=WORKSPACE, bufsize=1 << 20, pipesize=PIPE_BYTES)
        except OSError as wrong:
            raise StreamError(f"cannot start the renderer `{self.command[0]}`: {wrong}") from wrong
        try:
            self.format = read_header(self.process.stdout)
        except StreamError as wrong:
            raise StreamError(f"{wrong} ({self.ending()})") from None

    def read(self, rgb: np.ndarray | None = None, labels: np.ndarray | None = None) -> Frame | None:
        try:
            return read_frame(self.process.stdout, self.format, rgb, labels)
        except StreamError as wrong:
            raise StreamError(f"{wrong} ({self.ending()})") from None

    def ending(self) -> str:
        """How the renderer ended, stopping it if it still runs."""
        try:
            code = self.process.wait(timeout=2)
        except subprocess.TimeoutExpired:
            self.close()
            return "the renderer was still running"
        return f"the renderer ended with code {code}"

    def close(self) -> None:
        if self.process.stdout:
            self.process.stdout.close()
        self.process.terminate()
        self.process.wait()

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def frames(command: str, seed: int, count: int) -> Iterator[Frame]:
    """The frames `seed .. seed + count`; an error if the renderer gives fewer."""
    with Renderer(command, seed) as renderer:
        for done in range(count):
            frame = renderer.read()
            if frame is None:
                raise StreamError(f"the renderer gave {done} frames, {count} were wanted ({renderer.ending()})")
            yield frame
