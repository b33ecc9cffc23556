# Sourced by stages that wait for a program:
#   wait_for PID COMMAND…    returns when COMMAND succeeds; fails when the process PID has ended, or after two minutes. Only a
#                            hang lasts as long, on a busy machine too
#   says FILE TEXT           a COMMAND: a line of FILE matches TEXT
wait_for() {
    local pid=$1
    shift
    for _ in $(seq 1200); do
        ! "$@" || return 0
        kill -0 "$pid" 2>/dev/null || break
        sleep 0.1
    done
    # It may have become true with the last word of a program that has ended.
    "$@"
}
says() { grep -q -- "$2" "$1" 2>/dev/null; }
