"""Fits how likely a side is to lie outside the picture: what the networks say and the stripes' light, for `rust/core/src/scene/cut.rs`.

    cargo run --release -p boxline-edgenet --example side_evidence -- learn > whole.csv          (boxes)
    cargo run --release -p boxline-edgenet --example side_evidence -- refuse > refuse.csv        (`render --kind refuse`)
    python weights_cut.py --whole whole.csv --refuse refuse.csv

Right sides of whole faces against lines that were taken for a side which the picture's border cuts off: a logistic function, fitted by
maximum likelihood, with the constant for faces of which one in twenty is cut. Prints it, and how many sides of both kinds it calls cut with
what probability, each by a fit without its recording.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from weights import RIGHT_MM, features, read
from weights import fit as fit_lines

LEAST_NOT_IN_VIEW, LEAST_MASK = 1e-5, 1e-3  # least_not_in_view and least_mask of cut.rs
CUT_FRAMES, SIDES = 0.05, 4  # an assumption: of twenty frames one is cut, at one side
FAR_PX = 35.0  # a line nearer to the side than this is no line within the face


def likeliest(sides: dict, weights: torch.Tensor) -> list[tuple]:
    """Of each side's likeliest line: recording, how far outwards of the true side it lies, mm and px, and what is said of it."""
    found = []
    for (recording, _, _), lines in sides.items():
        line = lines[int((features(lines)[0] @ weights).argmax())]
        measured = line["measured_off_mm"]
        off_mm = line["off_px"] * line["mm_per_px"] if np.isnan(measured) else measured
        mask = line["mask_beyond"]
        told = [1.0, np.log(line["not_in_view"] + LEAST_NOT_IN_VIEW), line["to_border"], np.log((mask + LEAST_MASK) / (1 - mask + LEAST_MASK))]
        found.append((recording, off_mm, line["off_px"], told))
    return found


def fit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Newton's method."""
    weights = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-x @ weights))
        hessian = (x * (p * (1 - p))[:, None]).T @ x + 1e-6 * np.eye(len(weights))
        weights -= np.linalg.solve(hessian, x.T @ (p - y))
    return weights


def probability(x: np.ndarray, weights: np.ndarray, shares: float) -> np.ndarray:
    odds = np.exp(x @ weights) / shares * (CUT_FRAMES / SIDES) / (1 - CUT_FRAMES / SIDES)
    return odds / (1 + odds)


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--whole", type=Path, nargs="+", required=True, help="side_evidence of boxes")
    p.add_argument("--refuse", type=Path, nargs="+", required=True, help="side_evidence of frames that must be refused")
    options = p.parse_args()
    faces = {side: lines for path in options.whole for side, lines in read(path).items()}
    refuse = {side: lines for path in options.refuse for side, lines in read(path, "face_cut_by_border").items()}
    weights = fit_lines(faces, [0, 1, 2, 3, 4])
    whole = [side for side in likeliest(faces, weights) if abs(side[1]) <= RIGHT_MM]
    cut = [side for side in likeliest(refuse, weights) if side[1] < -RIGHT_MM and side[2] < -FAR_PX]
    x = np.array([side[3] for side in whole + cut])
    y = np.array([0.0] * len(whole) + [1.0] * len(cut))
    shares = len(cut) / len(whole)
    weights = fit(x, y)
    told = np.zeros(len(y))
    recordings = np.array([side[0] for side in whole + cut])
    for fold in range(10):
        held = np.array([hash_of(name) % 10 == fold for name in recordings])
        told[held] = probability(x[held], fit(x[~held], y[~held]), shares)
    constant = weights[0] + np.log((CUT_FRAMES / SIDES) / (1 - CUT_FRAMES / SIDES) / shares)
    print(f"{len(whole)} right sides, {len(cut)} lines taken for one that is cut off")
    print(f"constant {constant:.2f}, of ln(not in view) {weights[1]:.2f}, of light to the border {weights[2]:.3f}, of the mask beyond {weights[3]:.2f}")
    for limit in (0.001, 0.003, 0.01, 0.03, 0.1, 0.5):
        print(f"called cut with at least {limit}: {(told[y == 0] >= limit).mean():.4f} of right sides, {(told[y == 1] >= limit).mean():.4f} of those cut off")


def hash_of(name: str) -> int:
    return int("".join(c for c in name if c.isdigit()) or 0)


if __name__ == "__main__":
    main()
