"""Writes ../COMPARISON.md: BoxNet beside the paper's IHED and HED, all on the same frames.

    ORT_DYLIB_PATH=.../libonnxruntime.so python comparison.py --runs runs/compare --shipped runs/boxnet \\
        --time "cargo run --release -p boxline-edgenet --example time --" [--frames 1500]

Each run is exported, its thresholds are chosen on validation frames, and all are scored together on test frames. Times of both
runtimes come from one run of the Rust timing program. Runs that are not there are named as missing.
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch

import checkpoint
import export
import models
import score
from losses import single_map
from stream import DEFAULT_COMMAND, WORKSPACE, frames
from train import VALIDATION_SEED

# Folder of the run (compare_train.sh), its name in the table.
COMPARED = [
    ("boxnet-same-visits", "BoxNet, same visits"),
    *((f"{net}4-{how}{norm}", f"{net.upper()} 1/4, {words}{', normalised' if norm else ''}")
      for norm in ("", "-norm") for net in ("hed", "ihed") for how, words in (("deep", "deep supervision"), ("fused", "fused loss"))),
    *((f"ihed8-fused{norm}-seed{seed}", f"IHED 1/8, fused loss{', normalised' if norm else ''}, seed {seed}") for norm in ("", "-norm") for seed in (1, 2, 3)),
    ("ihed-pretrained", "IHED full width, pretrained, short"),
]
PICTURES = 4  # frames of figure 12


@dataclass
class Row:
    name: str
    state: dict
    path: Path
    parameters: float
    gmac: float
    difference: float
    scores: dict = field(default_factory=dict)
    times: dict = field(default_factory=dict)


def rows_of(folder: Path, name: str, out: Path) -> list[Row]:
    """A run as one row or, where only the fused map was trained, two: the paper's average, and that map alone."""
    state = checkpoint.load_newest(folder) if folder.is_dir() else None
    if state is None:
        return []
    net, norm = state["options"]["net"], state["options"]["norm"]
    rows = []
    for fused_only in (False, True):
        if fused_only and (net == "boxnet" or state["options"]["deep_supervision"]):
            continue
        model = models.named(net, norm)
        model.load_state_dict(state["ema"])
        path = out / f"{folder.name}{'-fused-map' if fused_only else ''}.onnx"
        sizes = models.parameters(model) / 1e6, models.macs(model, 384, 512) / 1e9
        difference = export.export(model, path, fused_only=fused_only)
        rows.append(Row(name + (", fused map alone" if fused_only else ""), state, path, *sizes, difference))
    return rows


def timed(command: str, rows: list[Row]) -> None:
    """Adds milliseconds and peak memory, by runtime."""
    run = subprocess.run([*shlex.split(command), "--json", *(str(row.path) for row in rows)], cwd=WORKSPACE, capture_output=True, text=True, check=True)
    by_path = {str(row.path): row for row in rows}
    for line in run.stdout.splitlines():
        result = json.loads(line)
        by_path[result["model"]].times[result["runtime"]] = result


def figure_11(rows: list[Row], path: Path) -> None:
    """Precision, recall and F of the single map as bars; the seeds of one network are one bar with its spread."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(re.sub(", seed [0-9]+", "", row.name), []).append(row)
    figure, axis = plt.subplots(figsize=(11, 0.62 * len(groups) + 1.6), layout="constrained")
    place = np.arange(len(groups))[::-1]
    for shift, (key, colour) in enumerate((("precision", "#9ecae1"), ("recall", "#6baed6"), ("f", "#08519c"))):
        values = [np.array([row.scores["lines"]["single"][key] for row in group]) for group in groups.values()]
        mean = np.array([v.mean() for v in values])
        spread = np.array([[m - v.min(), v.max() - m] for m, v in zip(mean, values)]).T
        label = "F" if key == "f" else key
        axis.barh(place + 0.27 - 0.27 * shift, mean, 0.25, xerr=spread, color=colour, label=label, error_kw={"capsize": 2})
    axis.set_yticks(place, [name + (f" ({len(group)} seeds)" if len(group) > 1 else "") for name, group in groups.items()])
    axis.set_xlim(0, 1)
    axis.grid(axis="x", alpha=0.4)
    axis.legend(loc="lower right")
    axis.set_title("Single map: lasers on the face and the face's edges")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def figure_12(rows: list[Row], command: str, seed: int, path: Path) -> None:
    """A few frames: image, truth, and each network's single map."""
    shown = list(frames(command, seed, PICTURES))
    figure, axes = plt.subplots(len(rows) + 2, PICTURES, figsize=(3.1 * PICTURES, 2.4 * (len(rows) + 2)), squeeze=False, layout="constrained")
    networks = [score.session(row.path) for row in rows]
    for column, frame in enumerate(shown):
        truth = single_map(torch.from_numpy(frame.labels)[None].float() / 255)[0, 0]
        axes[0][column].imshow(frame.rgb)
        axes[1][column].imshow(truth, cmap="gray", vmin=0, vmax=1)
        for axis, network in zip(axes[2:, column], networks):
            maps = score.maps_of(network, frame)
            single = maps if maps.shape[1] == 1 else single_map(maps)
            axis.imshow(single[0, 0], cmap="gray", vmin=0, vmax=1)
    for axis, name in zip(axes[:, 0], ["frame", "truth", *(row.name for row in rows)]):
        axis.set_title(name, fontsize=8, loc="left")
    for axis in axes.flat:
        axis.axis("off")
    figure.savefig(path, dpi=70, pil_kwargs={"quality": 85})
    plt.close(figure)


def number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def page(rows: list[Row], missing: list[str], arguments: argparse.Namespace) -> str:
    lines = [
        "# BoxNet beside IHED and HED",
        "",
        f"Written by `training/comparison.py --runs RUNS --shipped RUN --time TIMER --frames {arguments.frames} --validation-frames {arguments.validation_frames}`; not edited by hand.",
        "",
        f"All on the same {arguments.frames} rendered frames with materials that training never showed (seeds from {arguments.seed}); thresholds from",
        f"{arguments.validation_frames} validation frames. What is scored is the paper's single map: the strongest of the four lasers on the face and the",
        "face's edges. A pixel of a thinned line is right within 3 px at 512 (eqs. 17 to 19). Key points: where a laser's line meets an edge of",
        "the face, taken from the map near the true lines, px at 512; *signed* is the mean with signs as in eq. 21 (right, down), in which",
        "opposite errors cancel, *off* the mean distance. HED and IHED give the average of eq. 16 unless *fused map alone* is said.",
        "",
        "![Precision, recall and F](docs/figure11.png)",
        "",
        "| network | visits | F | precision | recall | key points found | off | p90 | signed |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        line, points = row.scores["lines"]["single"], row.scores["key_points_px"]
        signed = ", ".join(f"{v:+.2f}" for v in points["signed"]) if points["signed"] else "-"
        cells = [row.name, f"{row.state['images']:,}", *(number(line[k]) for k in ("f", "precision", "recall")), number(points["found"])]
        lines.append("| " + " | ".join([*cells, number(points["unsigned"], 2), number(points["p90"], 2), signed]) + " |")
    seeds = [row.scores["lines"]["single"]["f"] for row in rows if ", seed" in row.name and "alone" not in row.name]
    if len(seeds) > 1:
        lines += ["", f"Spread of F over {len(seeds)} seeds of one network: {min(seeds):.3f} to {max(seeds):.3f}; smaller differences say nothing."]
    lines += [
        "",
        "## Cost",
        "",
        "512 x 384 input, one thread; the least of many runs, all in one run of the timing program, each in a process of its own,",
        "whose peak memory is given. Other work on the machine makes single figures worse, not better.",
        "",
        "| network | M parameters | GMAC | ONNX Runtime ms | tract ms | ONNX Runtime MB | tract MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if "fused map alone" in row.name or ("seed" in row.name and "seed 1" not in row.name):
            continue
        time = lambda runtime, key, digits: number(row.times.get(runtime, {}).get(key), digits)
        costs = [time("ort", "ms", 1), time("tract", "ms", 1), time("ort", "peak_mb", 0), time("tract", "peak_mb", 0)]
        lines.append("| " + " | ".join([row.name.split(", seed")[0], f"{row.parameters:.3f}", f"{row.gmac:.2f}", *costs]) + " |")
    for row in rows:
        if row.state["options"]["net"] != "boxnet":
            continue
        s = row.scores
        lines += [
            "",
            f"## {row.name}: its channels",
            "",
            "| lines | F | precision | recall |",
            "|---|---|---|---|",
            *(f"| {name} | {l['f']:.3f} | {l['precision']:.3f} | {l['recall']:.3f} |" for name, l in s["lines"].items()),
            "",
            f"Face mask IoU {number(s['mask_iou_mean'])} mean, {number(s['mask_iou_median'])} median. Laser lines: "
            + "; ".join(f"{name} {number(l['median'], 2)} px median, {number(l['p90'], 2)} p90 ({l['n']})" for name, l in s["line_px"].items())
            + f". All four within 2 px in {number(s['four_lasers_below_2px'])} of the measurable frames, {number(s['four_lasers_below_2px_not_dim'])} of those where none is dim.",
        ]
    lines += ["", "![Frames, truth and what the networks see](docs/figure12.jpg)", "", "## Not shown", ""]
    lines += [f"- Missing: {name}; it was not trained." for name in missing] or ["- All runs are there."]
    lines += ["- Long trainings: the paper's networks saw 40,000 images; what these saw is in the table, most of it at half size."]
    lines += ["- Real photographs: nothing here says how any of these networks does on them.", ""]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, required=True, help="folder of compare_train.sh")
    parser.add_argument("--shipped", type=Path, help="run of the network that ships")
    parser.add_argument("--time", help="command line of the Rust timing program; without it no times")
    parser.add_argument("--render", default=f"{DEFAULT_COMMAND} --held-out", help="of test frames")
    parser.add_argument("--render-validation", default=DEFAULT_COMMAND)
    parser.add_argument("--seed", type=int, default=score.TEST_SEED)
    parser.add_argument("--frames", type=int, default=1500)
    parser.add_argument("--validation-frames", type=int, default=200)
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parents[1])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    candidates = [(arguments.runs / folder, name) for folder, name in COMPARED]
    if arguments.shipped:
        candidates.insert(0, (arguments.shipped, "BoxNet as it ships"))
    with tempfile.TemporaryDirectory() as temporary:
        found = [(name, rows_of(folder, name, Path(temporary))) for folder, name in candidates]
        rows = [row for _, some in found for row in some]
        missing = [name for name, some in found if not some and ", normalised" not in name]
        if not rows:
            parser.error(f"no run in {arguments.runs}")
        networks = [score.session(row.path) for row in rows]
        validation = score.score(networks, frames(arguments.render_validation, VALIDATION_SEED, arguments.validation_frames), [None] * len(rows))
        thresholds = [score.thresholds_in(summary) for summary in validation]
        for row, scores in zip(rows, score.score(networks, frames(arguments.render, arguments.seed, arguments.frames), thresholds)):
            row.scores = scores
        if arguments.time:
            timed(arguments.time, rows)
        (arguments.output / "docs").mkdir(parents=True, exist_ok=True)
        figure_11(rows, arguments.output / "docs" / "figure11.png")
        figure_12(rows, arguments.render, arguments.seed, arguments.output / "docs" / "figure12.jpg")
        (arguments.output / "COMPARISON.md").write_text(page(rows, missing, arguments))
    print(f"comparison: {arguments.output / 'COMPARISON.md'}: {len(rows)} rows, missing: {', '.join(missing) or 'none'}")


if __name__ == "__main__":
    main()
