"""Draws loss, speed and validation scores of a run: python curves.py RUN -> RUN/curves.png"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def records(run: Path) -> list[dict]:
    """Lines of metrics.jsonl; where a run went on from a checkpoint, what came after that checkpoint is left out."""
    kept: list[dict] = []
    for line in (run / "metrics.jsonl").read_text().splitlines():
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


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(draw(Path(sys.argv[1])))
