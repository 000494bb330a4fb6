"""Scores an ONNX file on frames of its own, with the thresholds that were chosen on validation frames.

    python score.py --model ../models/boxnet.onnx --thresholds runs/boxnet/validation.json --render COMMAND [--frames 1500]

Prints JSON. Works for 32-bit and 8-bit files alike; without --thresholds they are chosen on the frames scored, and that is said.
"""

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import onnxruntime
import torch

import metrics
from stream import DEFAULT_COMMAND, frames

TEST_SEED = 1 << 41  # neither training nor validation comes here


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def score(path: Path, command: str, seed: int, count: int, thresholds: dict[str, float] | None) -> dict:
    network = session(path)
    scores = None
    for frame in frames(command, seed, count):
        image = np.ascontiguousarray(frame.rgb.transpose(2, 0, 1)[None], np.float32) / 255
        maps = torch.from_numpy(network.run(None, {"image": image})[0])
        single = maps.shape[1] == 1
        if single and maps.shape[-1] == frame.rgb.shape[1]:
            maps = torch.nn.functional.avg_pool2d(maps, 2)
        scores = scores or metrics.Scores(single, (thresholds or {}).get("single"))
        scores.add(maps, torch.from_numpy(frame.labels)[None].float() / 255, [frame.meta])
    return scores.summary(thresholds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--thresholds", type=Path, help="validation.json of the run")
    parser.add_argument("--render", default=DEFAULT_COMMAND)
    parser.add_argument("--seed", type=int, default=TEST_SEED)
    parser.add_argument("--frames", type=int, default=1500)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    thresholds = None
    if arguments.thresholds:
        chosen = json.loads(arguments.thresholds.read_text())["lines"]
        thresholds = {name: line["threshold"] for name, line in chosen.items()}
    result = score(arguments.model, arguments.render, arguments.seed, arguments.frames, thresholds)
    chosen_on = "validation frames" if thresholds else "the frames scored"
    print(json.dumps({"model": arguments.model.name, "first_seed": arguments.seed, "thresholds_chosen_on": chosen_on, **result}, indent=1))


if __name__ == "__main__":
    main()
