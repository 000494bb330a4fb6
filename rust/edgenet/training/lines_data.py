"""Makes the data of the network of lines; goes on where it stopped.

    python lines_data.py --run runs/lines --photos photos --faces 10000
    ./run_background.sh runs/lines start lines_data.py --photos photos --faces 10000
    python lines.py --run runs/lines --output ../models/lines.onnx

Renders some boxes at a time and takes the strips of their faces (../examples/line_strips.rs); frames are never written. Hazards are as
the renderer mixes them. What is made, by split:

    learn   --faces of them, with the materials that all networks learn from (seeds from 100,000,000)
    choose  a twentieth as many, with materials that no network has seen (seeds from 200,000,000)

Folders of strips bear these names in RUN; RUN/made.jsonl has the seeds of all that was made, one line for each few boxes. Strips hold
the maps of the edge network that ships: with a new one they are made anew, in a new folder.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

import programs
from stream import WORKSPACE

BOXES = 50  # made at a time: photographs are read once for all of them


@dataclass(frozen=True)
class Part:
    """Boxes of one kind. `share`: its faces against --faces."""

    folder: str
    first_seed: int
    held_out: bool
    share: float


PARTS = (Part("learn", 100_000_000, False, 1.0), Part("choose", 200_000_000, True, 0.05))


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--run", type=Path, required=True, help="folder of the data")
    p.add_argument("--faces", type=int, default=10_000, help="to learn from")
    p.add_argument("--photos", type=Path, help="photographs for the renderer (photos.sh)")
    p.add_argument("--strips", type=Path, help="the built example line_strips; default: in target/release, built if cargo is there")
    p.add_argument("--workers", type=int, default=1, help=f"programs at a time, each for {BOXES} boxes")
    return p.parse_args(arguments)


def made(run: Path) -> list[dict]:
    """What earlier starts made; a line that was cut off counts as not made."""
    file = run / "made.jsonl"
    found = []
    for line in file.read_text().splitlines() if file.is_file() else []:
        try:
            found.append(json.loads(line))
        except ValueError:
            continue
    return found


def make(part: Part, seed: int, options: argparse.Namespace) -> int:
    """The strips of BOXES boxes; how many faces have some."""
    out = options.run / part.folder
    out.mkdir(parents=True, exist_ok=True)
    words = [str(options.strips), str(out.resolve()), str(seed), str(BOXES), "held-out" if part.held_out else "training"]
    done = subprocess.run(words + ([str(options.photos.resolve())] if options.photos else []), cwd=WORKSPACE, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"`{' '.join(words)}` ended with code {done.returncode}: {done.stderr.strip()[-500:]}")
    strips = [file for s in range(seed, seed + BOXES) for file in out.glob(f"{s}[a-z].strips")]
    return sum(file.stat().st_size > 0 for file in strips)


def next_seed(part: Part, records: list[dict], running: set[tuple[Part, int]]) -> int:
    """The first seed of this part that nobody has made or is making."""
    taken = {r["seed"] for r in records} | {seed for p, seed in running if p == part}
    seed = part.first_seed
    while seed in taken:
        seed += BOXES
    return seed


def wanted_part(options: argparse.Namespace, records: list[dict], running: set[tuple[Part, int]]) -> Part | None:
    """The part that is furthest from its end, so that all grow together; None if all have enough, what is running counted in."""

    def done(part: Part) -> float:
        own = [r["faces"] for r in records if r["split"] == part.folder]
        expected = sum(p == part for p, _ in running) * (sum(own) / len(own) if own else BOXES)
        return (sum(own) + expected) / max(1.0, part.share * options.faces)

    least = min(PARTS, key=done)
    return least if done(least) < 1 else None


def main() -> None:
    options = parse()
    options.run.mkdir(parents=True, exist_ok=True)
    options.run = options.run.resolve()
    if options.strips is None:
        programs.cargo_build("-p", "boxline-edgenet", "--example", "line_strips")
    options.strips = programs.program(options.strips or programs.RELEASE / "examples" / "line_strips", "--strips")
    records = made(options.run)
    # Without the line that was cut off, or the next one would be written behind it.
    whole = options.run / "made.jsonl.whole"
    whole.write_text("".join(json.dumps(record) + "\n" for record in records))
    whole.replace(options.run / "made.jsonl")
    stop = programs.stop_on_signals()  # what is being made is finished first
    running: dict = {}
    failed = None
    with ThreadPoolExecutor(options.workers) as pool, open(options.run / "made.jsonl", "a") as log:
        while True:
            busy = set(running.values())
            part = None if stop.is_set() or failed else wanted_part(options, records, busy)
            if part and len(running) < options.workers:
                seed = next_seed(part, records, busy)
                running[pool.submit(make, part, seed, options)] = (part, seed)
                continue
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                part, seed = running.pop(future)
                try:
                    faces = future.result()
                except (RuntimeError, OSError) as wrong:
                    failed = wrong
                    continue
                record = {"split": part.folder, "held_out": part.held_out, "seed": seed, "boxes": BOXES, "faces": faces}
                records.append(record)
                log.write(json.dumps(record) + "\n")
                log.flush()
                sums = {p: sum(r["faces"] for r in records if r["split"] == p) for p in ("learn", "choose")}
                print(f"lines_data: seeds {seed} to {seed + BOXES - 1}: {faces} faces; {sums['learn']} of {options.faces} to learn from, {sums['choose']} to choose", flush=True)
    if failed:
        sys.exit(f"lines_data: {failed}")
    print("lines_data: stopped, will go on from here" if wanted_part(options, records, set()) else "lines_data: all is made", flush=True)


if __name__ == "__main__":
    main()
