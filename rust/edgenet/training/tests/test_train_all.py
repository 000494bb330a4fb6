"""All networks one after another, and the page that compares them. Needs torch."""

import json
import sys
import tarfile

import pytest

torch = pytest.importorskip("torch")

import checkpoint
import comparison
import models
import stream
import train
import train_all
from test_ring import SMALL_FAKE


def options(tmp_path, *more: str):
    return train_all.parse(["--run", str(tmp_path), "--device", "cpu", "--fake", *more])


def test_networks_are_trained_in_turn_and_those_that_are_over_passed_over(tmp_path, capsys):
    parsed = options(tmp_path, "--only", "ihed8-fused-seed1,hed4-deep", "--visits", "16", "--ring", "300")
    jobs = train_all.wanted(parsed)
    assert [job.name for job in jobs] == ["hed4-deep", "ihed8-fused-seed1"]  # in order of worth
    assert train_all.train_jobs(jobs[1:], parsed, SMALL_FAKE)
    state = checkpoint.load_newest(tmp_path / "ihed8-fused-seed1")
    assert state["finished"] and state["images"] == 16 and not state["options"]["deep_supervision"] and state["options"]["seed"] == 10_000_000
    capsys.readouterr()
    assert train_all.train_jobs(jobs[1:], parsed, "no such renderer")
    assert capsys.readouterr().out == "train_all: ihed8-fused-seed1 is over\n"


def test_with_minutes_all_share_one_ring(tmp_path, monkeypatch):
    parsed = options(tmp_path, "--only", "ihed8-fused-seed1,ihed8-fused-seed2,ihed8-fused-seed3", "--visits", "16", "--minutes", "5", "--ring", "300")
    rings = []
    own = train.Trainer.own_ring
    monkeypatch.setattr(train.Trainer, "own_ring", lambda self: rings.append(own(self)) or rings[-1])
    assert train_all.train_jobs(train_all.wanted(parsed), parsed, SMALL_FAKE)
    assert len(rings) == 1 and rings[0].stopping
    states = [checkpoint.load_newest(tmp_path / f"ihed8-fused-seed{n}") for n in (1, 2, 3)]
    assert all(state["finished"] and state["images"] == 16 for state in states)


def test_options_of_each_network(tmp_path):
    jobs = {job.name: job for job in train_all.jobs(False)}
    parsed = options(tmp_path)
    boxnet = train_all.train_options(jobs["boxnet"], parsed, "r", 1.0)
    shipped = checkpoint.load_newest(train_all.SHIPPED)
    assert boxnet.sitting == shipped["sitting"] + 1 and boxnet.half_share == 0 and boxnet.lr == 2e-3 and boxnet.sitting_visits == 60_000
    parsed.gpu, parsed.minutes = True, 10
    assert train_all.train_options(jobs["boxnet"], parsed, "r", 1.5).sitting_visits == 0  # all of its time
    side = train_all.train_options(jobs["ihed4-fused"], parsed, "r", 1.5)
    assert (side.batch, side.sitting_visits, side.minutes) == (16, 60_000, 1.5) and side.lr == pytest.approx(1e-3 * 2**0.5)
    assert not train_all.over(tmp_path / "none", 1)


def test_full_width_needs_a_gpu_or_weights_to_start_from(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train_all.importlib.util, "find_spec", lambda _: None)
    parsed = options(tmp_path)
    assert not any(job.full_width for job in train_all.wanted(parsed))
    assert "hed-full is left out" in capsys.readouterr().out
    parsed.gpu = True
    assert sum(job.full_width for job in train_all.wanted(parsed)) == 2
    with pytest.raises(SystemExit):
        options(tmp_path, "--only", "ihed5")


def run_of(folder, net: str, visits: int, finished: bool = True, **more) -> None:
    """A run with weights of a fresh network."""
    model = models.named(net)
    trained = {**vars(train.parse(["--run", str(folder), "--minutes", "1", "--net", net, "--no-deep-supervision", "--fake"])), "run": str(folder)}
    state = {"step": visits // 8, "images": visits, "finished": finished, "sitting": 1, "options": trained, "ema": model.state_dict()}
    state |= {"model": model.state_dict(), "optimizer": {}, "torch_rng": 0, "next_seeds": [9], "distinct": 8, "total_s": 1.0}
    checkpoint.save(folder, visits // 8, {**state, **more})
    points = [{"step": n // 8, "images": n, "validation": {"lines": {"single": {"f": 0.5 * n / visits}}}} for n in (visits // 2, visits)]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(point) + "\n" for point in points))


def compare(monkeypatch, tmp_path) -> str:
    words = ["--runs", str(tmp_path / "runs"), "--render", stream.FAKE_COMMAND, "--render-validation", stream.FAKE_COMMAND]
    words += ["--frames", "2", "--validation-frames", "1", "--output", str(tmp_path / "page"), "--shipped", str(tmp_path / "runs/ihed8-fused-seed1")]
    monkeypatch.setattr(sys, "argv", ["comparison.py", *words])
    comparison.main()
    return (tmp_path / "page/COMPARISON.md").read_text()


def test_the_page_has_unfinished_runs_and_kept_scores(monkeypatch, tmp_path):
    runs = tmp_path / "runs"
    run_of(runs / "ihed8-fused-seed1", "ihed8", 800)
    run_of(runs / "ihed8-fused-seed2", "ihed8", 400, finished=False)
    page = compare(monkeypatch, tmp_path)
    assert "| IHED 1/8, fused loss, seed 1 | 800 |" in page and "| IHED 1/8, fused loss, seed 2 | 400 (goes on) |" in page
    assert "- HED full width, deep supervision: not trained." in page
    curves = (tmp_path / "page/docs/curves.svg").read_text()
    assert "IHED 1/8, fused loss, seed 2, goes on" in curves and len(curves) < 100_000
    # Without its weights, the scores that were kept are shown, and nothing is scored again.
    state = checkpoint.load_newest(runs / "ihed8-fused-seed2")
    del state["ema"]
    checkpoint.save(runs / "ihed8-fused-seed2", 50, state)
    with monkeypatch.context() as patch:
        patch.setattr(comparison, "score_files", lambda *_: pytest.fail("scored again"))
        assert compare(monkeypatch, tmp_path) == page
    # Other weights are scored anew; a run without weights whose scores are of another checkpoint is left out and named.
    checkpoint.save(runs / "ihed8-fused-seed2", 51, {**state, "step": 51})
    page = compare(monkeypatch, tmp_path)
    assert "seed 2 |" not in page and "- IHED 1/8, fused loss, seed 2: no weights here, and its scores are of other frames." in page


def test_results_are_few_and_small(monkeypatch, tmp_path):
    monkeypatch.setattr(train_all, "LARGEST_FILE", 2_500_000)
    for name, net in (("ihed8-fused-seed1", "ihed8"), ("ihed8-fused-seed2", "ihed8"), ("hed-full", "hed4"), ("ihed8-fused-seed3", "ihed8")):
        run_of(tmp_path / name, net, 80)
    assert train_all.pack([tmp_path / name for name in ("ihed8-fused-seed1", "hed-full", "ihed8-fused-seed2", "ihed8-fused-seed3")], tmp_path / "out") == []
    tars = sorted((tmp_path / "out").iterdir())
    assert [tar.name for tar in tars] == ["runs-1.tar", "runs-2.tar"] and all(tar.stat().st_size <= 2_500_000 for tar in tars)
    for tar in tars:
        with tarfile.open(tar) as file:
            file.extractall(tmp_path / "back", filter="data")
    state = checkpoint.load_newest(tmp_path / "back/ihed8-fused-seed1")
    assert "ema" in state and "model" not in state and state["images"] == 80
    assert "ema" not in checkpoint.load_newest(tmp_path / "back/hed-full")  # larger than a file may be
    assert (tmp_path / "back/hed-full/metrics.jsonl").is_file()
