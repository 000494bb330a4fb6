"""Writes ihed-tiny.onnx and ihed-tiny.check.json beside this file, for ../network.rs.

    python ihed_tiny.py          (in the environment of ../../training)

A net of IHED's shape at a sixty-fourth of its width with weights that nobody trained: what is tested is that such a file loads and
gives what torch gave. The heads' weights are large, so that the map is not the same everywhere.
"""

import sys
from pathlib import Path

import torch

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "training"))

import export  # noqa: E402
import models  # noqa: E402

torch.manual_seed(4)
model = models.named("ihed64")
for head in model.heads.values():
    torch.nn.init.normal_(head.weight, std=2.0)
print(export.export(model, HERE / "ihed-tiny.onnx"))
