"""The frame stream: what is read back, and what a damaged stream says. Needs numpy only."""

import io
import sys

import numpy as np
import pytest

np = pytest.importorskip("numpy")

import fake
import stream
from stream import Format, Frame, StreamError

SMALL = Format(64, 48, 32, 24, 9)
SMALL_FAKE = stream.FAKE_COMMAND + " --size 64x48"


def encoded(count: int = 2) -> bytes:
    out = io.BytesIO()
    out.write(SMALL.header())
    for seed in range(count):
        stream.write_frame(out, fake.scene(seed, SMALL))
    return out.getvalue()


def read_all(data: bytes) -> list[Frame]:
    file = io.BufferedReader(io.BytesIO(data))
    fmt = stream.read_header(file)
    assert fmt == SMALL
    found = []
    while (frame := stream.read_frame(file, fmt)) is not None:
        found.append(frame)
    return found


def test_frames_come_back_as_written():
    first, second = read_all(encoded())
    original = fake.scene(1, SMALL)
    assert (first.seed, second.seed) == (0, 1)
    assert second.meta == original.meta and len(second.meta["contrast"]) == 4
    assert np.array_equal(second.rgb, original.rgb) and np.array_equal(second.labels, original.labels)


def test_header_of_any_length_is_read():
    header = b'{"format":"boxline-stream/1","w":64,"h":48,"lw":32,"lh":24,"channels":9}\n'
    assert stream.read_header(io.BytesIO(header)) == SMALL


@pytest.mark.parametrize(
    ("cut", "said"),
    [(5, "frame's head"), (30, "meta data of frame 0"), (500, "image of frame 0"), (12000, "labels of frame 0")],
)
def test_a_cut_is_named(cut, said):
    with pytest.raises(StreamError, match=said):
        read_all(encoded()[: len(SMALL.header()) + cut])


def test_a_cut_between_parts_is_not_an_end():
    data = encoded(1)
    with pytest.raises(StreamError, match="cut off before the labels of frame 0"):
        read_all(data[: -SMALL.channels * SMALL.lh * SMALL.lw])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "empty"),
        (b"not json\n", "does not start with a header"),
        (b'{"format":"boxline-stream/9"}\n', "not boxline-stream/1"),
        (b'{"format":"boxline-stream/1","w":64}\n', "lacks a size"),
        (b'{"format":"boxline-stream/1","w":0,"h":48,"lw":32,"lh":24,"channels":9}\n', "impossible size"),
    ],
)
def test_a_wrong_header_is_named(data, said):
    with pytest.raises(StreamError, match=said):
        stream.read_header(io.BytesIO(data))


def test_frames_out_of_step_are_noticed():
    data = bytearray(encoded(1))
    data[len(SMALL.header()) + 8 : len(SMALL.header()) + 12] = b"\xff\xff\xff\x7f"
    with pytest.raises(StreamError, match="out of step"):
        read_all(bytes(data))


def test_labels_lie_where_the_image_is():
    frame = fake.scene(3, Format(512, 384, 256, 192, 9))
    assert frame.rgb.shape == (384, 512, 3) and frame.labels.shape == (9, 192, 256)
    mask, corners = frame.labels[7] > 0, np.argwhere(frame.labels[8] > 200)
    rows, columns = np.nonzero(mask)
    assert corners[:, 0].min() - 6 <= rows.min() and rows.max() <= corners[:, 0].max() + 6
    assert corners[:, 1].min() - 6 <= columns.min() and columns.max() <= corners[:, 1].max() + 6
    lasers = frame.labels[:4].max(0) > 200
    assert mask[lasers].mean() > 0.97


def test_renderer_as_a_child_process():
    seeds = [f.seed for f in stream.frames(SMALL_FAKE, seed=5, count=3)]
    assert seeds == [5, 6, 7]


def test_a_renderer_that_fails_is_reported():
    with pytest.raises(StreamError, match="ended with code 3"):
        list(stream.frames(f"{sys.executable} -c 'raise SystemExit(3)'", 0, 1))
    with pytest.raises(StreamError, match="cannot start the renderer"):
        list(stream.frames("no-such-renderer --seed {seed}", 0, 1))
    with pytest.raises(StreamError, match="gave 2 frames, 4 were wanted"):
        list(stream.frames(SMALL_FAKE + " --frames 2", 0, 4))
