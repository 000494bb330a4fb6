"""Draws what a network sees: image, prediction and truth of a few frames, side by side.

    python pictures.py --run runs/boxnet [--seed 1099511627776] [--frames 6]      -> RUN/pictures.png
    python pictures.py --render COMMAND --output FILE                             frames and labels alone, and frames/s
"""

import argparse
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from losses import single_map
from stream import Frame

# The lasers red, orange, magenta, violet; spill brown; the face's edges cyan, others blue; corners white.
COLOURS = np.array(
    [[255, 0, 0], [255, 160, 0], [255, 0, 160], [160, 60, 255], [120, 80, 20], [0, 255, 255], [0, 60, 200], [0, 0, 0], [255, 255, 255]],
    np.float32,
)


def painted(maps: np.ndarray) -> np.ndarray:
    """Channels 0..1 as one colour picture; the mask is a dark green ground."""
    picture = maps[7][..., None] * np.array([0, 60, 0], np.float32)
    for channel in np.argsort(-np.arange(9)):
        if channel != 7:
            weight = maps[channel][..., None]
            picture = picture * (1 - weight) + COLOURS[channel] * weight
    return picture.clip(0, 255).astype(np.uint8)


def draw(frames: list[Frame], predictions: np.ndarray | None, path: Path) -> Path:
    """Predictions: n, channels or 1, h, w; 0..1. Without any, the labels lie over the image in their place."""
    figure, axes = plt.subplots(len(frames), 3, figsize=(13, 3.3 * len(frames)), squeeze=False, layout="constrained")
    for index, (row, frame) in enumerate(zip(axes, frames)):
        labels = frame.labels.astype(np.float32) / 255
        prediction = None if predictions is None else predictions[index]
        row[0].imshow(frame.rgb)
        if prediction is None:
            over = painted(labels).repeat(2, 0).repeat(2, 1)
            row[1].imshow(np.maximum(frame.rgb // 2, over[: frame.rgb.shape[0], : frame.rgb.shape[1]]))
            row[2].imshow(painted(labels))
        elif len(prediction) == 1:
            import torch

            row[1].imshow(prediction[0], cmap="gray", vmin=0, vmax=1)
            row[2].imshow(single_map(torch.from_numpy(labels)[None])[0, 0], cmap="gray", vmin=0, vmax=1)
        else:
            row[1].imshow(painted(prediction))
            row[2].imshow(painted(labels))
        row[0].set_title(f"seed {frame.seed}, contrast {frame.meta.get('contrast')}", fontsize=8)
        row[1].set_title("labels over the image" if prediction is None else "prediction", fontsize=8)
        row[2].set_title("truth", fontsize=8)
        for axis in row:
            axis.axis("off")
    figure.savefig(path, dpi=75)
    plt.close(figure)
    return path


def main() -> None:
    import torch

    import checkpoint
    import models
    import stream
    import train

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--render", default=stream.DEFAULT_COMMAND)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--seed", type=int, default=train.VALIDATION_SEED)
    parser.add_argument("--frames", type=int, default=6)
    arguments = parser.parse_args()
    if arguments.run is None:
        if arguments.output is None:
            parser.error("either --run or --output")
        began = time.monotonic()
        frames = list(stream.frames(arguments.render, arguments.seed, arguments.frames))
        print(f"{len(frames) / (time.monotonic() - began):.1f} frames/s with the renderer's start; meta data of the last: {frames[-1].meta}")
        print(draw(frames, None, arguments.output))
        return
    state = checkpoint.load_newest(arguments.run)
    if state is None:
        sys.exit(f"pictures: there is no checkpoint in {arguments.run}")
    options = argparse.Namespace(**state["options"])
    model = models.named(options.net, options.norm).eval()
    model.load_state_dict(state["ema"])
    frames = list(stream.frames(options.render_validation, arguments.seed, arguments.frames))
    with torch.no_grad():
        output = model(train.image_of(train.stacked(frames, torch.device("cpu"))[0]))
        predictions = train.Task(options).prediction(output).numpy()
    print(draw(frames, predictions, arguments.run / "pictures.png"))


if __name__ == "__main__":
    main()
