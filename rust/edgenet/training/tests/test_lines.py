"""Training of the network of lines. Needs torch."""

import argparse
import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import lines


def made_up(folder, faces: int, rng: np.random.Generator) -> None:
    """Faces of four sides with three lines; the right one is bright outside."""
    folder.mkdir()
    for face in range(faces):
        records = b""
        for side in range(4):
            right = rng.integers(3)
            for line in range(3):
                off_px = 0.0 if line == right else 50.0
                strip = rng.integers(0, 100, (lines.CHANNELS, lines.ROWS - 1, lines.COLUMNS), dtype=np.uint8)
                if line == right:
                    strip[:, 30:45] += 120
                head = np.array([side, off_px, 2.0, 0.0, 0.0, 0.5, 0.1], "<f4")
                records += head.tobytes() + strip.tobytes()
        (folder / f"{face}a.strips").write_bytes(records)


def test_the_right_lines_are_learned(tmp_path):
    rng = np.random.default_rng(1)
    made_up(tmp_path / "train", 24, rng)
    made_up(tmp_path / "validation", 8, rng)
    data, validation = lines.Sides([tmp_path / "train"]), lines.Sides([tmp_path / "validation"])
    assert len(data.faces) == 24 and len(data.heads) == 24 * 12 and int(data.right.sum()) == 24 * 4
    options = argparse.Namespace(seed=1, epochs=8, batch=16, lr=2e-3, decay=0.05, run=None)
    network = lines.train(data, validation, options)
    before, after = lines.scores(torch.tensor(validation.heads[:, 3]), validation), lines.scores(lines.told_by(network, validation), validation)
    assert before["loss"] == pytest.approx(math.log(3), abs=1e-3) and after["loss"] < 0.3
    assert after["right"] > 0.8


def test_probability_of_a_side_counts_all_its_right_lines():
    told, side = torch.tensor([0.0, 0.0, 0.0, 5.0, 5.0]), torch.tensor([0, 0, 0, 1, 1])
    right = torch.tensor([True, True, False, True, False])
    found = lines.log_probability(told, right, side, 2)
    assert found.tolist() == pytest.approx([math.log(2 / 3), math.log(1 / 2)], abs=1e-5)


def test_other_light_leaves_maps_and_facts_alone():
    strips = lines.check_strips()
    varied = lines.varied(strips, np.random.default_rng(3))
    mirrored = torch.equal(varied[:, :, lines.PICTURE_ROWS :], strips[:, :, lines.PICTURE_ROWS :].flip(3))
    assert mirrored or torch.equal(varied[:, :, lines.PICTURE_ROWS :], strips[:, :, lines.PICTURE_ROWS :])
    assert not torch.equal(varied, strips)


def test_the_light_of_a_scene_tells_nothing():
    network = lines.Lines().eval()
    strips = lines.check_strips() * 0.5
    darker = strips.clone()
    darker[:, :, : lines.PICTURE_ROWS] *= 0.9
    with torch.no_grad():
        assert torch.allclose(network(strips), network(darker), atol=0.05)


def test_a_file_that_is_cut_off_is_left_out(tmp_path):
    made_up(tmp_path / "train", 2, np.random.default_rng(1))
    (tmp_path / "train/1a.strips").write_bytes((tmp_path / "train/1a.strips").read_bytes()[:-5])
    assert len(lines.Sides([tmp_path / "train"]).faces) == 1
    with pytest.raises(SystemExit, match="no strips"):
        lines.Sides([tmp_path])


def test_training_goes_on_after_the_last_whole_epoch(tmp_path, capsys):
    rng = np.random.default_rng(2)
    made_up(tmp_path / "learn", 6, rng)
    data = lines.Sides([tmp_path / "learn"])
    options = argparse.Namespace(seed=1, epochs=3, batch=16, lr=2e-3, decay=0.05, run=tmp_path / "whole")
    whole = lines.train(data, data, options)
    # Stopped after two epochs: the third checkpoint is not there.
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut/step-000000002.pt").write_bytes((tmp_path / "whole/step-000000002.pt").read_bytes())
    options.run = tmp_path / "cut"
    capsys.readouterr()
    cut = lines.train(data, data, options)
    assert capsys.readouterr().out.count("epoch") == 1
    assert all(torch.equal(a, b) for a, b in zip(whole.state_dict().values(), cut.state_dict().values()))
    options.lr = 1e-3
    with pytest.raises(SystemExit, match="was started with"):
        lines.train(data, data, options)
