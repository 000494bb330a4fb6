"""Scores of predicted maps against labels, added up over frames.

Lines: both maps are thinned to ridges; a predicted ridge pixel counts as right when a true one lies within 1.5 px of it
at 256x192 (its eight neighbours), and the other way round for recall. F is given at the best of a fixed set of
thresholds, which is chosen on the frames scored: on validation frames, that is how the threshold is found; scores on
test frames take that threshold as an argument.
"""

from collections import defaultdict

import numpy as np
import torch
import torch.nn.functional as F

from losses import single_map
from stream import CHANNELS

KEY_POINT_NEAR_PX = 4.0  # label pixels: what lies so near to a true line may be taken for it
KEY_POINT_APART_PX = 3.0  # and so near to the other line may be either
EDGE_REACH_PX, LASER_REACH_PX = 10.0, 40.0  # how far from a key point its two lines are looked at
KEY_POINT_PIXELS = 6  # least number of pixels of a line
LINE_SPREAD_PX = 1.5  # rms from their line; pixels spread evenly over what is near a true line would have 2.3 and lie on it by chance
THRESHOLDS = torch.arange(0.1, 0.91, 0.05)
LINE_CHANNELS = tuple(c for c in CHANNELS if c not in ("face_mask", "corner"))
LINE_FITTED_FROM = 0.3  # pixels of a laser map from here on vote in its line fit
NET_SCALE = 2.0  # network input pixels per label pixel; line errors are given in input pixels
NO_CONTRAST = (None,) * 4
CONTRAST_BINS = (("dim", 0.0, 30.0), ("mid", 30.0, 100.0), ("bright", 100.0, float("inf")))


def thinned(maps: torch.Tensor) -> torch.Tensor:
    """The map where it is a ridge, else 0 (n, c, h, w): not below its neighbours across the direction of least curvature."""
    n, c, h, w = maps.shape
    flat = maps.reshape(n * c, 1, h, w)
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    smooth = F.conv2d(F.pad(flat, (2, 2, 2, 2), mode="replicate"), (kernel[:, None] * kernel)[None, None])
    padded = F.pad(smooth, (1, 1, 1, 1), mode="replicate")
    shifted = lambda dy, dx: padded[..., 1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w]
    second = torch.stack(
        [
            shifted(0, -1) + shifted(0, 1) - 2 * smooth,
            (shifted(-1, -1) + shifted(1, 1) - 2 * smooth) / 2,
            shifted(-1, 0) + shifted(1, 0) - 2 * smooth,
            (shifted(-1, 1) + shifted(1, -1) - 2 * smooth) / 2,
        ]
    )
    most = second.amin(0)  # most negative: the line is crossed in this direction
    keep = torch.zeros_like(smooth, dtype=torch.bool)
    for direction, (dy, dx) in enumerate(((0, 1), (1, 1), (1, 0), (1, -1))):
        ridge = (smooth > shifted(dy, dx)) & (smooth >= shifted(-dy, -dx))
        keep |= (second[direction] == most) & ridge & (most < 0)
    return (flat * keep).reshape(n, c, h, w)


def dilated(maps: torch.Tensor) -> torch.Tensor:
    """Each pixel's maximum over its eight neighbours and itself: a reach of 1.5 px."""
    return F.max_pool2d(maps, 3, 1, 1)


class LineCounts:
    """Right and wrong pixels of one kind of line at every threshold."""

    def __init__(self) -> None:
        self.predicted = self.right = self.found = torch.zeros(len(THRESHOLDS), dtype=torch.float64)
        self.true = 0.0

    def add(self, prediction: torch.Tensor, near_prediction: torch.Tensor, truth: torch.Tensor, near_truth: torch.Tensor) -> None:
        """Thinned prediction, the same dilated; thinned truth as yes and no, the same dilated."""
        at_least = lambda values: (values.flatten()[:, None] >= THRESHOLDS).sum(0).double()
        drawn = prediction[prediction >= THRESHOLDS[0]]
        self.predicted = self.predicted + at_least(drawn)
        self.right = self.right + at_least(prediction[near_truth & (prediction >= THRESHOLDS[0])])
        self.found = self.found + at_least(near_prediction[truth])
        self.true += float(truth.sum())

    def scores(self, threshold: float | None = None) -> dict[str, float]:
        precision = self.right / self.predicted.clamp(min=1)
        recall = self.found / max(self.true, 1.0)
        f = 2 * precision * recall / (precision + recall).clamp(min=1e-9)
        best = int(f.argmax()) if threshold is None else int((THRESHOLDS - threshold).abs().argmin())
        values = {"f": f[best], "precision": precision[best], "recall": recall[best], "threshold": THRESHOLDS[best]}
        return {key: round(float(value), 4) for key, value in values.items()}


def fitted_line(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Centre, direction and (smallest, largest) extent along it of a line through a map; refitted without far pixels."""
    ys, xs = np.nonzero(weights >= LINE_FITTED_FROM)
    if len(xs) < 12:
        return None
    points, weight = np.stack([xs, ys], 1).astype(float), weights[ys, xs].astype(float)
    for reach_px in (np.inf, 12.0, 4.0, 2.0, 2.0):
        if reach_px < np.inf:
            offset = points - centre
            near = np.abs(offset @ np.array([-direction[1], direction[0]])) < reach_px
            if near.sum() < 12:
                return None
        else:
            near = np.ones(len(points), bool)
        centre = np.average(points[near], axis=0, weights=weight[near])
        spread = (points[near] - centre) * np.sqrt(weight[near])[:, None]
        direction = np.linalg.eigh(spread.T @ spread)[1][:, 1]
    along = (points[near] - centre) @ direction
    return centre, direction, np.array([along.min(), along.max()])


def line_error_px(prediction: np.ndarray, truth: np.ndarray) -> float | None:
    """How far the predicted laser line is from the ends of the true one, the larger of both, in input pixels.

    None if there is no true line long enough to have a direction; infinite if there is one but none was predicted.
    """
    true = fitted_line(truth)
    if true is None:
        return None
    found = fitted_line(prediction)
    if found is None:
        return float("inf")
    ends = true[0] + true[2][:, None] * true[1]
    normal = np.array([-found[1][1], found[1][0]])
    return NET_SCALE * float(np.abs((ends - found[0]) @ normal).max())


def straight_line(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Centre, direction and weighted rms distance of the line through points (n, 2)."""
    if len(points) < KEY_POINT_PIXELS:
        return None
    centre = np.average(points, axis=0, weights=weight)
    offset = points - centre
    spread = offset * np.sqrt(weight)[:, None]
    direction = np.linalg.eigh(spread.T @ spread)[1][:, 1]
    across = offset @ np.array([-direction[1], direction[0]])
    return centre, direction, float(np.sqrt(np.average(across**2, weights=weight)))


def crossing(one: tuple, other: tuple) -> np.ndarray | None:
    """Where two lines meet, if they do so at more than 20 degrees."""
    (p, d), (q, e) = one[:2], other[:2]
    sine = d[0] * e[1] - d[1] * e[0]
    if abs(sine) < 0.34:
        return None
    return p + d * (((q - p)[0] * e[1] - (q - p)[1] * e[0]) / sine)


def key_points(single: np.ndarray, lasers: np.ndarray, face_edge: np.ndarray, threshold: float) -> tuple[list[np.ndarray], int]:
    """Errors (x, y; input pixels) of the key points that a thinned single map gives, and how many there are in truth.

    Which line is which comes from the truth (h, w; lasers 4, h, w), where it lies from the map: the same for every network.
    A key point is where a laser's line meets an edge of the face; where the labels do not tell it (a corner near by,
    something in front) it is left out.
    """
    ys, xs = np.nonzero(single >= threshold)
    drawn, weight = np.stack([xs, ys], 1).astype(float), single[ys, xs].astype(float)
    ys, xs = np.nonzero(face_edge >= LINE_FITTED_FROM)
    edge_points, edge_weight = np.stack([xs, ys], 1).astype(float), face_edge[ys, xs].astype(float)
    errors, count = [], 0
    for laser in lasers:
        true = fitted_line(laser)
        if true is None:
            continue
        laser_normal = np.array([-true[1][1], true[1][0]])
        for end, inward in zip(true[0] + true[2][:, None] * true[1], (1.0, -1.0)):
            near = np.hypot(*(edge_points - end).T) < EDGE_REACH_PX
            edge = straight_line(edge_points[near], edge_weight[near])
            point = crossing(true, edge) if edge is not None and edge[2] <= 1.0 else None
            if point is None or np.hypot(*(point - end)) > KEY_POINT_NEAR_PX:
                continue
            count += 1
            edge_normal = np.array([-edge[1][1], edge[1][0]])
            offset = drawn - point
            to_laser, to_edge = np.abs(offset @ laser_normal), np.abs(offset @ edge_normal)
            along = inward * (offset @ true[1])
            on_laser = (to_laser < KEY_POINT_NEAR_PX) & (to_edge > KEY_POINT_APART_PX) & (along > 0) & (along < LASER_REACH_PX)
            on_edge = (to_edge < KEY_POINT_NEAR_PX) & (to_laser > KEY_POINT_APART_PX) & (np.abs(offset @ edge[1]) < EDGE_REACH_PX)
            lines = [straight_line(drawn[part], weight[part]) for part in (on_laser, on_edge)]
            clear = all(line is not None and line[2] <= LINE_SPREAD_PX for line in lines)
            found = crossing(*lines) if clear else None
            if found is not None:
                errors.append(NET_SCALE * (found - point))
    return errors, count


def contrast_bin(contrast: float | None) -> str | None:
    """None where this laser is not on the face (0), or the renderer does not say."""
    if not contrast:
        return None
    return next(name for name, low, high in CONTRAST_BINS if low <= contrast < high)


class Scores:
    """All scores of a network over the frames given to `add`."""

    def __init__(self, single: bool = False, key_point_threshold: float | None = None) -> None:
        """Key points are scored if the threshold of the single map is given, which is chosen beforehand."""
        self.key_point_threshold = key_point_threshold
        self.key_point_errors: list[np.ndarray] = []
        self.true_key_points = 0
        self.single = single  # the network gives the paper's one map only
        self.lines: dict[str, LineCounts] = defaultdict(LineCounts)
        self.iou: list[float] = []
        self.mask_without_face: list[float] = []
        self.line_errors: dict[str, list[float]] = defaultdict(list)
        self.worst_of_four: list[float] = []
        self.frames = 0

    def add(self, prediction: torch.Tensor, labels: torch.Tensor, metas: list[dict]) -> None:
        """Probabilities (n, channels or 1, h, w), labels 0..1 (n, channels, h, w)."""
        self.frames += len(labels)
        truth_map = single_map(labels)
        predicted_map = prediction if self.single else single_map(prediction)
        self._add_lines("single", predicted_map, truth_map)
        if self.key_point_threshold is not None:
            for drawn, label in zip(thinned(predicted_map)[:, 0].numpy(), labels.numpy()):
                errors, count = key_points(drawn, label[:4], label[5], self.key_point_threshold)
                self.key_point_errors += errors
                self.true_key_points += count
        if self.single:
            return
        any_laser = lambda maps: maps[:, :4].amax(1, keepdim=True)
        self._add_lines("any_laser", any_laser(prediction), any_laser(labels))
        self._add_lines("any_edge", prediction[:, 5:7].amax(1, keepdim=True), labels[:, 5:7].amax(1, keepdim=True))
        for channel in LINE_CHANNELS:
            index = CHANNELS.index(channel)
            bins = None
            if index < 4:
                bins = [contrast_bin((m.get("contrast") or NO_CONTRAST)[index]) for m in metas]
            self._add_lines(channel, prediction[:, index : index + 1], labels[:, index : index + 1], bins)
        self._add_mask(prediction[:, 7] >= 0.5, labels[:, 7] >= 0.5)
        for frame in range(len(labels)):
            self._add_fits(prediction[frame, :4].numpy(), labels[frame, :4].numpy(), metas[frame])

    def _add_lines(self, name: str, prediction: torch.Tensor, truth: torch.Tensor, bins: list[str | None] | None = None) -> None:
        thin_prediction, thin_truth = thinned(prediction), thinned(truth) >= 0.4
        near_prediction, near_truth = dilated(thin_prediction), dilated(thin_truth.float()) > 0
        self.lines[name].add(thin_prediction, near_prediction, thin_truth, near_truth)
        for frame, key in enumerate(bins or []):
            if key:
                parts = (each[frame] for each in (thin_prediction, near_prediction, thin_truth, near_truth))
                self.lines[f"laser_{key}"].add(*parts)

    def _add_mask(self, prediction: torch.Tensor, truth: torch.Tensor) -> None:
        over = (1, 2)
        both, either = (prediction & truth).sum(over), (prediction | truth).sum(over)
        for has_face, shared, union, share in zip(truth.any(2).any(1), both, either, prediction.float().mean(over)):
            if has_face:
                self.iou.append(float(shared / union))
            else:
                self.mask_without_face.append(float(share))

    def _add_fits(self, prediction: np.ndarray, truth: np.ndarray, meta: dict) -> None:
        errors = [line_error_px(*pair) for pair in zip(prediction, truth)]
        contrast = meta.get("contrast") or NO_CONTRAST
        for error, level in zip(errors, contrast):
            if error is not None:
                self.line_errors["all"].append(error)
                if name := contrast_bin(level):
                    self.line_errors[name].append(error)
        if None not in errors and meta.get("measurable", True):
            self.worst_of_four.append(max(errors))
            if None not in contrast and min(contrast) >= CONTRAST_BINS[1][1]:
                self.line_errors["four_not_dim"].append(max(errors))

    def summary(self, thresholds: dict[str, float] | None = None) -> dict:
        result: dict = {"frames": self.frames, "lines": {}}
        for name, counts in self.lines.items():
            result["lines"][name] = counts.scores((thresholds or {}).get(name))
        if self.key_point_threshold is not None:
            result["key_points_px"] = key_point_summary(self.key_point_errors, self.true_key_points)
        if self.single:
            return result
        share = lambda values, limit: round(float(np.mean(np.array(values) < limit)), 4) if values else None
        at = lambda values, q: round(min(float(np.quantile(values, q, method="higher")), 999.0), 3) if values else None
        lasers = [result["lines"][c]["f"] for c in CHANNELS[:4]]
        result["laser_f"] = round(sum(lasers) / 4, 4)
        result["mask_iou_mean"] = round(float(np.mean(self.iou)), 4) if self.iou else None
        result["mask_iou_median"] = at(self.iou, 0.5)
        result["mask_share_without_face"] = round(float(np.mean(self.mask_without_face)), 4) if self.mask_without_face else None
        result["line_px"] = {
            name: {"n": len(v), "median": at(v, 0.5), "p90": at(v, 0.9), "below_2": share(v, 2)}
            for name, v in self.line_errors.items()
            if name != "four_not_dim"
        }
        result["four_lasers_below_2px"] = share(self.worst_of_four, 2)
        result["four_lasers_below_2px_not_dim"] = share(self.line_errors["four_not_dim"], 2)
        return result


def key_point_summary(errors: list[np.ndarray], count: int) -> dict:
    """Signed: differences averaged with their signs, as in eq. 21, where opposite ones cancel. Unsigned: mean distance."""
    if not errors:
        return {"n": count, "found": 0.0, "signed": None, "unsigned": None, "p90": None}
    all_errors = np.stack(errors)
    distance = np.hypot(*all_errors.T)
    return {
        "n": count,
        "found": round(len(errors) / count, 4),
        "signed": [round(float(v), 3) for v in all_errors.mean(0)],
        "unsigned": round(float(distance.mean()), 3),
        "p90": round(float(np.quantile(distance, 0.9, method="higher")), 3),
    }


def short(summary: dict) -> str:
    """One line for a person."""
    f = {name: line["f"] for name, line in summary["lines"].items()}
    if "laser_f" not in summary:
        return f"single-map F {f['single']:.3f}"
    line = summary["line_px"].get("all", {})
    return (
        f"laser F {summary['laser_f']:.3f} (any {f['any_laser']:.3f}), edge F {f['face_edge']:.3f}, IoU {summary['mask_iou_mean']}, "
        f"line px median {line.get('median')} p90 {line.get('p90')}, four < 2 px {summary['four_lasers_below_2px']}"
    )
