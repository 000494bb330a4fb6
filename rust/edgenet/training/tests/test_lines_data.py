"""The data of the network of lines, with a program that stands in for the example line_strips."""

import json
import sys

import pytest

import lines_data

# Two faces a box, of which one has no lines at every fifth.
STRIPS = """
import sys, pathlib
out, first, count, split = sys.argv[1:]
for seed in range(int(first), int(first) + int(count)):
    for frame in "ab":
        pathlib.Path(out, f"{seed}{frame}.strips").write_text("" if frame == "a" and seed % 5 == 0 else split)
"""


def program(path, text: str):
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(0o755)
    return path


def start(monkeypatch, tmp_path, *more: str, strips: str = STRIPS) -> list[dict]:
    words = ["--run", str(tmp_path / "run"), "--strips", str(program(tmp_path / "strips", strips))]
    monkeypatch.setattr(sys, "argv", ["lines_data.py", *words, *more])
    lines_data.main()
    return [json.loads(line) for line in (tmp_path / "run/made.jsonl").read_text().splitlines()]


def test_all_parts_are_made(monkeypatch, tmp_path, capsys):
    records = start(monkeypatch, tmp_path, "--faces", "300", "--workers", "2")
    run = tmp_path / "run"
    assert all(r["faces"] == 90 and r["boxes"] == 50 for r in records)
    assert sorted(r["seed"] for r in records) == [100_000_000, 100_000_050, 100_000_100, 100_000_150, 200_000_000]
    assert {p.name: len(list(p.iterdir())) for p in run.iterdir() if p.is_dir()} == {"learn": 400, "choose": 100}
    assert (run / "learn/100000013b.strips").read_text() == "training"
    assert (run / "choose/200000013b.strips").read_text() == "held-out"
    assert "all is made" in capsys.readouterr().out


def test_it_goes_on_where_it_stopped(monkeypatch, tmp_path, capsys):
    before = start(monkeypatch, tmp_path, "--faces", "200")
    made = tmp_path / "run/made.jsonl"
    made.write_text("".join(json.dumps(r) + "\n" for r in before[:-1]) + json.dumps(before[-1])[:20] + "\n")  # killed while it wrote
    capsys.readouterr()
    start(monkeypatch, tmp_path, "--faces", "200")
    assert capsys.readouterr().out.count("seeds ") == 1
    assert sorted(r["seed"] for r in lines_data.made(tmp_path / "run")) == sorted(r["seed"] for r in before)
    start(monkeypatch, tmp_path, "--faces", "400")  # more of them
    assert len(lines_data.made(tmp_path / "run")) == 6


def test_a_program_that_fails_is_named(monkeypatch, tmp_path):
    with pytest.raises(SystemExit, match="code 3: no lines here"):
        start(monkeypatch, tmp_path, strips="import sys\nsys.stderr.write('no lines here')\nsys.exit(3)")
    assert lines_data.made(tmp_path / "run") == []
    monkeypatch.setattr(sys, "argv", ["lines_data.py", "--run", str(tmp_path / "run"), "--strips", "/no/strips"])
    with pytest.raises(SystemExit, match="there is no program /no/strips: --strips names one"):
        lines_data.main()
