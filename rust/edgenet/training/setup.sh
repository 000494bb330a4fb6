#!/bin/bash
# Makes the Python environment of the training code.
#   setup.sh [FOLDER]      default: $BOXLINE_TRAINING_VENV, else .venv beside this script
# torch is installed without the CUDA packages it asks for (they are 2.3 GB and unused here); stubs stand in for their
# libraries. Where that does not work (no gcc, another platform), the whole of torch is installed instead.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
venv="${1:-${BOXLINE_TRAINING_VENV:-$here/.venv}}"
torch="torch==2.15.0"
started=$SECONDS

[ -x "$venv/bin/python" ] || "${PYTHON:-python3}" -m venv "$venv"
python="$venv/bin/python"
works() { "$python" -c 'import torch; torch.ones(2, 2) @ torch.ones(2, 2)' >/dev/null 2>&1; }

if ! works; then
    "$python" -m pip install --quiet --no-cache-dir --no-deps "$torch"
    "$python" "$here/cuda_stubs.py" "$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" || true
fi
# Every package is listed there; --no-deps keeps pip from asking for the CUDA packages of torch again.
"$python" -m pip install --quiet --no-cache-dir --no-deps -r "$here/requirements.txt"
if ! works; then
    echo "setup: the CUDA-less torch does not start; installing all of it (about 2.9 GB to download)" >&2
    "$python" -m pip uninstall --quiet --yes torch
    "$python" -m pip install --quiet --no-cache-dir "$torch"
    works || { "$python" -c 'import torch'; exit 1; }
fi
"$python" -c 'import torch; print("torch", torch.__version__, torch.backends.cpu.get_cpu_capability())'
echo "setup: $venv, $(du -sh "$venv" | cut -f1), $((SECONDS - started)) s"
