"""The ring of frames. Needs torch."""

import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ring as ring_module
from ring import FrameRing, lanes
from stream import FAKE_COMMAND, Format, StreamError

SMALL = Format(64, 48, 32, 24, 9)
SMALL_FAKE = FAKE_COMMAND + " --size 64x48"


def test_the_ring_keeps_recent_frames_and_visits_them_again():
    with FrameRing(SMALL_FAKE, [0], capacity=16, visits=2, ahead=4) as ring:
        batches = [ring.batch(4) for _ in range(40)]
        assert all(b.rgb.shape == (4, 48, 64, 3) and b.labels.shape == (4, 9, 24, 32) for b in batches)
        assert all(len(b.metas) == 4 for b in batches)
        assert ring.filled <= 16
        assert ring.received <= 40 * 4 / 2 + 4 + 4  # half of what was asked for, and those ahead
        assert ring.next_seeds == [ring.received]


def test_hard_frames_come_about_twice_as_often():
    with FrameRing(SMALL_FAKE, [0], capacity=16, visits=1e9, ahead=16, minimum=16) as ring:
        ring.batch(1)  # waits until it is full
        ring.judge(list(range(16)), np.arange(16))
        drawn = np.bincount([s for _ in range(500) for s in ring.batch(8, hard=True).slots], minlength=16)
        even = np.bincount([s for _ in range(500) for s in ring.batch(8).slots], minlength=16)
        assert 1.7 < drawn[15] / even.mean() < 2.2 and drawn[0] < 0.3 * even.mean()


def test_the_ring_starts_a_finished_renderer_again():
    with FrameRing(SMALL_FAKE + " --frames 5", [0], capacity=64, visits=1, ahead=8) as ring:
        for _ in range(8):
            ring.batch(3)
        while ring.received < 12 and not ring.error:
            ring.batch(1)
        assert ring.error is None and ring.next_seeds[0] >= 12


def test_the_ring_gives_up_on_a_broken_renderer(tmp_path):
    header = tmp_path / "header"
    header.write_bytes(SMALL.header())
    with FrameRing(f"cat {header}", [0], capacity=8) as ring:
        with pytest.raises(StreamError, match="no frame after 5 attempts"):
            ring.batch(2)


def test_several_renderers_fill_one_ring_with_seeds_of_their_own(monkeypatch):
    monkeypatch.setattr(ring_module, "LANE_SEEDS", 1000)
    with FrameRing(SMALL_FAKE, lanes(7, 3), capacity=64, visits=1, ahead=16, renderers=3) as ring:
        while min(after - first for after, first in zip(ring.next_seeds, (7, 1007, 2007))) < 3:
            ring.batch(4)
        counts = [after - first for after, first in zip(ring.next_seeds, (7, 1007, 2007))]
        assert sum(counts) <= ring.received <= sum(counts) + 3  # one may be about to be counted
    # A sitting with fewer renderers keeps where the others stopped, one with more adds new ones.
    assert lanes(7, 1, [20, 1030, 2010]) == [20, 1030, 2010]
    assert lanes(7, 4, [20, 1030]) == [20, 1030, 2007, 3007]
    with FrameRing(SMALL_FAKE, [20, 1030], capacity=8) as ring:
        ring.batch(1)
        assert len(ring.renderers) == 1 and ring.next_seeds[0] > 20 and ring.next_seeds[1] == 1030
