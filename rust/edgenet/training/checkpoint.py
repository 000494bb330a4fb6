"""Checkpoints that survive being interrupted at any moment: written aside, flushed, renamed; the last two are kept."""

import os
import sys
from pathlib import Path

import torch

KEPT = 2


def existing(folder: Path) -> list[Path]:
    """The checkpoints in a folder, the newest first."""
    return sorted(folder.glob("step-*.pt"), reverse=True)


def save(folder: Path, step: int, state: dict) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"step-{step:09d}.pt"
    aside = path.with_suffix(".tmp")
    with open(aside, "wb") as file:
        torch.save(state, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(aside, path)
    for old in existing(folder)[KEPT:]:
        old.unlink()
    return path


def as_today(state: dict) -> dict:
    """Checkpoints up to version 0.5 know one renderer, and a sitting's end by options only."""
    if "next_seed" in state:
        options = state["options"]
        state["next_seeds"] = [state.pop("next_seed")]
        state["sitting_images"] = state["sitting_step"] * options["batch"]
        visits = options["max_images"]
        state["finished"] = state["images"] >= visits if visits else state["elapsed_s"] >= options["minutes"] * 60
    return state


def load_newest(folder: Path) -> dict | None:
    """The newest checkpoint that can be read; None if there is none at all."""
    found = existing(folder)
    for path in found:
        try:
            # Made by this program in a folder of the user's own; it holds random states, not only tensors.
            return as_today(torch.load(path, map_location="cpu", weights_only=False))
        except Exception as wrong:  # torch raises many kinds for a damaged file
            print(f"checkpoint: {path} cannot be read ({wrong}); trying the one before", file=sys.stderr)
    if found:
        raise RuntimeError(f"none of the {len(found)} checkpoints in {folder} can be read")
    return None
