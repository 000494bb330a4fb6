"""What training makes small. Targets are soft labels 0..1 as the stream gives them."""

import torch
import torch.nn.functional as F

# How much more a pixel on the line weighs than one off it, by channel (stream.CHANNELS).
LINE_WEIGHT = (8.0, 8.0, 8.0, 8.0, 6.0, 6.0, 6.0, 0.0, 30.0)
CROSS_ENTROPY_SCALE = 10.0
DICE_SCALE = 0.5
POSITIVE = 0.5  # a soft label from here on is "on the edge" for the balanced loss, which knows only yes and no


def boxnet_loss(logits: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Cross entropy weighted towards the lines, and soft dice per channel over the batch."""
    logits = logits.float()
    weight = 1 + target * torch.tensor(LINE_WEIGHT, device=target.device).view(1, -1, 1, 1)
    entropy = F.binary_cross_entropy_with_logits(logits, target, weight)
    probability = logits.sigmoid()
    over = (0, 2, 3)
    dice = 1 - (2 * (probability * target).sum(over) + 1) / ((probability.square() + target.square()).sum(over) + 1)
    return CROSS_ENTROPY_SCALE * entropy + DICE_SCALE * dice.mean()


@torch.no_grad()
def frame_costs(logits: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """How far each frame is off: its cross entropy as in `boxnet_loss`."""
    weight = 1 + target * torch.tensor(LINE_WEIGHT, device=target.device).view(1, -1, 1, 1)
    return F.binary_cross_entropy_with_logits(logits.float(), target, weight, reduction="none").mean((1, 2, 3))


def single_map(labels: torch.Tensor) -> torch.Tensor:
    """The paper's one edge map: the strongest of the four lasers on the face and the face's edges (n, 1, h, w)."""
    return torch.maximum(labels[:, :4].amax(1, keepdim=True), labels[:, 5:6])


def balanced_loss(logits: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Eq. 13, the class-balanced cross entropy of HED: beta, the share of pixels off the edge, is taken per image.

    The paper sums over the pixels, which only scales its learning rate; here it is their mean.
    """
    positive = (target >= POSITIVE).float()
    beta = 1 - positive.mean((1, 2, 3), keepdim=True)
    weight = positive * beta + (1 - positive) * (1 - beta)
    return F.binary_cross_entropy_with_logits(logits.float(), positive, weight)


def side_loss(logits: list[torch.Tensor], target: torch.Tensor, deep_supervision: bool) -> torch.Tensor:
    """The fused map's loss (eqs. 14 and 15), with deep supervision also that of each side."""
    sides = [balanced_loss(each, target) for each in (logits if deep_supervision else logits[-1:])]
    return torch.stack(sides).sum()
