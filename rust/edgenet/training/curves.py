"""Draws loss, speed and validation scores of a run: python curves.py RUN -> RUN/curves.png

`over_visits` draws several runs beside each other for comparison.py.
"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def records(run: Path) -> list[dict]:
    """Lines of metrics.jsonl; where a run went on from a checkpoint, what came after that checkpoint is left out."""
    kept: list[dict] = []
    file = run / "metrics.jsonl"
    for line in file.read_text().splitlines() if file.is_file() else []:
        try:
            record = json.loads(line)
        except ValueError:
            continue  # cut off when the run was stopped
        while kept and kept[-1]["step"] > record["step"]:
            kept.pop()
        kept.append(record)
    return kept


def draw(run: Path) -> Path:
    every = records(run)
    steps = [r for r in every if "loss" in r]
    checks = [(r["images"], r["validation"]) for r in every if "validation" in r]
    figure, axes = plt.subplots(2, 2, figsize=(12, 8), layout="constrained")
    (loss, speed), (lines, pixels) = axes
    images = [r["images"] for r in steps]
    loss.plot(images, [r["loss"] for r in steps], lw=0.8, label="training")
    loss.plot([i for i, _ in checks], [v["loss"] for _, v in checks], "o-", ms=3, label="validation (EMA)")
    loss.set(yscale="log", ylabel="loss")
    speed.plot(images, [r["images_per_s"] for r in steps], lw=0.8, label="images/s")
    rate = speed.twinx()
    rate.plot(images, [r["lr"] for r in steps], "C1", lw=0.8)
    rate.set(ylabel="learning rate", yscale="log")
    speed.set(ylabel="images/s")
    if checks:
        at = [i for i, _ in checks]
        for name in checks[-1][1]["lines"]:
            lines.plot(at, [v["lines"].get(name, {}).get("f") for _, v in checks], "o-", ms=2, lw=1, label=name)
        lines.set(ylabel="F at 1.5 px", ylim=(0, 1))
        if "mask_iou_mean" in checks[-1][1]:
            for name, key in (("mask IoU", "mask_iou_mean"), ("four lasers < 2 px", "four_lasers_below_2px")):
                pixels.plot(at, [v[key] for _, v in checks], "o-", ms=2, label=name)
            error = pixels.twinx()
            for key in ("median", "p90"):
                error.plot(at, [v["line_px"].get("all", {}).get(key) for _, v in checks], "x--", ms=3, label=f"line {key}, px")
            error.set(yscale="log", ylabel="laser line error, input px")
            error.legend(loc="lower right", fontsize=7)
            pixels.set(ylim=(0, 1))
    for axis in (loss, lines, pixels):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, loc="lower left")
    for axis in axes.flat:
        axis.set_xlabel("images seen")
        axis.grid(alpha=0.3)
    path = run / "curves.png"
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return path


def single_f(run: Path) -> list[tuple[int, float]]:
    """F of the single map on validation frames after so many visits."""
    return [(r["images"], r["validation"]["lines"]["single"]["f"]) for r in records(run) if "validation" in r]


def over_visits(runs: list[tuple[str, Path, bool]], path: Path) -> None:
    """F over visits for runs (name, folder, whether it goes on); one that goes on ends in an open circle."""
    plt.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "curves"}  # small, and the same file for the same curves
    figure, axis = plt.subplots(figsize=(10, 5.5), layout="constrained")
    for number, (name, folder, goes_on) in enumerate(runs):
        points = single_f(folder)
        if not points:
            continue
        style = ("-", "--", ":")[number // 10 % 3]
        visits, f = zip(*points)
        axis.plot(visits, f, style, lw=1.4, color=f"C{number % 10}", label=name + (", goes on" if goes_on else ""))
        axis.plot(visits[-1], f[-1], "o", ms=5, color=f"C{number % 10}", mfc="white" if goes_on else None)
    axis.set(xscale="log", xlabel="image visits", ylabel="F of the single map, validation frames", ylim=(0, 1))
    axis.grid(alpha=0.3, which="both")
    if axis.lines:
        axis.legend(fontsize=8, loc="lower right")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(draw(Path(sys.argv[1])))
