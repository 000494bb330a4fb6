"""Writes a run's averaged weights as an ONNX file, checks it against torch, and starts its model card.

    python export.py --run runs/boxnet --output ../models/boxnet.onnx

Batch normalisation is folded into the convolutions; the graph takes `image` (1, 3, 384, 512; RGB 0..1) and gives `maps`
(1, channels, 192, 256; probabilities), or the paper's averaged map at the input's size for HED and IHED. Beside the file go
its card (.md) and, as .check.json, some of torch's outputs on a made-up picture, with which the Rust tests compare.
"""

import argparse
import datetime
import hashlib
import json
import shlex
import sys
import warnings
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

import checkpoint
import fake
import models
from ring import LANE_SEEDS
from stream import CHANNELS, Format

OPSET = 17
LARGEST_DIFFERENCE = 1e-4
CHECK_STEP = 16  # every so many rows and columns of the outputs are kept


def folded(model: nn.Module) -> nn.Module:
    """The model with every convolution followed by a batch normalisation made one convolution; in evaluation mode."""
    model.eval()
    for module in model.modules():
        if not isinstance(module, nn.Sequential):
            continue
        layers = list(module.named_children())
        for (name, layer), (after, norm) in zip(layers, layers[1:]):
            if isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                setattr(module, name, fuse_conv_bn_eval(layer, norm))
                setattr(module, after, nn.Identity())
    return model


class Exported(nn.Module):
    """Probabilities instead of logits; of HED and IHED the average of eq. 16, or the fused map alone."""

    def __init__(self, model: nn.Module, fused_only: bool = False):
        super().__init__()
        self.model = model
        self.fused_only = fused_only

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        output = self.model(image)
        if self.fused_only:
            return output[-1].sigmoid()
        return models.averaged(output) if isinstance(output, list) else output.sigmoid()


def check_image(width: int, height: int) -> np.ndarray:
    """A face with stripes in whole numbers, the same as in ../tests/network.rs (1, 3, height, width; 0..1)."""
    c, y, x = np.meshgrid(np.arange(3), np.arange(height), np.arange(width), indexing="ij")
    inside = (x >= 120) & (x < 400) & (y >= 70) & (y < 320)
    base = np.where(inside, np.array([190, 150, 110])[c], np.array([60, 70, 80])[c])
    down, up = (x + y) % 512, (x + 500 - y) % 512
    stripe = (down == 390) | (down == 470) | (up == 380) | (up == 40)
    levels = base + 60 * (stripe & (c == 0)) + (x * 7 + y * 13 + (x * y) % 31) % 23
    return (np.minimum(levels, 255) / 255).astype(np.float32)[None]


def export(model: nn.Module, path: Path, width: int = 512, height: int = 384, fused_only: bool = False) -> float:
    """Writes the file and returns the largest difference of its outputs to the unfolded model's in torch."""
    image = torch.from_numpy(fake.scene(7, Format(width, height, width // 2, height // 2, len(CHANNELS))).rgb.copy())
    image = image.permute(2, 0, 1)[None].float().div(255).contiguous()
    with torch.no_grad():
        expected = Exported(model.eval(), fused_only)(image).numpy()
        kept = Exported(model, fused_only)(torch.from_numpy(check_image(width, height)))[0, :, ::CHECK_STEP, ::CHECK_STEP]
    exported = Exported(folded(model), fused_only).eval().to(memory_format=torch.contiguous_format)
    path.parent.mkdir(parents=True, exist_ok=True)
    check = {"step": CHECK_STEP, "values": [round(v, 6) for v in kept.flatten().tolist()]}
    path.with_suffix(".check.json").write_text(json.dumps(check) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that sizes become constants, which is wanted; that the exporter is the old one
        torch.onnx.export(
            exported, (image,), str(path), input_names=["image"], output_names=["maps"], opset_version=OPSET, dynamo=False
        )
    onnx.checker.check_model(onnx.load(str(path)), full_check=True)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return float(np.abs(session.run(None, {"image": image.numpy()})[0] - expected).max())


def card(path: Path, state: dict, validation: dict | None, difference: float) -> str:
    """What is known about the weights; what is not known says so."""
    options = state["options"]
    command = " ".join(Path(word).name if word.startswith("/") else word for word in shlex.split(options["render"]))
    data = "crude test scenes" if "fake.py" in command else f"`{command}`"
    starts = [options["seed"] + lane * LANE_SEEDS for lane in range(len(state["next_seeds"]))]
    seeds = ", ".join(f"{first} to {after - 1}" for first, after in zip(starts, state["next_seeds"]) if after > first)
    lines = [
        f"# {path.stem}",
        "",
        f"- Network: {options['net']}" + ("" if options["net"] == "boxnet" else f", batch normalisation {options['norm']}, deep supervision {options['deep_supervision']}"),
        f"- File: {path.name}, {path.stat().st_size} bytes, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}",
        f"- Date: {datetime.date.today().isoformat()}",
        f"- Data: {data}; {state['distinct']} distinct frames, seeds {seeds}",
        f"- Training: {state['step']} steps, {state['images']} image visits, {state['total_s'] / 3600:.2f} h, sitting {state['sitting']}, peak learning rate {options['lr']}",
        f"- Largest difference between this file in ONNX Runtime and torch on one frame: {difference:.2e}",
        "- Licence: Apache-2.0, as the repository. The photographs that textured training frames have licences of their own (photos.sh); none is in this file.",
        "- Not shown by these numbers: anything about real photographs.",
        "",
    ]
    if validation:
        lines += [f"## Validation: {validation['frames']} held-out frames, thresholds chosen on them", "", "```json", json.dumps(validation, indent=1), "```"]
    else:
        lines += ["Not validated."]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    state = checkpoint.load_newest(arguments.run)
    if state is None:
        sys.exit(f"export: there is no checkpoint in {arguments.run}")
    model = models.named(state["options"]["net"], state["options"]["norm"])
    model.load_state_dict(state["ema"])
    difference = export(model, arguments.output)
    scores = arguments.run / "validation.json"
    validation = json.loads(scores.read_text()) if scores.exists() else None
    arguments.output.with_suffix(".md").write_text(card(arguments.output, state, validation, difference))
    print(f"export: {arguments.output}, {arguments.output.stat().st_size} bytes, largest difference {difference:.2e}")
    if difference > LARGEST_DIFFERENCE:
        sys.exit(f"export: the difference to torch is {difference:.2e}, more than {LARGEST_DIFFERENCE:.0e}")


if __name__ == "__main__":
    main()
