"""Fits how much the evidence for a line counts: the networks of lines and of sides and the stripes' light on one scale.

    cargo run --release -p boxline-edgenet --example side_evidence -- learn > learn.csv          (recordings with truth)
    cargo run --release -p boxline-edgenet --example side_evidence -- choose > choose.csv
    python weights.py --learn learn.csv --choose choose.csv

A side's right lines against its other lines: a conditional logit, fitted by maximum likelihood to the first file and scored on the
second. Prints the weights for `rust/core/src/rectangle/line_evidence.rs` and, for kinds of evidence alone and together, the loss a side,
the share of sides and faces whose likeliest lines are right, and what a least probability of all four leaves: faces, and wrong ones.
"""

import argparse
import csv
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch

RIGHT_PX = 10.0  # a line within so many px of the true side, or inside it by the edge's radius, is the right one
RIGHT_MM = 5.0  # a side that is measured farther off is wrong
LEAST_SEEN = 1e-3  # as in line_evidence.rs
MOST_ODDS = (150.0, 1e4)  # as in outlines.rs
LEAST_LEFT = 1e-6  # as in outlines.rs
SAME_SIDE_PX = 10.0  # lines that are taken together, as in outlines.rs


COLUMNS = ("off_px", "mm_per_px", "radius_mm", "told", "seen", "known", "hidden", "not_in_view", "measured_off_mm", "beyond_least", "beyond_most", "missing", "to_border", "step", "mask_beyond")


def read(path: Path, refuse: str = "0") -> dict:
    """Lines by recording, frame and side, of frames that may be measured or must be refused for a reason."""
    sides = defaultdict(list)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            if row["refuse"] == refuse:
                sides[row["recording"], row["frame"], int(row["side"])].append({k: float(row[k]) for k in COLUMNS})
    return sides


def features(lines: list[dict]) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    off = np.array([l["off_px"] for l in lines])
    radius = np.array([l["radius_mm"] / l["mm_per_px"] for l in lines])
    right = (off >= -(RIGHT_PX + radius)) & (off <= RIGHT_PX)
    x = np.array([[l["told"], np.log(l["seen"] + LEAST_SEEN), l["beyond_most"] - l["beyond_least"], l["missing"], l["step"]] for l in lines])
    return torch.tensor(x), torch.tensor(right), off


def fit(sides: dict, used: list[int]) -> torch.Tensor:
    data = [(x, right) for x, right, _ in map(features, sides.values()) if right.any()]
    weights = torch.zeros(5, dtype=torch.float64, requires_grad=True)
    mask = torch.zeros(5, dtype=torch.float64)
    mask[used] = 1
    optimiser = torch.optim.LBFGS([weights], max_iter=60)

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        w = weights * mask
        loss = -torch.stack([torch.logsumexp((x @ w)[right], 0) - torch.logsumexp(x @ w, 0) for x, right in data]).mean()
        loss.backward()
        return loss

    optimiser.step(closure)
    return (weights * mask).detach()


def sure(sides: dict, w: torch.Tensor) -> torch.Tensor:
    """`sure` of outlines.rs: that a side's likeliest line is right, from its odds by all but the network of sides and by that network, a
    pixel's size, what the stripes' light says, and what all of it together leaves for other lines. It is, too, where the side was measured within RIGHT_MM, or would be."""
    x, y = [], []
    for lines in sides.values():
        mm_per_px, radius_mm = lines[0]["mm_per_px"], lines[0]["radius_mm"]
        off_mm = np.array([l["off_px"] for l in lines]) * mm_per_px
        told = features(lines)[0]
        best = int((told @ w).argmax())
        p = torch.softmax(told[:, 0], 0).numpy()
        near = np.abs(off_mm - off_mm[best]) <= SAME_SIDE_PX * mm_per_px
        odds = [float(np.clip(v / max(1 - v, 1e-12), 1 / most, most)) for v, most in zip((p[near].sum(), lines[best]["seen"]), MOST_ODDS)]
        left = 1 - torch.softmax(told @ w, 0).numpy()[near].sum()
        x.append([1, *np.log(odds), np.log(mm_per_px), float(told[best, 2:] @ w[2:]), np.log(max(left, LEAST_LEFT))])
        within = lambda limit_mm: -(limit_mm + radius_mm) <= off_mm[best] <= limit_mm
        measured_off_mm = lines[best]["measured_off_mm"]
        near_enough = within(RIGHT_MM) if np.isnan(measured_off_mm) else abs(measured_off_mm) <= RIGHT_MM
        y.append(float(within(RIGHT_PX * mm_per_px) or near_enough))
    x, y = torch.tensor(np.array(x)), torch.tensor(y, dtype=torch.float64)
    weights = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=500, tolerance_change=1e-12, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = torch.nn.functional.binary_cross_entropy_with_logits(x @ weights, y)
        loss.backward()
        return loss

    optimiser.step(closure)
    return weights.detach()


def called_hidden(sides: dict) -> dict:
    """`least_probability` of scene/hidden.rs: the share of faces with a side that the network of sides calls hidden at least so surely."""
    faces = defaultdict(float)
    for (recording, frame, _), lines in sides.items():
        faces[recording, frame] = max([faces[recording, frame]] + [line["hidden"] for line in lines])
    told = np.array(list(faces.values()))
    return {str(least): round(float((told >= least).mean()), 3) for least in (0.5, 0.6, 0.7, 0.8, 0.9)}


def score(sides: dict, w: torch.Tensor) -> dict:
    losses, sides_right, faces = [], [], defaultdict(lambda: [1.0, True, 0])
    for (recording, frame, _), lines in sides.items():
        x, right, off = features(lines)
        p = torch.softmax(x @ w, 0).numpy()
        best = int(p.argmax())
        if right.any():
            losses.append(-np.log(p[right.numpy()].sum() + 1e-9))
        sides_right.append(bool(right[best]))
        face = faces[recording, frame]
        face[0] *= p[np.abs(off - off[best]) <= SAME_SIDE_PX].sum()
        face[1] &= bool(right[best])
        face[2] += 1
    told = np.array([(p, r) for p, r, n in faces.values() if n == 4])
    kept = {}
    for least in (0.5, 0.8, 0.9, 0.95, 0.98, 0.99):
        chosen = told[:, 0] >= least
        kept[str(least)] = [round(float(chosen.mean()), 3), int((chosen & (told[:, 1] == 0)).sum())]
    return {
        "sides": len(sides_right), "without a right line": len(sides_right) - len(losses), "loss": round(float(np.mean(losses)), 4),
        "sides right": round(float(np.mean(sides_right)), 4), "faces": len(told), "faces right": round(float(told[:, 1].mean()), 4), "kept, of these wrong": kept,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learn", type=Path, required=True)
    parser.add_argument("--choose", type=Path, required=True)
    options = parser.parse_args()
    learn, choose = read(options.learn), read(options.choose)
    for name, used in (("lines alone", [0]), ("sides alone", [1]), ("both", [0, 1]), ("both and light", [0, 1, 2, 3]), ("all, and steps", [0, 1, 2, 3, 4])):
        w = fit(learn, used)
        print(f"{name}: weights {[round(float(v), 3) for v in w]}; {json.dumps(score(choose, w))}")
    print(f"sure, both files: {[round(float(v), 3) for v in sure(learn | choose, w)]}")
    print(f"sound faces with a side more surely hidden: {json.dumps(called_hidden(learn | choose))}")


if __name__ == "__main__":
    main()
