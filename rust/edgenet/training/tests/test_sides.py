"""Training of the network of sides. Needs torch."""

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import sides


def made_up(path, faces: int, rng: np.random.Generator) -> None:
    """Bright rectangles on dark ground; the last one's second side is not in view."""
    head = json.dumps({"format": "boxline-views/1", "w": sides.CELLS, "h": sides.CELLS, "channels": sides.CHANNELS, "bins": sides.BINS})
    with open(path, "wb") as file:
        file.write(f"{head:<127}\n".encode())
        for face in range(faces):
            bins = rng.integers(5, 90, 4)
            view = rng.integers(20, 60, (sides.CHANNELS, sides.CELLS, sides.CELLS), dtype=np.uint8)
            low, high = [sides.BINS - bins[k] for k in (0, 2)], [sides.BINS + sides.INNER + bins[k] for k in (1, 3)]
            view[:3, low[1] : high[1], low[0] : high[0]] += 120
            told = [float(b) for b in bins]
            if face == faces - 1:
                told[1] = None
            meta = json.dumps({"bins": told, "hidden": [False, False, face == 0, False]}).encode()
            file.write(face.to_bytes(8, "little") + len(meta).to_bytes(4, "little") + meta + view.tobytes())


def test_views_are_read_while_the_file_grows(tmp_path):
    path = tmp_path / "views.bin"
    made_up(path, 5, np.random.default_rng(1))
    whole = path.read_bytes()
    path.write_bytes(whole[:-1000])
    views = sides.Views(path)
    assert len(views) == 4
    path.write_bytes(whole)
    views.update()
    assert len(views) == 5 and np.isnan(views.truth(4)[0][1]) and views.truth(0)[1].tolist() == [0, 0, 1, 0]


def test_a_turned_face_has_its_sides_where_they_were_turned_to(tmp_path):
    path = tmp_path / "views.bin"
    made_up(path, 2, np.random.default_rng(2))
    views = sides.Views(path)
    for way in range(8):
        view, bins, hidden = sides.turned(views.view(0), *views.truth(0), way)
        bright = view[0] > 110
        columns, rows = np.nonzero(bright.any(0))[0], np.nonzero(bright.any(1))[0]
        found = [sides.BINS - columns[0], columns[-1] + 1 - sides.BINS - sides.INNER, sides.BINS - rows[0], rows[-1] + 1 - sides.BINS - sides.INNER]
        assert found == bins.tolist(), way
        assert hidden.sum() == 1


def test_labels_are_near_the_place_or_say_that_it_is_not_in_view():
    label = sides.labels(torch.tensor([[10.5, float("nan"), 111.9, 0.0]]))
    assert label.sum(-1)[0].tolist() == pytest.approx([1, 1, 1, 1])
    assert label[0, 0].argmax() == 10 and label[0, 1, sides.BINS] == 1 and label[0, 2].argmax() == 111


def test_the_network_can_learn_a_few_faces(tmp_path):
    path = tmp_path / "views.bin"
    made_up(path, 2, np.random.default_rng(3))
    views = sides.Views(path)
    torch.manual_seed(1)
    network = sides.SidesNet(stem=8, widths=(8, 16, 16, 16), decoder=8, along=16)
    pictures = torch.from_numpy(np.stack([views.view(i) for i in range(2)])).float() / 255
    bins, hidden = (torch.from_numpy(np.stack(part)) for part in zip(*(views.truth(i) for i in range(2))))
    optimiser = torch.optim.AdamW(network.parameters(), lr=5e-3)
    losses = []
    for _ in range(60):
        loss = sides.loss_of(network(pictures), bins, hidden)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.6 * losses[0], losses[::10]
    told = sides.scores(sides.told_by(network, views), views)
    assert told["faces"] == 2 and 0 <= told["sides right"] <= 1


def test_a_network_begun_from_a_file_says_what_the_file_does():
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    path = Path(__file__).parents[2] / "models" / "sides.onnx"
    pictures = torch.rand(4, sides.CHANNELS, sides.CELLS, sides.CELLS)
    network = sides.SidesNet()
    sides.begin_from(network, path, pictures)
    network.eval()
    with torch.no_grad():
        begun = network(pictures[:1]).numpy()
    due = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, {"view": pictures[:1].numpy()})[0]
    assert np.abs(begun - due).max() < 1e-2


def test_what_is_told_of_a_turned_view_is_turned_back(tmp_path):
    pytest.importorskip("onnxruntime")
    path = tmp_path / "views.bin"
    # The network has never seen such plain pictures and errs now and then; a side that is turned back wrongly would be right by chance only:
    # 7 bins of 112.
    faces = 16
    made_up(path, faces + 1, np.random.default_rng(3))
    views = sides.Views(path)
    model = Path(__file__).parents[2] / "models" / "sides.onnx"
    bins = np.stack([views.truth(face)[0] for face in range(faces)])
    for ways, least in [*(((way,), 0.3) for way in range(8)), (sides.WAYS, 0.8)]:
        told = sides.told_in_ways(model, views, ways)[:faces]
        right = np.abs(told[..., : sides.BINS].argmax(-1).numpy() - bins) <= 3
        assert (right.mean(0) >= least).all(), (ways, right.mean(0))
