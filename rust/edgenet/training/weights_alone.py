"""Fits how much the evidence for a line counts where no network is: CLUE_WEIGHTS_ALONE and SURE_ALONE.

    cargo run --release -p boxline-edgenet --example side_evidence -- --without-network learn > learn.csv     (recordings with truth)
    cargo run --release -p boxline-edgenet --example side_evidence -- --without-network choose > choose.csv
    python weights_alone.py --learn learn.csv --choose choose.csv

As `weights.py`: a side's right lines against its other lines, a conditional logit by maximum likelihood; then how sure the likeliest is.
Prints the weights for `rust/core/src/rectangle/line_evidence.rs` and `outlines.rs`, and what a least probability of all four sides leaves.
"""

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch

from weights import LEAST_LEFT, MOST_ODDS, RIGHT_MM, RIGHT_PX, SAME_SIDE_PX

CLUES = [f"clue_{i}" for i in range(11)]  # in the order of CLUE_WEIGHTS_ALONE
LIGHT = (-0.043, -0.312)  # light_on_one and light_missing of line_evidence.rs
RIDGE = 1e-3  # keeps weights of what is never seen at zero


class Side:
    def __init__(self, lines: list[dict]) -> None:
        column = lambda name: np.array([float(line[name]) for line in lines])
        self.clues = torch.tensor(np.stack([column(name) for name in CLUES], 1))
        self.light = torch.tensor(LIGHT[0] * (column("beyond_most") - column("beyond_least")) + LIGHT[1] * column("missing"))
        self.mm_per_px, radius_mm = float(lines[0]["mm_per_px"]), float(lines[0]["radius_mm"])
        self.off_px = column("off_px")
        reach = RIGHT_PX + radius_mm / self.mm_per_px
        self.right = torch.tensor((self.off_px >= -reach) & (self.off_px <= RIGHT_PX))
        self.measured_off_mm = float(lines[0]["measured_off_mm"])
        self.right_mm = (self.off_px * self.mm_per_px >= -(RIGHT_MM + radius_mm)) & (self.off_px * self.mm_per_px <= RIGHT_MM)


def read(path: Path) -> dict:
    sides = defaultdict(list)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            if row["refuse"] == "0":
                sides[row["recording"], row["frame"], row["side"]].append(row)
    return {key: Side(lines) for key, lines in sides.items()}


def minimise(loss, size: int) -> torch.Tensor:
    weights = torch.zeros(size, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        value = loss(weights)
        value.backward()
        return value

    optimiser.step(closure)
    return weights.detach()


def told(sides: dict) -> torch.Tensor:
    data = [side for side in sides.values() if side.right.any()]

    def loss(w: torch.Tensor) -> torch.Tensor:
        scores = [(side.clues @ w + side.light, side.right) for side in data]
        return -torch.stack([torch.logsumexp(s[right], 0) - torch.logsumexp(s, 0) for s, right in scores]).mean() + RIDGE * (w * w).sum()

    return minimise(loss, len(CLUES))


def judged(side: Side, w: torch.Tensor) -> tuple[list[float], float]:
    """What SURE_ALONE weighs for the likeliest line, and whether that is right."""
    without_light, score = side.clues @ w, side.clues @ w + side.light
    best = int(score.argmax())
    near = np.abs(side.off_px - side.off_px[best]) <= SAME_SIDE_PX
    p = torch.softmax(without_light, 0).numpy()[near].sum()
    left = 1 - torch.softmax(score, 0).numpy()[near].sum()
    odds = float(np.clip(p / max(1 - p, 1e-12), 1 / MOST_ODDS[0], MOST_ODDS[0]))
    off = side.measured_off_mm
    right = bool(side.right[best]) or (bool(side.right_mm[best]) if np.isnan(off) else abs(off) <= RIGHT_MM)
    return [1.0, np.log(odds), 0.0, np.log(side.mm_per_px), float(side.light[best]), np.log(max(left, LEAST_LEFT))], float(right)


def sure(sides: dict, w: torch.Tensor) -> torch.Tensor:
    x, y = zip(*(judged(side, w) for side in sides.values()))
    x, y = torch.tensor(np.array(x)), torch.tensor(np.array(y))
    return minimise(lambda v: torch.nn.functional.binary_cross_entropy_with_logits(x @ v, y) + RIDGE * (v * v).sum(), 6)


def score(sides: dict, w: torch.Tensor, v: torch.Tensor) -> str:
    faces = defaultdict(lambda: [1.0, True, 0])
    for (recording, frame, _), side in sides.items():
        x, right = judged(side, w)
        face = faces[recording, frame]
        face[0] *= 1 / (1 + np.exp(-float(np.dot(x, v.numpy()))))
        face[1] &= bool(right)
        face[2] += 1
    found = np.array([(p, r) for p, r, n in faces.values() if n == 4])
    kept = {least: (int((found[:, 0] >= least).sum()), int(((found[:, 0] >= least) & (found[:, 1] == 0)).sum())) for least in (0.3, 0.5, 0.8, 0.9, 0.95)}
    return f"{len(found)} faces, {found[:, 1].mean():.3f} right, mean probability {found[:, 0].mean():.3f}; kept, of these wrong: {kept}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learn", type=Path, required=True)
    parser.add_argument("--choose", type=Path, required=True)
    options = parser.parse_args()
    learn, choose = read(options.learn), read(options.choose)
    w = told(learn)
    v = sure(learn, w)
    print(f"CLUE_WEIGHTS_ALONE: {[round(float(x), 2) for x in w]}")
    print(f"SURE_ALONE, learn: {[round(float(x), 2) for x in v]}; on choose: {score(choose, w, v)}")
    both = sure(learn | choose, w)
    print(f"SURE_ALONE, both: {[round(float(x), 2) for x in both]}; on both: {score(learn | choose, w, both)}")


if __name__ == "__main__":
    main()
