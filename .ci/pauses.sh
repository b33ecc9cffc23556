# Sourced by stages that judge programs by the clock, which a machine can hold up:
#   watch_pauses   starts a process on each core that only sleeps, by the clock of "${slow[@]}"
#   end_pauses     ends them; $pause_ms is then the longest time by that clock for which one of them was held up
# The programs under test see neither.
. .ci/slow.sh
watch_pauses() {
    local core
    pause_files=$(mktemp -d)
    pause_watches=()
    for core in $(python3 -c 'import os; print(*os.sched_getaffinity(0))'); do
        "${slow[@]}" python3 - "$core" >"$pause_files/$core" <<'PY' &
import os, signal, sys, time

signal.signal(signal.SIGTERM, lambda *_: sys.exit(print(f"{worst_ms:.1f}")))
os.sched_setaffinity(0, [int(sys.argv[1])])
try:
    # Above the programs under test (30), where they may have such a priority: only the machine holds this one up then.
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(31))
except PermissionError:
    pass
worst_ms = 0.0
while True:
    before = time.monotonic()
    time.sleep(0.0005)
    worst_ms = max(worst_ms, 1e3 * (time.monotonic() - before) - 0.5)
PY
        pause_watches+=($!)
    done
}
end_pauses() {
    kill -TERM "${pause_watches[@]}"
    wait "${pause_watches[@]}" || true
    pause_ms=$(sort -n "$pause_files"/* | tail -n 1)
    rm -r "$pause_files"
}
