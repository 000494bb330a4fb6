"""Writes ../COMPARISON.md: BoxNet beside the paper's IHED and HED, all on the same frames.

    ORT_DYLIB_PATH=.../libonnxruntime.so python comparison.py --runs runs/all \\
        --time "cargo run --release -p boxline-edgenet --example time --" [--frames 1500]

Each run is exported, its thresholds are chosen on validation frames, and all are scored on the same test frames. Scores are kept in
RUN/scores.json (of what ships in RUNS/scores-shipped.json) and not made again while checkpoint and frames are the same. Times of both runtimes come from one run of the Rust
timing program. Runs that go on say so, those that are not there are named as missing; of a run without weights (train_all.py packs
the large ones so) the kept scores are shown.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import re
import shlex
import subprocess
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch

import checkpoint
import curves
import export
import models
import score
from losses import single_map
from stream import DEFAULT_COMMAND, WORKSPACE, frames
from train import VALIDATION_SEED

SHIPPED = Path(__file__).resolve().parent / "checkpoints" / "boxnet"
# Folder of the run (train_all.py), its name in the table.
COMPARED = [
    ("boxnet", "BoxNet, trained on"),
    ("boxnet-same-visits", "BoxNet, same visits"),
    *((f"{net}4-{how}{norm}", f"{net.upper()} 1/4, {words}{', normalised' if norm else ''}")
      for norm in ("", "-norm") for net in ("hed", "ihed") for how, words in (("deep", "deep supervision"), ("fused", "fused loss"))),
    *((f"ihed8-fused{norm}-seed{seed}", f"IHED 1/8, fused loss{', normalised' if norm else ''}, seed {seed}") for norm in ("", "-norm") for seed in (1, 2, 3)),
    ("ihed-full", "IHED full width, fused loss"),
    ("hed-full", "HED full width, deep supervision"),
]
ALONE = ", fused map alone"
LARGE_GMAC, LARGE_THREADS = 20, 4  # threads of a large network, where several are scored at a time
PICTURES = 4  # frames of figure 12


@dataclass
class Row:
    """One line of the table: a run's map, or its fused map alone."""

    name: str
    run: Path
    state: dict
    fused_only: bool
    path: Path | None  # of the ONNX file; None without weights
    parameters: float
    gmac: float
    scores_file: Path  # where its scores are kept
    scores: dict = field(default_factory=dict)
    times: dict = field(default_factory=dict)

    @property
    def label(self) -> str:
        return self.name + (ALONE if self.fused_only else "")

    @property
    def goes_on(self) -> bool:
        return not self.state["finished"]


def rows_of(folder: Path, name: str, out: Path, scores_file: Path) -> list[Row]:
    """A run as one row or, where only the fused map was trained, two: the paper's average, and that map alone."""
    state = checkpoint.load_newest(folder) if folder.is_dir() else None
    if state is None:
        return []
    options = state["options"]
    if options["init"]:
        name += ", pretrained"
    rows = []
    for fused_only in (False, True):
        if fused_only and (options["net"] == "boxnet" or options["deep_supervision"]):
            continue
        model = models.named(options["net"], options["norm"])
        sizes = models.parameters(model) / 1e6, models.macs(model, 384, 512) / 1e9
        path = None
        if "ema" in state:
            model.load_state_dict(state["ema"])
            path = out / f"{folder.parent.name}-{folder.name}{'-fused-map' if fused_only else ''}.onnx"
            export.export(model, path, fused_only=fused_only)
        rows.append(Row(name, folder, state, fused_only, path, *sizes, scores_file))
    return rows


def frames_key(arguments: argparse.Namespace) -> dict:
    """What scores depend on beside the weights: which frames, and how the renderer renders them."""
    digest = hashlib.sha256()
    for command, seed in ((arguments.render, arguments.seed), (arguments.render_validation, VALIDATION_SEED)):
        [frame] = frames(command, seed, 1)
        digest.update(frame.rgb.tobytes() + frame.labels.tobytes())
    return {"seed": arguments.seed, "frames": arguments.frames, "validation_frames": arguments.validation_frames, "digest": digest.hexdigest()[:16]}


def kept_scores(row: Row, key: dict) -> dict | None:
    """Scores that were made before of the same checkpoint on the same frames."""
    kept = json.loads(row.scores_file.read_text()) if row.scores_file.is_file() else {}
    return kept.get(row.label) if kept.get("key") == {"step": row.state["step"], **key} else None


def keep_scores(rows: list[Row], key: dict) -> None:
    for file in {row.scores_file for row in rows}:
        of_run = [row for row in rows if row.scores_file == file]
        kept = {"key": {"step": of_run[0].state["step"], **key}, **{row.label: row.scores for row in of_run}}
        file.write_text(json.dumps(kept, indent=1) + "\n")


def score_files(paths: list[Path], threads: int, arguments: argparse.Namespace) -> list[dict]:
    """Thresholds from validation frames, scores from test frames."""
    torch.set_num_threads(1)
    networks = [score.session(path, threads) for path in paths]
    validation = score.score(networks, frames(arguments.render_validation, VALIDATION_SEED, arguments.validation_frames), [None] * len(paths))
    thresholds = [score.thresholds_in(summary) for summary in validation]
    return score.score(networks, frames(arguments.render, arguments.seed, arguments.frames), thresholds)


def score_rows(rows: list[Row], arguments: argparse.Namespace) -> None:
    """Gives every row its scores; those to be made, with several workers, in processes of their own."""
    key = frames_key(arguments)
    for row in rows:
        row.scores = kept_scores(row, key) or {}
    todo = sorted((row for row in rows if not row.scores and row.path), key=lambda row: -row.gmac)
    parts = [part for part in (todo[n :: arguments.workers] for n in range(arguments.workers)) if part]
    paths = [[row.path for row in part] for part in parts]
    if len(parts) < 2:
        found = [score_files(part, 1, arguments) for part in paths]
    else:
        # The largest would keep all others waiting.
        threads = [LARGE_THREADS if part[0].gmac > LARGE_GMAC else 1 for part in parts]
        with ProcessPoolExecutor(len(parts), multiprocessing.get_context("spawn")) as pool:
            found = list(pool.map(score_files, paths, threads, [arguments] * len(parts)))
    for part, scores in zip(parts, found):
        for row, each in zip(part, scores):
            row.scores = each
    keep_scores([row for row in rows if row.scores], key)


def timed(command: str, rows: list[Row]) -> None:
    """Adds milliseconds and peak memory, by runtime."""
    rows = [row for row in rows if row.path]
    run = subprocess.run([*shlex.split(command), "--json", *(str(row.path) for row in rows)], cwd=WORKSPACE, capture_output=True, text=True, check=True)
    by_path = {str(row.path): row for row in rows}
    for line in run.stdout.splitlines():
        result = json.loads(line)
        by_path[result["model"]].times[result["runtime"]] = result


def figure_11(rows: list[Row], path: Path) -> None:
    """Precision, recall and F of the single map as bars; the seeds of one network are one bar with its spread."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(re.sub(", seed [0-9]+", "", row.label), []).append(row)
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
    rows = [row for row in rows if row.path]
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
    for axis, name in zip(axes[:, 0], ["frame", "truth", *(row.label for row in rows)]):
        axis.set_title(name, fontsize=8, loc="left")
    for axis in axes.flat:
        axis.axis("off")
    figure.savefig(path, dpi=70, pil_kwargs={"quality": 85})
    plt.close(figure)


def number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def half_sizes(rows: list[Row]) -> str:
    """How much of a sitting was at half size, in words."""
    shares = sorted({row.state["options"]["half_share"] for row in rows})
    return "of a run's last sitting " + " or ".join(f"{share:.0%}" for share in shares) + " at half the input's size"


def page(rows: list[Row], missing: list[str], arguments: argparse.Namespace) -> str:
    lines = [
        "# BoxNet beside IHED and HED",
        "",
        f"Written by `training/comparison.py --runs RUNS --time TIMER --frames {arguments.frames} --validation-frames {arguments.validation_frames}`; not edited by hand.",
        "",
        f"All on the same {arguments.frames} rendered frames with materials that training never showed (seeds from {arguments.seed}); thresholds from",
        f"{arguments.validation_frames} validation frames. What is scored is the paper's single map: the strongest of the four lasers on the face and the",
        "face's edges. A pixel of a thinned line is right within 3 px at 512 (eqs. 17 to 19). Key points: where a laser's line meets an edge of",
        "the face, taken from the map near the true lines, px at 512; *signed* is the mean with signs as in eq. 21 (right, down), in which",
        "opposite errors cancel, *off* the mean distance. HED and IHED give the average of eq. 16 unless *fused map alone* is said.",
        "",
        "![Precision, recall and F](docs/figure11.png)",
        "",
        "F over visits, each run on the validation frames of its time, thresholds chosen on them. A run's learning rate falls to nothing at its",
        "end, which gives its last points their rise: points of different runs at the same visits compare only at their ends.",
        "",
        "![F over visits](docs/curves.svg)",
        "",
        "| network | visits | F | precision | recall | key points found | off | p90 | signed |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        line, points = row.scores["lines"]["single"], row.scores["key_points_px"]
        signed = ", ".join(f"{v:+.2f}" for v in points["signed"]) if points["signed"] else "-"
        cells = [row.label, f"{row.state['images']:,}" + (" (goes on)" if row.goes_on else ""), *(number(line[k]) for k in ("f", "precision", "recall")), number(points["found"])]
        lines.append("| " + " | ".join([*cells, number(points["unsigned"], 2), number(points["p90"], 2), signed]) + " |")
    seeds = [row.scores["lines"]["single"]["f"] for row in rows if ", seed" in row.name and not row.fused_only]
    if len(seeds) > 1:
        lines += ["", f"Spread of F over {len(seeds)} seeds of one network: {min(seeds):.3f} to {max(seeds):.3f}; smaller differences say nothing."]
    lines += [
        "",
        "## Cost",
        "",
        "512 x 384 input, one thread; the least of many runs, all in one run of the timing program, each in a process of its own,",
        "whose peak memory is given. Other work on the machine makes single figures worse, not better.",
        "",
        "| network | M parameters | GMAC | ONNX Runtime ms | engine inside ms | ONNX Runtime MB | engine inside MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.fused_only or ("seed" in row.name and "seed 1" not in row.name):
            continue
        time = lambda runtime, key, digits: number(row.times.get(runtime, {}).get(key), digits)
        costs = [time("ort", "ms", 1), time("embedded", "ms", 1), time("ort", "peak_mb", 0), time("embedded", "peak_mb", 0)]
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
    lines += [f"- {what}." for what in missing] or ["- All runs are there."]
    lines += [f"- What the paper's networks learned from: they saw 40,000 images; what these saw is in the table, {half_sizes(rows)}."]
    lines += ["- Real photographs: nothing here says how any of these networks does on them.", ""]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, required=True, help="folder of train_all.py")
    parser.add_argument("--shipped", type=Path, default=SHIPPED, help="run of the network that ships; default: checkpoints/boxnet")
    parser.add_argument("--time", help="command line of the Rust timing program; without it no times")
    parser.add_argument("--render", default=f"{DEFAULT_COMMAND} --held-out", help="of test frames")
    parser.add_argument("--render-validation", default=DEFAULT_COMMAND)
    parser.add_argument("--seed", type=int, default=score.TEST_SEED)
    parser.add_argument("--frames", type=int, default=1500)
    parser.add_argument("--validation-frames", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1, help="processes that score; each renders the frames itself")
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parents[1])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    candidates = [(arguments.shipped, "BoxNet as it ships", arguments.runs / "scores-shipped.json")]
    candidates += [(arguments.runs / folder, name, arguments.runs / folder / "scores.json") for folder, name in COMPARED]
    with tempfile.TemporaryDirectory() as temporary:
        found = [(name, rows_of(folder, name, Path(temporary), scores_file)) for folder, name, scores_file in candidates]
        rows = [row for _, some in found for row in some]
        missing = [f"{name}: not trained" for name, some in found if not some and ", normalised" not in name]
        if not rows:
            parser.error(f"no run in {arguments.runs}")
        score_rows(rows, arguments)
        missing += [f"{row.label}: no weights here, and its scores are of other frames" for row in rows if not row.scores]
        rows = [row for row in rows if row.scores]
        if arguments.time:
            timed(arguments.time, rows)
        docs = arguments.output / "docs"
        docs.mkdir(parents=True, exist_ok=True)
        figure_11(rows, docs / "figure11.png")
        figure_12(rows, arguments.render, arguments.seed, docs / "figure12.jpg")
        curves.over_visits([(row.name, row.run, row.goes_on) for row in rows if not row.fused_only], docs / "curves.svg")
        (arguments.output / "COMPARISON.md").write_text(page(rows, missing, arguments))
    print(f"comparison: {arguments.output / 'COMPARISON.md'}: {len(rows)} rows, missing: {'; '.join(missing) or 'none'}")


if __name__ == "__main__":
    main()
