#!/bin/bash
# Trains in the background with low priority, and goes on from the last checkpoint if there is one.
#   run_background.sh RUN start [train.py options]    the options are kept in RUN/options; without any, those are used
#   run_background.sh RUN status                      the last lines and whether it runs
#   run_background.sh RUN stop                        saves a checkpoint, then ends
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
venv="${BOXLINE_TRAINING_VENV:-$here/.venv}"
[ $# -ge 2 ] || { sed -n '2,5s/^# \?//p' "$0" >&2; exit 2; }
run="$1" action="$2"
shift 2
mkdir -p "$run"
run="$(cd "$run" && pwd)"

. "$here/background.sh"

case "$action" in
start)
    if running "$run" train.py; then echo "already running as $(cat "$run/pid")" >&2; exit 1; fi
    [ $# -eq 0 ] || printf '%s\n' "$@" >"$run/options"
    [ -f "$run/options" ] || { echo "no options given, and none kept in $run/options" >&2; exit 2; }
    mapfile -t options <"$run/options"
    cd "$here"
    setsid nohup nice -n 15 "$venv/bin/python" train.py --run "$run" "${options[@]}" >>"$run/log" 2>&1 </dev/null &
    echo $! >"$run/pid"
    echo "runs as $(cat "$run/pid"); look at $run/log, $run/curves.png"
    ;;
status)
    if running "$run" train.py; then echo "runs as $(cat "$run/pid")"; else echo "does not run"; fi
    tail -n 5 "$run/log" 2>/dev/null || true
    grep '^validation' "$run/log" 2>/dev/null | tail -n 3 || true
    ;;
stop) stop "$run" train.py ;;
*) echo "unknown action $action" >&2; exit 2 ;;
esac
