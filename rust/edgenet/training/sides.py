"""Trains the network of sides: where the four sides of a face are, seen in the face's own plane.

    boxline render --stream --views --seed 1 --count 30000 --photos photos > views.bin                what it learns from
    boxline render --stream --views --held-out --seed 1099511627776 --count 800 --photos photos > held-out.bin
    python sides.py --run runs/sides --views views.bin --validation held-out.bin --visits 150000      goes on where it stopped
    python sides.py --run runs/sides --views views.bin --validation held-out.bin --begin ../models/sides.onnx     begins from that file
    python sides.py --run runs/sides --validation held-out.bin --export ../models/sides.onnx          the file, its card and check
    python sides.py --score ../models/sides.onnx --validation held-out.bin      a file's scores, asked in one way and as the program does

A view is what `boxline::sides::face_view` makes: 5 channels of 256 x 256. The network gives, for each of the four sides, the logits of
112 places (bins) and of "not in view", and the logit that something in front of the face hides a piece of it. The file with views may
still be growing. A face turned or mirrored is a face: every visit takes one of the eight ways at random, under other light and with other
paint on the face. bf16 is used where the processor has it.
"""

import argparse
import hashlib
import json
import os
import sys
import time
import warnings
from pathlib import Path

THREADS = next((sys.argv[i + 1] for i, a in enumerate(sys.argv[:-1]) if a == "--threads"), "1")
os.environ.setdefault("OMP_NUM_THREADS", THREADS)  # before numpy and torch are loaded

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import checkpoint
import programs
from export import folded
from models import ConvNorm, Residual
from train import bf16_is_fast, follow, learning_rate

CHANNELS, CELLS, BINS = 5, 256, 112
INNER = CELLS - 2 * BINS
STEP = 4  # cells of the view a step of the features
SPREAD_BINS = 0.7  # of the soft label about the true place: edges wave, crossings and planes are off by a little
NEAR_BINS = 2.0  # a place counts as right within so many bins: 2 % of the face
HIDDEN_WEIGHT = 0.3
WAYS = (0, 3, 4, 7)  # in which the program asks, of `turned`: as core/src/view.rs has them
PAINTS = 0.8  # labels and bands a visit, on the mean
WARM_UP_STEPS = 200
OPSET = 17
LARGEST_DIFFERENCE = 1e-3


class SidesNet(nn.Module):
    """A view (n, 5, 256, 256) to logits (n, 4, 1, 114).

    A residual U-Net up to a quarter of the view's size. For the sides across an axis, every column (or row) of its features is summed
    up with a weight per place that the network gives itself, and a short network along the axis looks at the sums: four places a step.
    """

    def __init__(self, stem: int = 16, widths: tuple[int, ...] = (32, 64, 96, 128), decoder: int = 32, along: int = 48):
        super().__init__()
        self.stem = ConvNorm(CHANNELS, stem, stride=2)
        stages, inputs = [], stem
        for width in widths:
            stages.append(Residual(inputs, width, stride=2))
            inputs = width
        self.stages = nn.ModuleList(stages)
        self.laterals = nn.ModuleList(ConvNorm(width, decoder, size=1) for width in widths)
        self.smooth = nn.ModuleList(ConvNorm(decoder, decoder) for _ in widths)
        self.weight = nn.Conv2d(decoder, 4, 1)  # of each place, for each side
        self.whole = nn.Linear(widths[-1], 8)  # "not in view" and "hidden", from the whole view
        self.along = nn.ModuleList(
            nn.Sequential(
                nn.Conv1d(2 * decoder, along, 5, padding=2), nn.ReLU(), nn.Conv1d(along, along, 5, padding=2), nn.ReLU(), nn.Conv1d(along, 2 * STEP, 3, padding=1)
            )
            for _ in range(2)
        )

    def forward(self, view: torch.Tensor) -> torch.Tensor:
        x = F.relu(self.stem(view * 2 - 0.5))
        features = []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        whole = self.whole(features[-1].mean((2, 3)))
        x = None
        for feature, lateral, smooth in zip(reversed(features), reversed(self.laterals), reversed(self.smooth)):
            here = lateral(feature)
            x = here if x is None else here + F.interpolate(x, scale_factor=2.0, mode="nearest")
            x = F.relu(smooth(F.relu(x)))
        weight = self.weight(x)
        sides = []
        for side in range(4):
            summed = 2 if side < 2 else 3  # sides across axis a are columns: summed over rows
            share = weight[:, side : side + 1].softmax(summed)
            mean = (x * share).sum(summed)
            most = x.amax(summed)
            told = self.along[side // 2](torch.cat([mean, most], 1))
            # Sides alternate low and high: the low one is read outwards, that is, from its end.
            place, hidden = (told[:, from_ : from_ + STEP].transpose(1, 2).flatten(1) for from_ in (0, STEP))
            if side % 2 == 0:
                place, hidden = place[:, :BINS].flip(1), hidden[:, :BINS].flip(1)
            else:
                place, hidden = place[:, BINS + INNER :], hidden[:, BINS + INNER :]
            gone = whole[:, side : side + 1]
            covered = (hidden * place.softmax(1)).sum(1, keepdim=True) + whole[:, 4 + side : 5 + side]
            sides.append(torch.cat([place, gone, covered], 1))
        return torch.stack(sides, 1)[:, :, None]


@torch.no_grad()
def begin_from(network: SidesNet, path: Path, pictures: torch.Tensor) -> None:
    """Weights of an exported file, in which every normalisation is folded into its convolution. Each gets one again that changes nothing
    on these views: it takes away what it finds there, and adds the same."""
    import onnx

    weights = {w.name: torch.from_numpy(onnx.numpy_helper.to_array(w).copy()) for w in onnx.load(path).graph.initializer}
    hooks = []

    def same_again(norm: nn.BatchNorm2d, bias: torch.Tensor):
        def hook(_, inputs):
            x = inputs[0]
            mean, variance = x.mean((0, 2, 3)), x.var((0, 2, 3), unbiased=False)
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance)
            norm.weight.copy_((variance + norm.eps).sqrt())
            norm.bias.copy_(bias + mean)

        return hook

    for name, module in network.named_modules():
        if isinstance(module, ConvNorm):
            module[0].weight.copy_(weights.pop(f"{name}.0.weight"))
            hooks.append(module[1].register_forward_pre_hook(same_again(module[1], weights.pop(f"{name}.0.bias"))))
    left = {name: value for name, value in weights.items() if name in network.state_dict()}
    network.load_state_dict(left, strict=False)
    network.train()
    network(pictures)
    for hook in hooks:
        hook.remove()


class Views:
    """Views in a file, which may still be growing."""

    def __init__(self, path: Path):
        self.path = path
        with open(path, "rb") as file:
            head = json.loads(file.read(128))
        if head.get("format") != "boxline-views/1" or [head["channels"], head["h"], head["bins"]] != [CHANNELS, CELLS, BINS]:
            raise SystemExit(f"{path}: not boxline-views/1 of {CHANNELS} x {CELLS} x {CELLS} with {BINS} bins")
        self.places: list[int] = []
        self.metas: list[dict] = []
        self.end = 128
        self.update()

    def update(self) -> None:
        """Takes up what has come since."""
        size, values = self.path.stat().st_size, CHANNELS * CELLS * CELLS
        with open(self.path, "rb") as file:
            while self.end + 12 <= size:
                file.seek(self.end + 8)
                length = int.from_bytes(file.read(4), "little")
                if self.end + 12 + length + values > size:
                    break
                self.metas.append(json.loads(file.read(length)))
                self.places.append(self.end + 12 + length)
                self.end += 12 + length + values
        self.bytes = np.memmap(self.path, np.uint8, "r")

    def __len__(self) -> int:
        return len(self.places)

    def view(self, index: int) -> np.ndarray:
        at = self.places[index]
        return self.bytes[at : at + CHANNELS * CELLS * CELLS].reshape(CHANNELS, CELLS, CELLS)

    def truth(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Bins of the four sides (nan: not in view, or within the crossings), and whether each is hidden in part."""
        bins = np.array([np.nan if b is None or b < 0 else b for b in self.metas[index]["bins"]], np.float32)
        return bins, np.array(self.metas[index]["hidden"], np.float32)


def turned(view: np.ndarray, bins: np.ndarray, hidden: np.ndarray, way: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One of the eight ways in which a face can be turned and mirrored."""
    order = [0, 1, 2, 3]
    if way & 1:
        view, order = view[:, :, ::-1], [order[1], order[0], order[2], order[3]]
    if way & 2:
        view, order = view[:, ::-1], [order[0], order[1], order[3], order[2]]
    if way & 4:
        view, order = view.transpose(0, 2, 1)[[0, 1, 2, 4, 3]], [order[2], order[3], order[0], order[1]]
    return view, bins[order], hidden[order]


def labels(bins: torch.Tensor) -> torch.Tensor:
    """Soft labels (n, 4, 113) of places."""
    at = torch.arange(BINS) + 0.5
    near = torch.exp(-0.5 * ((at - torch.nan_to_num(bins, nan=-99.0)[..., None]) / SPREAD_BINS) ** 2)
    gone = torch.isnan(bins)[..., None].float()
    label = torch.cat([near * (1 - gone), gone], -1)
    return label / label.sum(-1, keepdim=True).clamp_min(1e-6)


def loss_of(told: torch.Tensor, bins: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
    told = told[:, :, 0]
    place = -(labels(bins) * told[..., : BINS + 1].log_softmax(-1)).sum(-1).mean()
    return place + HIDDEN_WEIGHT * F.binary_cross_entropy_with_logits(told[..., BINS + 1], hidden)


def batch_of(views: Views, indices: np.ndarray, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    pictures, bins, hidden = [], [], []
    for index in indices:
        picture, b, h = turned(views.view(index), *views.truth(index), int(rng.integers(8)))
        other = views.view(int(rng.integers(len(views))))
        pictures.append(painted(picture, b, other, rng))
        bins.append(b)
        hidden.append(h)
    pictures = torch.from_numpy(np.stack(pictures)).div_(255)
    return varied(pictures, rng), torch.from_numpy(np.stack(bins)), torch.from_numpy(np.stack(hidden))


def painted(view: np.ndarray, bins: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The view with labels, bands and shadows on the face that say nothing of where its sides are: each multiplies the light there, as
    paint does, so that stripes and edges stay. A label is plain or a piece of another view."""
    view = view.astype(np.float32)
    low, high = np.nan_to_num(bins[0::2], nan=BINS), np.nan_to_num(bins[1::2], nan=BINS)
    # Columns, then rows.
    first, last = (BINS - low).astype(int), (BINS + INNER + high).astype(int)
    for _ in range(rng.poisson(PAINTS)):
        size = np.maximum(((last - first) * rng.uniform(0.08, 0.8, 2)).astype(int), 2)
        if rng.random() < 0.35:  # a band from side to side
            axis = int(rng.integers(2))
            size[axis] = last[axis] - first[axis]
            size[1 - axis] = max(int(0.3 * size[1 - axis]), 2)
        at = first + (rng.random(2) * np.maximum(last - first - size + 1, 1)).astype(int)
        columns, rows = (slice(at[i], min(at[i] + size[i], CELLS)) for i in (0, 1))
        factor = np.exp(rng.normal(0, 0.35) + rng.normal(0, 0.12, (3, 1, 1))).astype(np.float32)
        if rng.random() < 0.4:
            print_ = other[:3, rows, columns].astype(np.float32)
            factor = factor * np.clip(print_ / (print_.mean() + 1), 0.25, 2.5)
        view[:3, rows, columns] *= factor
    if rng.random() < 0.3:  # a shadow with a soft edge over all of it
        angle, width = rng.uniform(0, 2 * np.pi), rng.uniform(2, 30)
        along = np.arange(CELLS, dtype=np.float32) - CELLS * rng.uniform(0.2, 0.8)
        over = np.cos(angle) * along[None] + np.sin(angle) * along[:, None]
        view[:3] *= 1 - rng.uniform(0.1, 0.5) / (1 + np.exp(-over / np.float32(width)))
    return np.minimum(view, 255, out=view)


def varied(pictures: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Under other light, with noise, a little out of focus; what is outside the picture stays 0."""
    n = len(pictures)
    rgb = pictures[:, :3]
    outside = rgb.amax(1, keepdim=True) == 0
    gain = torch.tensor(np.exp(rng.normal(0, 0.12, (n, 3, 1, 1)) + rng.normal(0, 0.2, (n, 1, 1, 1))), dtype=torch.float32)
    power = torch.tensor(np.exp(rng.normal(0, 0.12, (n, 1, 1, 1))), dtype=torch.float32)
    noise = torch.randn_like(rgb) * torch.tensor(0.02 * rng.random((n, 1, 1, 1)), dtype=torch.float32)
    new = ((rgb.clamp_min(1e-4) ** power) * gain + noise).clamp(0, 1)
    if rng.random() < 0.2:
        new = 0.5 * new + 0.5 * F.avg_pool2d(new, 3, 1, 1)
    pictures[:, :3] = torch.where(outside, 0.0, new)
    return pictures


@torch.no_grad()
def told_by(network: nn.Module, views: Views) -> torch.Tensor:
    network.eval()
    parts = []
    for first in range(0, len(views), 16):
        pictures = np.stack([views.view(i) for i in range(first, min(first + 16, len(views)))])
        parts.append(network(torch.from_numpy(pictures).float().div(255).contiguous(memory_format=torch.channels_last))[:, :, 0])
    return torch.cat(parts)


def scores(told: torch.Tensor, views: Views) -> dict:
    """Loss; share of sides in view of which the likeliest place is right; of faces with four such sides, nothing hidden: the share
    that a least probability leaves and how many of them are wrong; how well hidden sides are told."""
    truths = [views.truth(i) for i in range(len(views))]
    bins, hidden = (torch.from_numpy(np.stack(part)) for part in zip(*truths))
    loss = loss_of(told[:, :, None], bins, hidden)
    places = told[..., : BINS + 1].softmax(-1)
    # What lies within NEAR_BINS of each place, together.
    window = int(NEAR_BINS)
    near = F.avg_pool1d(places[..., :BINS], 2 * window + 1, 1, window, count_include_pad=True) * (2 * window + 1)
    sure, best = near.max(-1)
    seen = ~torch.isnan(bins)
    right = ((best + 0.5 - torch.nan_to_num(bins)).abs() <= NEAR_BINS) & seen
    whole = seen.all(1) & (hidden.sum(1) == 0)
    face_sure, face_right = sure.prod(1)[whole], right.all(1)[whole]
    kept = {}
    for least in (0.5, 0.8, 0.9, 0.95, 0.98, 0.99):
        chosen = face_sure >= least
        kept[str(least)] = [round(float(chosen.float().mean()), 3), int((chosen & ~face_right).sum())]
    covered = told[..., BINS + 1].sigmoid().amax(1)
    is_covered = hidden.sum(1) > 0
    at = covered[whole].sort().values
    limit = float(at[int(0.98 * (len(at) - 1))]) if len(at) else 1.0
    return {
        "faces": len(views),
        "whole faces": int(whole.sum()),
        "loss": round(float(loss), 4),
        "sides right": round(float(right[seen].float().mean()), 4),
        "bins off, rms of right": round(float(((best + 0.5 - bins)[right] ** 2).mean().sqrt()), 3),
        "faces kept, of these wrong": kept,
        "hidden found where 2 % of whole faces are called hidden": round(float((covered[is_covered] > limit).float().mean()), 3) if is_covered.any() else None,
    }


def train(options: argparse.Namespace, stop) -> None:
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    views, validation = Views(options.views), Views(options.validation)
    network, averaged = SidesNet(), SidesNet()
    averaged.load_state_dict(network.state_dict())
    for model in (network, averaged):
        model.to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), lr=options.lr, weight_decay=options.decay)
    state = checkpoint.load_newest(options.run)
    step = 0
    if state:
        step = state["step"]
        network.load_state_dict(state["network"])
        averaged.load_state_dict(state["averaged"])
        optimiser.load_state_dict(state["optimiser"])
    rng = np.random.default_rng([options.seed, step])
    begun = state.get("begun") if state else None
    if options.begin and not state:
        begun = hashlib.sha256(options.begin.read_bytes()).hexdigest()
        begin_from(network, options.begin, batch_of(views, rng.integers(len(views), size=64), rng)[0])
        averaged.load_state_dict(network.state_dict())
        print(f"begun from {options.begin}: {json.dumps(scores(told_by(averaged, validation), validation))}", flush=True)
    steps = options.visits // options.batch
    fast = bf16_is_fast(torch.device("cpu"))

    def save() -> None:
        told = {"step": step, "visits": step * options.batch, "views": len(views), "lr": options.lr, "batch": options.batch, "seed": options.seed, "begun": begun}
        checkpoint.save(options.run, step, told | {"network": network.state_dict(), "averaged": averaged.state_dict(), "optimiser": optimiser.state_dict()})

    saved = reported = time.monotonic()
    losses: list[float] = []
    while step < steps and not stop.is_set():
        if step % 50 == 0:
            views.update()
        pictures, bins, hidden = batch_of(views, rng.integers(len(views), size=options.batch), rng)
        network.train()
        with torch.autocast("cpu", torch.bfloat16, enabled=fast):
            told = network(pictures.contiguous(memory_format=torch.channels_last)).float()
        loss = loss_of(told, bins, hidden)
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(options.lr, step, step / steps, WARM_UP_STEPS)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        step += 1
        follow(averaged, network, step)
        losses.append(loss.item())
        now = time.monotonic()
        if now - reported > 20:
            speed = len(losses) * options.batch / (now - reported)
            print(f"step {step} of {steps}: loss {sum(losses) / len(losses):.4f}, {speed:.1f} views/s, {len(views)} views, {(steps - step) * options.batch / speed / 60:.0f} min left", flush=True)
            losses, reported = [], now
        if now - saved > options.checkpoint_minutes * 60:
            save()
            print(f"validation {json.dumps(scores(told_by(averaged, validation), validation))}", flush=True)
            saved = reported = time.monotonic()
    save()
    print(f"validation {json.dumps(scores(told_by(averaged, validation), validation))}", flush=True)


def told_in_ways(path: Path, views: Views, ways: tuple[int, ...]) -> torch.Tensor:
    """What a file says of each view, asked in several of the eight ways: geometric means of probabilities and odds, as in core/src/view.rs."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    all_views = []
    for index in range(len(views)):
        of_ways = []
        for way in ways:
            view, order, _ = turned(views.view(index), np.arange(4), np.arange(4), way)
            told = session.run(None, {"view": np.ascontiguousarray(view, np.float32)[None] / np.float32(255)})[0][0, :, 0]
            back = np.empty_like(told)
            back[order] = told  # row k is of side order[k]
            of_ways.append(torch.from_numpy(back))
        told = torch.stack(of_ways)
        places = told[..., : BINS + 1].log_softmax(-1).mean(0)
        all_views.append(torch.cat([places, told[..., BINS + 1 :].mean(0)], -1))
    return torch.stack(all_views)


def check_view() -> torch.Tensor:
    """A made-up view in whole numbers, the same as in ../tests/lines_and_sides.rs."""
    c, row, column = np.meshgrid(np.arange(CHANNELS), np.arange(CELLS), np.arange(CELLS), indexing="ij")
    inside = (column >= 70) & (column < 190) & (row >= 90) & (row < 170)
    levels = np.where(inside, 150 - 30 * c, 60 + 10 * c) + (c * 29 + row * 13 + column * 7 + (row * column) % 31) % 23
    return torch.tensor(levels / 255, dtype=torch.float32)[None]


def export(options: argparse.Namespace) -> None:
    """Writes the file, its card and what the Rust tests compare with."""
    import onnxruntime

    state, validation = checkpoint.load_newest(options.run), Views(options.validation)
    if state is None:
        raise SystemExit(f"there is no checkpoint in {options.run}")
    network = SidesNet()
    network.load_state_dict(state["averaged"])
    network.eval()
    told = scores(told_by(network, validation), validation)
    view = check_view()
    with torch.no_grad():
        due = network(view).numpy()
    network = folded(network).to(memory_format=torch.contiguous_format)
    path = options.export
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(network, view, path, input_names=["view"], output_names=["sides"], opset_version=OPSET, dynamo=False)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    difference = float(np.abs(session.run(None, {"view": view.numpy()})[0] - due).max())
    if difference > LARGEST_DIFFERENCE:
        raise SystemExit(f"the file differs from torch by {difference:.2g}")
    path.with_suffix(".check.json").write_text(json.dumps([round(float(v), 4) for v in due.flatten()]) + "\n")
    content = path.read_bytes()
    path.with_suffix(".md").write_text(f"""# {path.stem}

- File: {path.name}, {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}
- Data: {state["views"]} views, `boxline render --stream --views`; training: {state["visits"]} visits, batches of {state["batch"]}, peak learning rate {state["lr"]}, seed {state["seed"]} (`training/sides.py`)
- Begun from: {f"the file with sha256 {state['begun']}" if state.get("begun") else "nothing"}
- Largest difference between this file in ONNX Runtime and torch: {difference:.2g}
- Licence: Apache-2.0, as the repository.
- Not shown by these numbers: anything about real photographs.

## Validation: held-out materials, other scenes

A place is right within {NEAR_BINS:g} bins, some 2 % of the face.

```json
{json.dumps(told, indent=1)}
```
""")
    print(path.with_suffix(".md").read_text())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, help="folder for checkpoints")
    parser.add_argument("--views", type=Path, help="what to learn from")
    parser.add_argument("--validation", type=Path, required=True, help="held-out views")
    parser.add_argument("--export", type=Path, help="write this ONNX file instead of training")
    parser.add_argument("--score", type=Path, help="print the scores of this ONNX file instead of training")
    parser.add_argument("--begin", type=Path, help="begin from the weights of this ONNX file, if there is no checkpoint")
    parser.add_argument("--visits", type=int, default=150_000)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--lr", type=float, default=2e-3)
    parser.add_argument("--decay", type=float, default=0.02)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--checkpoint-minutes", type=float, default=6)
    options = parser.parse_args()
    if options.score:
        views = Views(options.validation)
        for ways in ((0,), WAYS):
            print(f"asked in {len(ways)} ways: {json.dumps(scores(told_in_ways(options.score, views, ways), views))}")
        return
    if not options.run:
        parser.error("--run or --score is needed")
    if options.export:
        export(options)
    elif options.views:
        train(options, programs.stop_on_signals())
    else:
        parser.error("--views or --export is needed")


if __name__ == "__main__":
    main()
