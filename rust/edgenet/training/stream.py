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
import threading
from collections import deque
from dataclasses import dataclass, field
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
            self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=log, cwd=WORKSPACE, bufsize=1 << 20)
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


@dataclass
class Batch:
    rgb: np.ndarray  # n, h, w, 3; u8
    labels: np.ndarray  # n, channels, lh, lw; u8
    metas: list[dict] = field(default_factory=list)
    slots: list[int] = field(default_factory=list)  # their places in the ring


class FrameRing:
    """The most recent frames of a renderer, filled by a thread, so that training may visit a frame more than once.

    A batch takes 1/`visits` of its frames from those never seen, as long as there are any, and the others at random
    from the ring; of two at random the one that cost more when it was last visited, if hard frames are asked for, which
    doubles the hardest. The renderer waits (its pipe fills) when `ahead` frames are unseen, and is started again where it
    stopped if it ends. The first batch waits for `minimum` frames.
    """

    def __init__(self, command: str, seed: int, capacity: int = 4000, visits: float = 2.0, ahead: int = 128, rng_seed: int = 0, minimum: int = 1):
        self.command, self.next_seed, self.capacity, self.visits = command, seed, capacity, max(1.0, visits)
        self.minimum = min(minimum, capacity)
        self.ahead = min(max(ahead, self.minimum), capacity)
        self.random = random.Random(rng_seed)
        self.filled = self.received = 0
        self.metas: list[dict] = []
        self.costs = np.zeros(capacity, np.float32)  # of each frame when it was last visited; 0: not known
        self.unseen: deque[int] = deque()
        self.owed = 0.0  # fresh frames that a batch should have had but did not take as whole frames
        self.error: StreamError | None = None
        self.stopping = False
        self.changed = threading.Condition()
        self.renderer = Renderer(command, seed)
        self.format = fmt = self.renderer.format
        self.rgb = np.empty((capacity, fmt.h, fmt.w, 3), np.uint8)
        self.labels = np.empty((capacity, fmt.channels, fmt.lh, fmt.lw), np.uint8)
        self.thread = threading.Thread(target=self._fill, daemon=True)
        self.thread.start()

    def _fill(self) -> None:
        rgb = np.empty_like(self.rgb[0])
        labels = np.empty_like(self.labels[0])
        failures = 0
        while not self.stopping:
            try:
                frame = self.renderer.read(rgb, labels)
                if frame is None:
                    raise StreamError(f"the stream ended ({self.renderer.ending()})")
                failures = 0
                self._keep(frame)
            except (StreamError, ValueError) as wrong:  # ValueError: the pipe was closed by close()
                if self.stopping:
                    return
                failures += 1
                print(f"stream: {wrong}; starting the renderer again at seed {self.next_seed}", file=sys.stderr, flush=True)
                try:
                    if failures > 5:
                        raise StreamError(f"no frame after {failures - 1} attempts; the last: {wrong}")
                    self.renderer = Renderer(self.command, self.next_seed)
                    if self.renderer.format != self.format:
                        raise StreamError(f"the renderer changed its format from {self.format} to {self.renderer.format}")
                except StreamError as fatal:
                    with self.changed:
                        self.error = fatal
                        self.changed.notify_all()
                    return

    def _keep(self, frame: Frame) -> None:
        with self.changed:
            while len(self.unseen) >= self.ahead and not self.stopping:
                self.changed.wait(1.0)
            slot = self.received % self.capacity
            self.rgb[slot], self.labels[slot] = frame.rgb, frame.labels
            if slot < len(self.metas):
                self.metas[slot] = frame.meta
            else:
                self.metas.append(frame.meta)
            self.costs[slot] = 0
            self.unseen.append(slot)
            self.received += 1
            self.filled = len(self.metas)
            self.next_seed = frame.seed + 1
            self.changed.notify_all()

    def batch(self, size: int, hard: bool = False) -> Batch:
        with self.changed:
            while self.filled < self.minimum and not self.error:
                self.changed.wait(1.0)
            if self.error:
                raise self.error
            self.owed += size / self.visits
            fresh = min(int(self.owed), len(self.unseen), size)
            self.owed = min(self.owed - fresh, float(size))
            slots = [self.unseen.popleft() for _ in range(fresh)]
            slots += [max((self.random.randrange(self.filled) for _ in range(1 + hard)), key=self.costs.__getitem__) for _ in range(size - fresh)]
            self.changed.notify_all()
            return Batch(self.rgb[slots], self.labels[slots], [self.metas[slot] for slot in slots], slots)

    def judge(self, slots: list[int], costs: np.ndarray) -> None:
        """What frames of a batch cost."""
        with self.changed:
            self.costs[slots] = costs

    def close(self) -> None:
        self.stopping = True
        with self.changed:
            self.changed.notify_all()
        self.renderer.process.terminate()
        self.thread.join(timeout=5)
        self.renderer.close()

    def __enter__(self) -> "FrameRing":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
