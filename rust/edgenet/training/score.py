"""Scores an ONNX file on frames of its own, with the thresholds that were chosen on validation frames.

    python score.py --model ../models/boxnet.onnx --thresholds runs/boxnet/validation.json --render COMMAND [--frames 1500]

Prints JSON. Works for 32-bit and 8-bit files alike; without --thresholds they are chosen on the frames scored, and that is said.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Iterable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import onnxruntime
import torch

import metrics
from stream import DEFAULT_COMMAND, Frame, frames

TEST_SEED = 1 << 41  # neither training nor validation comes here


def session(path: Path, threads: int = 1) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def maps_of(network: onnxruntime.InferenceSession, frame: Frame) -> torch.Tensor:
    """Probabilities on the label raster (1, channels or 1, h, w)."""
    image = np.ascontiguousarray(frame.rgb.transpose(2, 0, 1)[None], np.float32) / 255
    maps = torch.from_numpy(network.run(None, {"image": image})[0])
    single = maps.shape[1] == 1 and maps.shape[-1] == frame.rgb.shape[1]
    return torch.nn.functional.avg_pool2d(maps, 2) if single else maps


def score(networks: list[onnxruntime.InferenceSession], source: Iterable[Frame], thresholds: list[dict[str, float] | None]) -> list[dict]:
    """The scores of several networks on the same frames."""
    scores = [metrics.Scores(network.get_outputs()[0].shape[1] == 1, (known or {}).get("single")) for network, known in zip(networks, thresholds)]
    for frame in source:
        labels = torch.from_numpy(frame.labels)[None].float() / 255
        for network, each in zip(networks, scores):
            each.add(maps_of(network, frame), labels, [frame.meta])
    return [each.summary(known) for each, known in zip(scores, thresholds)]


def thresholds_in(summary: dict) -> dict[str, float]:
    return {name: line["threshold"] for name, line in summary["lines"].items()}


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
        thresholds = thresholds_in(json.loads(arguments.thresholds.read_text()))
    [result] = score([session(arguments.model)], frames(arguments.render, arguments.seed, arguments.frames), [thresholds])
    chosen_on = "validation frames" if thresholds else "the frames scored"
    print(json.dumps({"model": arguments.model.name, "first_seed": arguments.seed, "thresholds_chosen_on": chosen_on, **result}, indent=1))


if __name__ == "__main__":
    main()
