# Sourced by run_background.sh and compare_train.sh: a job that outlives its starter, known by the number in FOLDER/pid.

# running FOLDER PROGRAM: whether that number is still the program's.
running() { [ -f "$1/pid" ] && grep -qs "$2" "/proc/$(cat "$1/pid")/cmdline"; }

# stop FOLDER PROGRAM: asks it to save a checkpoint and end, and waits.
stop() {
    running "$@" || { echo "does not run"; return; }
    kill -TERM "$(cat "$1/pid")"
    for _ in $(seq 120); do running "$@" || { echo "stopped"; return; }; sleep 1; done
    echo "still running after two minutes" >&2
    return 1
}
