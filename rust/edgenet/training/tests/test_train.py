"""Checkpoints and the schedule. Needs torch."""

import pytest

torch = pytest.importorskip("torch")

import curves
import checkpoint
import train
from test_ring import SMALL_FAKE


def tiny(run, *more: str) -> "train.argparse.Namespace":
    """A run on small frames that takes a second."""
    words = ["--run", str(run), "--net", "ihed8", "--render", SMALL_FAKE, "--device", "cpu", "--fp32", "--no-pictures"]
    return train.parse([*words, "--ring", "32", "--fill", "8", "--batch", "4", "--validation-frames", "4", *more])


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


def test_a_run_is_stopped_goes_on_and_ends_by_its_visits(tmp_path):
    options = tiny(tmp_path, "--sitting-visits", "40", "--validate-visits", "16")
    stop = train.threading.Event()
    trainer = train.Trainer(options)
    step = trainer.one_step

    def stopping(*arguments):
        if trainer.images >= 16:
            stop.set()
        return step(*arguments)

    trainer.one_step = stopping
    assert trainer.run(stop) is False
    state = checkpoint.load_newest(tmp_path)
    assert state["images"] == 20 and not state["finished"]
    again = train.Trainer(options)
    assert again.images == 20 and again.next_seeds == state["next_seeds"] and again.done() == 0.5
    assert again.run(train.threading.Event()) is True
    state = checkpoint.load_newest(tmp_path)
    assert state["images"] == 40 and state["finished"] and state["sitting_images"] == 40
    assert [visits for visits, _ in curves.single_f(tmp_path)] == [16, 32, 40]
    # A further sitting counts its own visits and says where it starts.
    further = train.Trainer(tiny(tmp_path, "--sitting", "2", "--sitting-visits", "8"))
    assert further.done() == 0 and further.run(train.threading.Event()) is True
    assert [visits for visits, _ in curves.single_f(tmp_path)] == [16, 32, 40, 40, 48]


def test_a_sitting_ends_by_visits_or_minutes(tmp_path):
    trainer = train.Trainer(tiny(tmp_path, "--sitting-visits", "100", "--minutes", "10"))
    trainer.sitting_images, trainer.elapsed_s = 50, 60.0
    assert trainer.done() == 0.5
    trainer.elapsed_s = 480.0
    assert trainer.done() == 0.8
    with pytest.raises(SystemExit):
        train.parse(["--run", str(tmp_path)])


def test_the_checkpoint_that_is_kept_can_go_on(tmp_path):
    shipped = train.Path(train.__file__).with_name("checkpoints") / "boxnet"
    state = checkpoint.load_newest(shipped)
    assert state["finished"] and len(state["next_seeds"]) == 1 and state["sitting_images"] > 0
    old = {"next_seed": 9, "sitting_step": 5, "images": 40, "elapsed_s": 30.0, "options": {"batch": 8, "max_images": 60, "minutes": 1.0}}
    assert not checkpoint.as_today(dict(old))["finished"]
    assert checkpoint.as_today({**old, "images": 60})["finished"]
    by_time = {**old, "options": {**old["options"], "max_images": 0}}
    assert not checkpoint.as_today(dict(by_time))["finished"] and checkpoint.as_today({**by_time, "elapsed_s": 60.0})["finished"]


def test_weights_alone_cannot_go_on(tmp_path):
    checkpoint.save(tmp_path, 1, {"ema": {}, "options": {}})
    with pytest.raises(SystemExit, match="averaged weights only"):
        train.Trainer(tiny(tmp_path, "--minutes", "1"))


@pytest.mark.parametrize("net", ["boxnet", "ihed8"])
def test_nothing_is_left_on_the_processor_when_a_gpu_trains(net):
    """Stands in for a GPU: tensors without content, which may not be mixed with the processor's."""
    from torch._subclasses.fake_tensor import FakeTensorMode

    import losses
    import models

    with FakeTensorMode(), torch.no_grad():
        with torch.device("cuda"):
            model = models.named(net)
        rgb = torch.empty(2, 64, 64, 3, dtype=torch.uint8, device="cuda")
        labels = torch.empty(2, 9, 32, 32, dtype=torch.uint8, device="cuda").float().div_(255)
        task = train.Task(train.argparse.Namespace(net=net, deep_supervision=True))
        for image, target in ((train.image_of(rgb), labels), train.halved(train.image_of(rgb), labels)):
            output = model(image)
            assert task.loss(output, target).device.type == "cuda"
            assert task.prediction(output).device.type == "cuda"
            if net == "boxnet":
                assert losses.frame_costs(output, target).device.type == "cuda"
