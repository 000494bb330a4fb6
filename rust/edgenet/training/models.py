"""The networks: BoxNet, which ships, and the paper's IHED beside HED for comparison.

    python models.py        prints parameters and multiply-accumulates of all of them
"""

import torch
import torch.nn.functional as F
from torch import nn

from stream import CHANNELS

COMPARED_SIDE_PX = 512  # the paper's input is this square; MACs of its networks are counted at it


class ConvNorm(nn.Sequential):
    """3x3 convolution and batch normalisation."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, size: int = 3):
        super().__init__(nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False), nn.BatchNorm2d(outputs))


class Residual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int):
        super().__init__()
        self.first = ConvNorm(inputs, outputs, stride)
        self.second = ConvNorm(outputs, outputs)
        plain = inputs == outputs and stride == 1
        self.shortcut = nn.Identity() if plain else ConvNorm(inputs, outputs, stride, size=1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return F.relu(self.second(F.relu(self.first(x))) + self.shortcut(x))


def coordinate_planes(like: torch.Tensor) -> torch.Tensor:
    """x and y of each pixel of a feature map, -1..1 over the map; constants in an exported graph."""
    height, width = int(like.shape[-2]), int(like.shape[-1])
    y = ((torch.arange(height, device=like.device) + 0.5) * (2 / height) - 1).view(1, 1, height, 1).expand(1, 1, height, width)
    x = ((torch.arange(width, device=like.device) + 0.5) * (2 / width) - 1).view(1, 1, 1, width).expand(1, 1, height, width)
    return torch.cat((x, y), 1).to(like.dtype)


class BoxNet(nn.Module):
    """A plain residual U-Net: RGB 0..1 in, one logit per channel at half the input's size out.

    A 3x3 stem of stride 2, five stages of residual blocks from 1/2 to 1/32, an additive decoder with nearest upsampling.
    Two planes with the coordinates are appended where the stage at 1/8 starts (`coordinates_at=3`) or to the
    image (0, more operations and a larger file).
    """

    def __init__(
        self,
        widths: tuple[int, ...] = (16, 24, 32, 64, 96),
        blocks: tuple[int, ...] = (1, 1, 2, 2, 2),
        decoder: int = 24,
        outputs: int = len(CHANNELS),
        coordinates_at: int = 3,
    ):
        super().__init__()
        self.coordinates_at = coordinates_at
        extra = [2 if coordinates_at == stage else 0 for stage in range(len(widths) + 1)]
        self.stem = ConvNorm(3 + extra[0], widths[0], stride=2)
        self.stages = nn.ModuleList()
        inputs = widths[0]
        for number, (width, count) in enumerate(zip(widths, blocks), start=1):
            first = Residual(inputs + extra[number], width, stride=1 if number == 1 else 2)
            self.stages.append(nn.Sequential(first, *(Residual(width, width, 1) for _ in range(count - 1))))
            inputs = width
        self.laterals = nn.ModuleList(ConvNorm(width, decoder, size=1) for width in widths)
        self.smooth = nn.ModuleList(ConvNorm(decoder, decoder) for _ in widths)
        self.head = nn.Conv2d(decoder, outputs, 3, padding=1)
        nn.init.constant_(self.head.bias, -3.0)  # most pixels belong to no line

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        x = self.with_coordinates(image, 0)
        x = F.relu(self.stem(x))
        features = []
        for number, stage in enumerate(self.stages, start=1):
            x = stage(self.with_coordinates(x, number))
            features.append(x)
        x = None
        for feature, lateral, smooth in zip(reversed(features), reversed(self.laterals), reversed(self.smooth)):
            here = lateral(feature)
            x = here if x is None else here + F.interpolate(x, scale_factor=2.0, mode="nearest")
            x = F.relu(smooth(F.relu(x)))
        return self.head(x)

    def with_coordinates(self, x: torch.Tensor, number: int) -> torch.Tensor:
        if number != self.coordinates_at:
            return x
        return torch.cat((x, coordinate_planes(x).expand(x.shape[0], -1, -1, -1)), 1)


class SideNet(nn.Module):
    """HED and the paper's IHED: a VGG16 trunk, side outputs brought to the input's size, their weighted fusion.

    HED takes a side output from each of the five stages; IHED cuts sides 1 and 2 (section 3.4). `divisor` divides the
    trunk's widths. The result is a list of logits [side, ..., fused], each with the input's size. The trunk has no
    batch normalisation in the paper; `norm` adds it.
    """

    TRUNK = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))

    def __init__(self, sides: tuple[int, ...] = (3, 4, 5), divisor: int = 1, norm: bool = False):
        super().__init__()
        self.sides = sides
        self.stages = nn.ModuleList()
        inputs = 3
        for number, (width, count) in enumerate(self.TRUNK, start=1):
            layers: list[nn.Module] = [nn.MaxPool2d(2)] if number > 1 else []
            for _ in range(count):
                width_here = width // divisor
                layers.append(nn.Conv2d(inputs, width_here, 3, padding=1, bias=not norm))
                layers += [nn.BatchNorm2d(width_here)] if norm else []
                layers.append(nn.ReLU(inplace=True))
                inputs = width_here
            self.stages.append(nn.Sequential(*layers))
        self.heads = nn.ModuleDict({str(n): nn.Conv2d(self.TRUNK[n - 1][0] // divisor, 1, 1) for n in sides})
        self.fuse = nn.Conv2d(len(sides), 1, 1)
        for module in self.stages.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        for head in self.heads.values():
            nn.init.normal_(head.weight, std=0.01)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.fuse.weight, 1 / len(sides))
        nn.init.zeros_(self.fuse.bias)

    def forward(self, image: torch.Tensor) -> list[torch.Tensor]:
        x = (image - 0.45) / 0.25
        outputs = []
        for number, stage in enumerate(self.stages, start=1):
            x = stage(x)
            if number in self.sides:
                side = self.heads[str(number)](x)
                outputs.append(side if number == 1 else F.interpolate(side, size=image.shape[-2:], mode="bilinear", align_corners=False))
        return [*outputs, self.fuse(torch.cat(outputs, 1))]


def averaged(logits: list[torch.Tensor]) -> torch.Tensor:
    """The paper's output, eq. 16: the mean of the side maps and the fused map (probabilities)."""
    return torch.stack([each.float().sigmoid() for each in logits]).mean(0)


def named(name: str, norm: bool = False) -> nn.Module:
    """boxnet, ihed, ihed4, ihed8, hed, hed4, hed8: the number divides the widths."""
    if name == "boxnet":
        return BoxNet()
    for prefix, sides in (("ihed", (3, 4, 5)), ("hed", (1, 2, 3, 4, 5))):
        if name.startswith(prefix) and (name[len(prefix) :] or "1").isdigit():
            return SideNet(sides, int(name[len(prefix) :] or "1"), norm)
    raise ValueError(f"no network is called {name}; there are boxnet, ihed, ihed4, ihed8, hed, hed4, hed8")


def parameters(model: nn.Module) -> int:
    return sum(p.numel() for p in model.parameters())


def macs(model: nn.Module, height: int, width: int) -> int:
    """Multiply-accumulates of the convolutions for one image."""
    total = 0

    def count(conv: nn.Conv2d, _inputs: object, output: torch.Tensor) -> None:
        nonlocal total
        total += output.shape[-2] * output.shape[-1] * conv.weight.numel()

    hooks = [m.register_forward_hook(count) for m in model.modules() if isinstance(m, nn.Conv2d)]
    training = model.training
    with torch.no_grad():
        model.eval()(torch.zeros(1, 3, height, width))
    model.train(training)
    for hook in hooks:
        hook.remove()
    return total


def main() -> None:
    print(f"{'network':34}{'M params':>10}{'GMAC':>8}  input")
    for label, model, height, width in [
        ("boxnet", BoxNet(), 384, 512),
        ("boxnet, coordinates at the input", BoxNet(coordinates_at=0), 384, 512),
        *((name, named(name), COMPARED_SIDE_PX, COMPARED_SIDE_PX) for name in ("ihed", "ihed4", "ihed8", "hed", "hed4", "hed8")),
    ]:
        print(f"{label:34}{parameters(model) / 1e6:10.3f}{macs(model, height, width) / 1e9:8.3f}  {width}x{height}")


if __name__ == "__main__":
    main()
