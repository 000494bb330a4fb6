"""A short training on 64 crude frames that must make its loss smaller; prints how many checks passed.

    python smoke.py [--render COMMAND]

It shows that stream, networks, losses, checkpoints, scores and export work together. It does not show that anything useful is learned.
"""

import argparse
import contextlib
import io
import math
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

import checkpoint
import export
import models
import train
from ring import Batch
from stream import FAKE_COMMAND, frames

FRAMES = 64
STEPS = 56
LOSS_SHARE = 0.5  # the last steps' loss must be below this share of the first's
SIDE_STEPS = 48
SIDE_SHARE = 0.8


class FixedFrames:
    """Stands in for the ring: the same frames over and over, in a fixed order."""

    def __init__(self, command: str):
        self.all = list(frames(command, 0, FRAMES))
        self.received, self.next_seeds, self.at = FRAMES, [FRAMES], 0
        self.costs = np.full(FRAMES, np.nan)

    def batch(self, size: int, hard: bool = False) -> Batch:
        slots = [(self.at + i) % FRAMES for i in range(size)]
        self.at += size
        part = [self.all[slot] for slot in slots]
        return Batch(*train.stacked(part, torch.device("cpu")), [f.meta for f in part], slots)

    def judge(self, slots: list[int], costs: np.ndarray) -> None:
        self.costs[slots] = costs


def loss_shares(name: str, steps: int, data: FixedFrames, run: Path, **changes: object) -> tuple[float, train.Trainer]:
    options = train.parse(["--run", str(run), "--minutes", "5", "--net", name, "--device", "cpu", "--fake"])
    vars(options).update(changes)
    trainer = train.Trainer(options)
    losses = [trainer.one_step(data, 0.0) for _ in range(steps)]
    return float(np.mean(losses[-4:]) / np.mean(losses[:2])), trainer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--render", default=FAKE_COMMAND)
    data = FixedFrames(parser.parse_args().render)
    checks: list[tuple[str, bool]] = []
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "boxnet")
        share, trainer = loss_shares("boxnet", STEPS, data, run, half_share=1.0)
        checks.append((f"boxnet: loss fell to {share:.2f} of its start (limit {LOSS_SHARE})", share < LOSS_SHARE))
        trainer.save(data)
        again = train.Trainer(trainer.options)
        same = all(torch.equal(a, b) for a, b in zip(trainer.model.state_dict().values(), again.model.state_dict().values()))
        checks.append(("boxnet: a second trainer goes on from the checkpoint", same and again.step == STEPS))
        at = data.at
        first = trainer.one_step(data, 0.0)
        data.at = at
        checks.append(("boxnet: the next step is the same after resuming", math.isclose(first, again.one_step(data, 0.0), rel_tol=1e-4)))
        trainer.one_step(data, trainer.options.hard_from)
        judged = np.isfinite(data.costs).sum()
        checks.append((f"boxnet: late in a sitting {judged} frames are judged", judged == trainer.options.batch))
        scores = train.validate(trainer.ema, trainer.task, data.all[:8], trainer.device)
        checks.append(("boxnet: scores are numbers", np.isfinite(scores["loss"]) and 0 <= scores["laser_f"] <= 1))
        model = models.named("boxnet")
        model.load_state_dict(checkpoint.load_newest(run)["ema"])
        with contextlib.redirect_stdout(io.StringIO()):
            difference = export.export(model, Path(folder, "boxnet.onnx"))
        checks.append((f"boxnet: ONNX Runtime within {difference:.1e} of torch", difference < export.LARGEST_DIFFERENCE))
        share, _ = loss_shares("ihed8", SIDE_STEPS, data, Path(folder, "ihed8"), half_share=1.0, norm=True, lr=5e-3)
        checks.append((f"ihed8 with normalisation: loss fell to {share:.2f} of its start (limit {SIDE_SHARE})", share < SIDE_SHARE))
    for text, passed in checks:
        print("ok  " if passed else "FAIL", text)
    failed = sum(not passed for _, passed in checks)
    print(f"{time.monotonic() - started:.0f} s")
    print(f"{len(checks) - failed} passed, {failed} failed")
    raise SystemExit(failed > 0)


if __name__ == "__main__":
    main()
