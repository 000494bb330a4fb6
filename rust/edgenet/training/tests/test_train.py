"""Checkpoints and the schedule. Needs torch."""

import pytest

torch = pytest.importorskip("torch")

import checkpoint
import train


def test_two_checkpoints_are_kept_and_a_damaged_one_is_passed_over(tmp_path, capsys):
    for step in (10, 20, 30):
        checkpoint.save(tmp_path, step, {"step": step, "weights": torch.ones(3)})
    assert [p.name for p in checkpoint.existing(tmp_path)] == ["step-000000030.pt", "step-000000020.pt"]
    newest = checkpoint.existing(tmp_path)[0]
    newest.write_bytes(newest.read_bytes()[:100])
    assert checkpoint.load_newest(tmp_path)["step"] == 20
    assert "cannot be read" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.tmp"))


def test_no_checkpoint_is_a_fresh_start_but_only_damaged_ones_are_an_error(tmp_path):
    assert checkpoint.load_newest(tmp_path) is None
    (tmp_path / "step-000000001.pt").write_bytes(b"")
    with pytest.raises(RuntimeError, match="none of the 1"):
        checkpoint.load_newest(tmp_path)


def test_schedule_warms_up_and_decays():
    assert train.learning_rate(4e-3, 0, 0.0) == pytest.approx(4e-3 / 60)
    assert train.learning_rate(4e-3, 100, 0.0) == pytest.approx(4e-3)
    assert train.learning_rate(4e-3, 1000, 0.5) == pytest.approx(4e-3 * 0.505)
    assert train.learning_rate(4e-3, 9000, 1.2) == pytest.approx(4e-5)


def test_halving_keeps_line_peaks_and_mask_shares():
    labels = torch.zeros(1, 9, 8, 8)
    labels[0, 0, :, 3] = 1
    labels[0, 7, :, :3] = 1
    image, smaller = train.halved(torch.ones(1, 3, 16, 16), labels)
    assert image.shape == (1, 3, 8, 8) and smaller.shape == (1, 9, 4, 4)
    assert smaller[0, 0, :, 1].eq(1).all() and smaller[0, 7, 0].tolist() == [1, 0.5, 0, 0]


def test_a_run_is_not_continued_with_another_network(tmp_path):
    options = train.parse(["--run", str(tmp_path), "--minutes", "1", "--net", "hed8", "--fake"])
    checkpoint.save(tmp_path, 1, {"options": {**vars(options), "net": "ihed8"}})
    with pytest.raises(SystemExit, match="net=ihed8"):
        train.Trainer(options)
