"""The programs that training starts, and how it is itself asked to end."""

import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

from stream import WORKSPACE

RELEASE = WORKSPACE / "target" / "release"


def cargo_build(*what: str) -> None:
    """Builds programs of this repository if cargo is there; without it, what was built before must do."""
    if not shutil.which("cargo"):
        return
    if subprocess.run(["cargo", "build", "--release", *what], cwd=WORKSPACE).returncode:
        sys.exit("cargo cannot build what is needed (above); an option names a built one")


def program(path: Path, option: str) -> Path:
    """The whole path of a program that must be there."""
    if not path.is_file():
        sys.exit(f"there is no program {path}: {option} names one, or cargo builds it")
    return path.resolve()


def stop_on_signals() -> threading.Event:
    """Set when this program is asked to end."""
    stop = threading.Event()
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: stop.set())
    return stop
