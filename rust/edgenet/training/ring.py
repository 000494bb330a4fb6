"""A ring of the most recent frames of one or several renderers, in the memory of the device that trains.

Renderer n of several begins at `first seed + n * LANE_SEEDS`, so that no two render the same frame; where each of them
stands is kept in checkpoints.
"""

import random
import sys
import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import torch

from stream import Frame, Renderer, StreamError

LANE_SEEDS = 4_000_000  # of one renderer: a day at full speed
ATTEMPTS = 5  # to start a renderer again


@dataclass
class Batch:
    rgb: torch.Tensor  # n, h, w, 3; u8, on the ring's device
    labels: torch.Tensor  # n, channels, h, w; u8, the same
    metas: list[dict] = field(default_factory=list)
    slots: list[int] = field(default_factory=list)  # their places in the ring


def lanes(seed: int, count: int, stopped_at: list[int] | None = None) -> list[int]:
    """The next seed of each renderer; `stopped_at` is where those of an earlier sitting were."""
    known = stopped_at or []
    return [*known, *(seed + n * LANE_SEEDS for n in range(len(known), count))]


class FrameRing:
    """Filled by threads, so that training may visit a frame more than once.

    A batch takes 1/`visits` of its frames from those never seen, as long as there are any, and the others at random
    from the ring; of two at random the one that cost more when it was last visited, if hard frames are asked for, which
    doubles the hardest. The renderers wait (their pipes fill) when `ahead` frames are unseen, and are started again where
    they stopped if they end. The first batch waits for `minimum` frames.
    """

    def __init__(
        self,
        command: str,
        seeds: list[int],
        capacity: int = 4000,
        visits: float = 2.0,
        ahead: int = 128,
        rng_seed: int = 0,
        minimum: int = 1,
        renderers: int = 1,
        device: torch.device | str = "cpu",
    ):
        """`seeds`: next seed of each renderer (`lanes`); those beyond `renderers` wait for a sitting with more."""
        self.command, self.next_seeds, self.capacity, self.visits = command, list(seeds), capacity, max(1.0, visits)
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
        with ThreadPoolExecutor(renderers) as pool:  # each reads its photographs before it writes
            self.renderers = list(pool.map(lambda seed: Renderer(command, seed), self.next_seeds[:renderers]))
        self.format = fmt = self.renderers[0].format
        self.rgb = torch.empty((capacity, fmt.h, fmt.w, 3), dtype=torch.uint8, device=device)
        self.labels = torch.empty((capacity, fmt.channels, fmt.lh, fmt.lw), dtype=torch.uint8, device=device)
        self.threads = [threading.Thread(target=self._fill, args=(lane,), daemon=True) for lane in range(renderers)]
        for thread in self.threads:
            thread.start()

    def _fill(self, lane: int) -> None:
        fmt = self.format
        rgb = np.empty((fmt.h, fmt.w, 3), np.uint8)
        labels = np.empty((fmt.channels, fmt.lh, fmt.lw), np.uint8)
        failures = 0
        while not self.stopping:
            try:
                frame = self.renderers[lane].read(rgb, labels)
                if frame is None:
                    raise StreamError(f"the stream ended ({self.renderers[lane].ending()})")
                failures = 0
                self._keep(lane, frame)
            except (StreamError, ValueError) as wrong:  # ValueError: the pipe was closed by close()
                if self.stopping:
                    return
                failures += 1
                print(f"stream: {wrong}; starting the renderer again at seed {self.next_seeds[lane]}", file=sys.stderr, flush=True)
                try:
                    if failures > ATTEMPTS:
                        raise StreamError(f"no frame after {failures - 1} attempts; the last: {wrong}")
                    self.renderers[lane] = Renderer(self.command, self.next_seeds[lane])
                    if self.renderers[lane].format != fmt:
                        raise StreamError(f"the renderer changed its format from {fmt} to {self.renderers[lane].format}")
                except StreamError as fatal:
                    with self.changed:
                        self.error = fatal
                        self.changed.notify_all()
                    return

    def _keep(self, lane: int, frame: Frame) -> None:
        with self.changed:
            while len(self.unseen) >= self.ahead and not self.stopping:
                self.changed.wait(1.0)
            slot = self.received % self.capacity
            self.rgb[slot].copy_(torch.from_numpy(frame.rgb))
            self.labels[slot].copy_(torch.from_numpy(frame.labels))
            if slot < len(self.metas):
                self.metas[slot] = frame.meta
            else:
                self.metas.append(frame.meta)
            self.costs[slot] = 0
            self.unseen.append(slot)
            self.received += 1
            self.filled = len(self.metas)
            self.next_seeds[lane] = frame.seed + 1
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
            index = torch.tensor(slots, device=self.rgb.device)
            return Batch(self.rgb[index], self.labels[index], [self.metas[slot] for slot in slots], slots)

    def judge(self, slots: list[int], costs: np.ndarray) -> None:
        """What frames of a batch cost."""
        with self.changed:
            self.costs[slots] = costs

    def close(self) -> None:
        self.stopping = True
        with self.changed:
            self.changed.notify_all()
        for renderer in self.renderers:
            renderer.process.terminate()
        for thread in self.threads:
            thread.join(timeout=5)
        for renderer in self.renderers:
            renderer.close()

    def __enter__(self) -> "FrameRing":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
