"""Trains the network of lines: which of the straight lines that may be a side of the face is one.

    python lines_data.py --run runs/lines --photos photos --faces 10000            its data, of which no face is in two splits
    python lines.py --run runs/lines --output ../models/lines.onnx                  goes on after the last whole epoch

A record is what `boxline::network::LineStrip` says; `../examples/line_strips.rs` writes them. The loss is the logarithm of the
probability of a side's right lines (within 10 px of the true one, or inside it by the radius of the rounded edge) among all lines of
that side. Beside the file go its card (.md) and, as .check.json, torch's outputs on made-up strips for the Rust tests.
"""

import argparse
import hashlib
import json
import time
import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

import checkpoint

CHANNELS, ROWS, COLUMNS = 3, 64, 64
PICTURE_ROWS, MAP_ROWS = 45, 18  # the last row has the facts
HEAD = 7  # numbers before the bytes of a record
RECORD = 4 * HEAD + CHANNELS * (ROWS - 1) * COLUMNS
RIGHT_PX = 10.0
OPSET = 17
LARGEST_DIFFERENCE = 1e-4


class Lines(nn.Module):
    """A strip (n, 3, 64, 64) to the logarithm of the line's odds (n, 1, 1, 1)."""

    def __init__(self, width: int = 24, dropout: float = 0.3):
        super().__init__()
        # The first layer sees all rows at once: where across the line something is counts, where along it does not.
        self.rows = nn.Conv1d(CHANNELS * (ROWS - 1), width, 3, padding=1)
        self.along = nn.ModuleList(nn.Conv1d(width, width, 3, 2, 1) for _ in range(3))
        self.joined = nn.Linear(width * COLUMNS // 8 + CHANNELS, 16)
        self.told = nn.Linear(16, 1)
        self.known = nn.Parameter(torch.tensor(0.8))
        self.dropout = nn.Dropout(dropout)

    def forward(self, strip: torch.Tensor) -> torch.Tensor:
        picture = strip[:, :, :PICTURE_ROWS]
        # Brightness and contrast of the scene tell nothing.
        mean = picture.mean((1, 2, 3), keepdim=True)
        spread = ((picture - mean) ** 2).mean((1, 2, 3), keepdim=True).sqrt()
        maps = strip[:, :, PICTURE_ROWS : PICTURE_ROWS + MAP_ROWS] * 2 - 0.2
        x = torch.cat([(picture - mean) / (spread + 0.03), maps], 2).flatten(1, 2)
        x = self.dropout(torch.relu(self.rows(x)))
        for i, layer in enumerate(self.along):
            x = torch.relu(layer(x))
            x = self.dropout(x) if i == 0 else x
        log_odds, strength, away = strip[:, :, ROWS - 1, 0].unbind(1)
        facts = torch.stack([log_odds * 4, strength * 2 - 1, torch.clamp(away.abs() * 3, 0, 3)], 1)
        x = torch.relu(self.joined(torch.cat([self.dropout(x.flatten(1)), facts], 1)))
        told = self.told(x)[:, 0] + self.known * 16 * log_odds
        return told[:, None, None, None]


class Sides:
    """The lines of all sides: strips as bytes, facts, which are right, and where each side begins."""

    def __init__(self, folders: list[Path]):
        files = sorted(f for folder in folders for f in folder.glob("*.strips"))
        # Some gigabytes: they are held once.
        room = sum(file.stat().st_size // RECORD for file in files)
        strips = np.empty((room, CHANNELS, ROWS - 1, COLUMNS), np.uint8)
        heads, begins = [], [0]
        self.faces = []  # first of a face's four sides
        for file in files:
            records = np.fromfile(file, np.uint8)
            if len(records) == 0 or len(records) % RECORD:
                continue
            records = records.reshape(-1, RECORD)
            head = records[:, : 4 * HEAD].copy().view("<f4")
            sides = [head[:, 0] == side for side in range(4)]
            if not all(side.any() for side in sides):
                continue
            self.faces.append(len(begins) - 1)
            for side in sides:
                first, after = begins[-1], begins[-1] + int(side.sum())
                strips[first:after] = records[side, 4 * HEAD :].reshape(-1, CHANNELS, ROWS - 1, COLUMNS)
                heads.append(head[side])
                begins.append(after)
        if not heads:
            raise SystemExit(f"no strips in {', '.join(map(str, folders))}")
        self.strips, self.heads, self.begins = strips[: begins[-1]], np.concatenate(heads), np.array(begins)
        off, radius = self.heads[:, 1], self.heads[:, 2]
        self.right = torch.tensor((off >= -(RIGHT_PX + radius)) & (off <= RIGHT_PX))

    def lines(self, sides) -> tuple[np.ndarray, torch.Tensor]:
        """The lines of these sides, and to which of them each belongs."""
        counts = [self.begins[s + 1] - self.begins[s] for s in sides]
        index = np.concatenate([np.arange(self.begins[s], self.begins[s + 1]) for s in sides])
        return index, torch.tensor(np.repeat(np.arange(len(counts)), counts))

    def images(self, index) -> torch.Tensor:
        """The network's input."""
        strips = torch.as_tensor(self.strips[index]).float() / 255
        facts = torch.as_tensor(self.heads[index, 4:7])[:, :, None, None].expand(-1, -1, 1, COLUMNS)
        return torch.cat([strips, facts], 2)


def log_probability(told: torch.Tensor, right: torch.Tensor, side: torch.Tensor, sides: int) -> torch.Tensor:
    """Logarithm of the probability of each side's right lines."""
    most = torch.full((sides,), -1e9).scatter_reduce(0, side, told, "amax")
    weight = torch.exp(told - most[side])
    total = torch.zeros(sides).index_add(0, side, weight)
    rightly = torch.zeros(sides).index_add(0, side, weight * right)
    return torch.log(rightly + 1e-6) - torch.log(total)


def varied(images: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Mirrored, under other light, with noise."""
    images = images.flip(3) if rng.random() < 0.5 else images.clone()
    n = len(images)
    gain = torch.tensor(np.exp(rng.normal(0, 0.25, (n, CHANNELS, 1, 1))), dtype=torch.float32)
    offset = torch.tensor(rng.normal(0, 0.05, (n, CHANNELS, 1, 1)), dtype=torch.float32)
    picture = images[:, :, :PICTURE_ROWS]
    noise = torch.randn_like(picture) * 0.03 * rng.random()
    images[:, :, :PICTURE_ROWS] = picture * gain + offset + noise
    return images


def told_by(network: nn.Module, data: Sides) -> torch.Tensor:
    """The network's answers to all lines."""
    with torch.no_grad():
        parts = np.array_split(np.arange(len(data.heads)), len(data.heads) // 1000 + 1)
        return torch.cat([network(data.images(part)).flatten() for part in parts])


def scores(told: torch.Tensor, data: Sides) -> dict:
    """Loss over sides with a right line, share of faces whose likeliest lines are right, and what a least probability of the four
    leaves: the share of faces, and how many of them are wrong."""
    index, side = data.lines(range(len(data.begins) - 1))
    logs = log_probability(told[index], data.right[index], side, len(data.begins) - 1)
    known = torch.zeros(len(data.begins) - 1).index_add(0, side, data.right[index].float()) > 0
    faces = []
    for first in data.faces:
        probability, right = 1.0, True
        for s in range(first, first + 4):
            lines = slice(data.begins[s], data.begins[s + 1])
            weight = torch.softmax(told[lines].double(), 0).numpy()
            best, off = int(weight.argmax()), data.heads[lines, 1]
            probability *= weight[np.abs(off - off[best]) <= RIGHT_PX].sum()
            right &= bool(data.right[lines][best])
        faces.append((probability, right))
    probability, right = (np.array(v) for v in zip(*faces))
    kept = {str(t): [round(float((probability >= t).mean()), 3), int(((probability >= t) & ~right).sum())] for t in (0.5, 0.7, 0.8, 0.9)}
    return {
        "faces": len(faces),
        "loss": round(float(-logs[known].mean()), 4),
        "right": round(float(right.mean()), 3),
        "kept, of these wrong": kept,
    }


def train(data: Sides, validation: Sides, options: argparse.Namespace) -> Lines:
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)
    index, side = data.lines(range(len(data.begins) - 1))
    found = torch.zeros(len(data.begins) - 1).index_add(0, side, data.right[index].float()) > 0
    sides = np.nonzero(found.numpy())[0]
    network = Lines()
    optimiser = torch.optim.AdamW(network.parameters(), lr=options.lr, weight_decay=options.decay)
    steps = options.epochs * (len(sides) // options.batch + 1)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    learned = {name: getattr(options, name) for name in ("epochs", "batch", "lr", "decay", "seed")} | {"lines": len(data.heads)}
    state = checkpoint.load_newest(options.run) if options.run else None
    if state and state["learned"] != learned:
        raise SystemExit(f"lines: {options.run} was started with {state['learned']}, not {learned}")
    if state:
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.load_state_dict(state["schedule"])
        torch.set_rng_state(state["torch_rng"])
        rng, sides = state["rng"], state["sides"]
    for epoch in range(state["epoch"] if state else 0, options.epochs):
        rng.shuffle(sides)
        network.train()
        total, start = 0.0, time.monotonic()
        for first in range(0, len(sides), options.batch):
            batch = sides[first : first + options.batch]
            index, side = data.lines(batch)
            told = network(varied(data.images(index), rng)).flatten()
            loss = -log_probability(told, data.right[index], side, len(batch)).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item() * len(batch)
        network.eval()
        print(
            f"epoch {epoch + 1} of {options.epochs}: loss {total / len(sides):.4f}, {time.monotonic() - start:.0f} s;",
            f"validation {json.dumps(scores(told_by(network, validation), validation))}",
            flush=True,
        )
        if options.run:
            state = {"epoch": epoch + 1, "learned": learned, "rng": rng, "sides": sides, "torch_rng": torch.get_rng_state()}
            state |= {"network": network.state_dict(), "optimiser": optimiser.state_dict(), "schedule": schedule.state_dict()}
            checkpoint.save(options.run, epoch + 1, state)
    return network.eval()


def check_strips() -> torch.Tensor:
    """Made-up strips in whole numbers, the same as in ../tests/lines_and_sides.rs."""
    n, c, row, column = np.meshgrid(np.arange(3), np.arange(CHANNELS), np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    levels = (n * 41 + c * 29 + row * 13 + column * 7 + (row * column) % 31) % 256
    return torch.tensor(levels / 255, dtype=torch.float32)


def export(network: Lines, path: Path) -> float:
    """Writes the file and what the Rust tests compare with; the largest difference to torch."""
    strips = check_strips()
    with torch.no_grad():
        told = network(strips).flatten().numpy()
    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(network, strips[:1], path, input_names=["strip"], output_names=["log_odds"], opset_version=OPSET, dynamo=False)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    again = [session.run(None, {"strip": strip[None].numpy()})[0].item() for strip in strips]
    difference = float(np.abs(np.array(again) - told).max())
    if difference > LARGEST_DIFFERENCE:
        raise SystemExit(f"the file differs from torch by {difference:.2g}")
    path.with_suffix(".check.json").write_text(json.dumps([round(float(v), 5) for v in told]) + "\n")
    return difference


def card(path: Path, options: argparse.Namespace, data: Sides, network: dict, without: dict, difference: float) -> str:
    content = path.read_bytes()
    return f"""# lines

- File: {path.name}, {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}
- Data: {len(data.faces)} faces, {len(data.begins) - 1} sides, {len(data.heads)} lines; made by `training/lines_data.py`
- Training: {options.epochs} epochs, batches of {options.batch} sides, peak learning rate {options.lr}, weight decay {options.decay}, seed {options.seed}
- Largest difference between this file in ONNX Runtime and torch: {difference:.2g}
- Licence: Apache-2.0, as the repository.
- Not shown by these numbers: anything about real photographs.

## Validation: other boxes than those learned from

*right*: share of faces whose four likeliest lines are right. *kept*: share of faces whose lines are that likely together, and how many
of those are wrong.

```json
{json.dumps({"with the network": network, "without": without}, indent=1)}
```
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, required=True, help="folder of lines_data.py: strips in learn/ and choose/; checkpoints go there")
    parser.add_argument("--output", type=Path, required=True, help="the ONNX file")
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--batch", type=int, default=48, help="sides")
    parser.add_argument("--lr", type=float, default=2e-3)
    parser.add_argument("--decay", type=float, default=0.05)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    data, validation = Sides([options.run / "learn"]), Sides([options.run / "choose"])
    print(f"{len(data.faces)} faces with {len(data.heads)} lines, {len(validation.faces)} to validate", flush=True)
    network = train(data, validation, options)
    difference = export(network, options.output)
    without = scores(torch.tensor(validation.heads[:, 3]), validation)
    text = card(options.output, options, data, scores(told_by(network, validation), validation), without, difference)
    options.output.with_suffix(".md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
