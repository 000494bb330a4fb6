#!/bin/bash
# Runs a training program in the background with low priority; it goes on where it stopped.
#   run_background.sh RUN start [PROGRAM.py] [options]  train.py unless another is named; without options, those kept in RUN/options
#   run_background.sh RUN status                        the last lines and whether it runs
#   run_background.sh RUN stop                          saves what is done, then ends
# The programs: train.py (one network), train_all.py (all of them), lines_data.py (data of the network of lines).
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
venv="${BOXLINE_TRAINING_VENV:-$here/.venv}"
[ $# -ge 2 ] || { sed -n '2,6s/^# \?//p' "$0" >&2; exit 2; }
run="$1" action="$2"
shift 2
mkdir -p "$run"
run="$(cd "$run" && pwd)"

# Whether the number in RUN/pid is still that of a program with this run.
running() { [ -f "$run/pid" ] && tr '\0' ' ' <"/proc/$(cat "$run/pid")/cmdline" 2>/dev/null | grep -qsF -- ".py --run $run "; }

case "$action" in
start)
    if running; then echo "already running as $(cat "$run/pid")" >&2; exit 1; fi
    [ $# -eq 0 ] || printf '%s\n' "$@" >"$run/options"
    [ -f "$run/options" ] || { echo "no options given, and none kept in $run/options" >&2; exit 2; }
    mapfile -t options <"$run/options"
    program=train.py
    case "${options[0]}" in *.py) program="${options[0]}" options=("${options[@]:1}") ;; esac
    cd "$here"
    setsid nohup nice -n 15 "$venv/bin/python" "$program" --run "$run" "${options[@]}" >>"$run/log" 2>&1 </dev/null &
    echo $! >"$run/pid"
    echo "runs as $(cat "$run/pid"); look at $run/log"
    ;;
status)
    if running; then echo "runs as $(cat "$run/pid")"; else echo "does not run"; fi
    tail -n 5 "$run/log" 2>/dev/null || true
    grep '^validation' "$run/log" 2>/dev/null | tail -n 3 || true
    ;;
stop)
    running || { echo "does not run"; exit 0; }
    kill -TERM "$(cat "$run/pid")"
    for _ in $(seq 120); do running || { echo "stopped"; exit 0; }; sleep 1; done
    echo "still running after two minutes" >&2
    exit 1
    ;;
*) echo "unknown action $action" >&2; exit 2 ;;
esac
