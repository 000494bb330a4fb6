"""The data of the network of lines, with programs that stand in for the renderer and the example line_strips."""

import json
import sys

import pytest

import lines_data

RENDERER = """
import sys, pathlib
words = sys.argv[1:]
value = lambda name: words[words.index(name) + 1]
assert words[0] == "render"
for seed in range(int(value("--seed")), int(value("--seed")) + int(value("--count"))):
    folder = pathlib.Path(value("--out"), f"{seed:03}")
    folder.mkdir()
    (folder / "truth.json").write_text("held out" if "--held-out" in words else "seen")
"""
# Two faces a box, of which one has no lines at every fifth.
STRIPS = """
import sys, pathlib
out, frames = map(pathlib.Path, sys.argv[1:])
for folder in frames.iterdir():
    for frame in "ab":
        empty = frame == "a" and int(folder.name) % 5 == 0
        (out / f"{folder.name}{frame}.strips").write_text("" if empty else (folder / "truth.json").read_text())
"""


def program(path, text: str):
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(0o755)
    return path


def start(monkeypatch, tmp_path, *more: str, strips: str = STRIPS) -> list[dict]:
    words = ["--run", str(tmp_path / "run"), "--renderer", str(program(tmp_path / "renderer", RENDERER)), "--strips", str(program(tmp_path / "strips", strips))]
    monkeypatch.setattr(sys, "argv", ["lines_data.py", *words, *more])
    lines_data.main()
    return [json.loads(line) for line in (tmp_path / "run/made.jsonl").read_text().splitlines()]


def test_all_parts_are_made_and_frames_deleted(monkeypatch, tmp_path, capsys):
    records = start(monkeypatch, tmp_path, "--faces", "60", "--workers", "2")
    run = tmp_path / "run"
    assert all(r["faces"] == 18 and r["boxes"] == 10 for r in records)
    assert sorted(r["seed"] for r in records) == [100_000_000, 100_000_010, 150_000_000, 150_000_010, 200_000_000]
    assert {p.name: len(list(p.iterdir())) for p in run.iterdir() if p.is_dir()} == {"learn": 80, "choose": 20}
    assert (run / "learn/100000013b.strips").read_text() == "seen"
    assert (run / "learn/150000013b.strips").read_text() == "held out"
    assert "all is made" in capsys.readouterr().out


def test_it_goes_on_where_it_stopped(monkeypatch, tmp_path, capsys):
    before = start(monkeypatch, tmp_path, "--faces", "30")
    made = tmp_path / "run/made.jsonl"
    made.write_text("".join(json.dumps(r) + "\n" for r in before[:-1]) + json.dumps(before[-1])[:20] + "\n")  # killed while it wrote
    (tmp_path / "run/frames-left").mkdir()
    capsys.readouterr()
    start(monkeypatch, tmp_path, "--faces", "30")
    assert capsys.readouterr().out.count("seeds ") == 1 and not (tmp_path / "run/frames-left").exists()
    assert sorted(r["seed"] for r in lines_data.made(tmp_path / "run")) == sorted(r["seed"] for r in before)
    start(monkeypatch, tmp_path, "--faces", "60")  # more of them
    assert len(lines_data.made(tmp_path / "run")) == 5


def test_a_program_that_fails_is_named(monkeypatch, tmp_path):
    with pytest.raises(SystemExit, match="code 3: no lines here"):
        start(monkeypatch, tmp_path, strips="import sys\nsys.stderr.write('no lines here')\nsys.exit(3)")
    assert lines_data.made(tmp_path / "run") == []
    monkeypatch.setattr(sys, "argv", ["lines_data.py", "--run", str(tmp_path / "run"), "--renderer", "/no/boxline", "--strips", "/no/strips"])
    with pytest.raises(SystemExit, match="there is no program /no/boxline: --renderer names one"):
        lines_data.main()
