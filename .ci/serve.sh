# Sourced by stages whose clients need the simulated cell at free places:
#   serve LOG BUS…       starts `hil-sim serve --json` as $server, its lines into LOG; returns when all its endpoints are open
#                          by the clock of "${clock[@]}", if that is set (.ci/slow.sh)
#   place LOG PREFIX     where the endpoint is whose name begins so: the program says which port or pseudo-terminal it got
. .ci/wait.sh
clock=()
serves() { [ "$(grep -c '"event":"serving"' "$1")" -ge "$2" ]; } # log, endpoints
serve() {
    local log=$1 buses=()
    shift
    for bus in "$@"; do buses+=(--bus "$bus"); done
    # Here, not by the job in the background: the loop below may look before that has begun.
    : >"$log"
    "${clock[@]}" target/release/hil-sim serve "${buses[@]}" --json >"$log" </dev/null &
    server=$!
    wait_for "$server" serves "$log" $# && return 0
    echo "the simulated cell does not open its endpoints:" >&2
    cat "$log" >&2
    kill "$server" 2>/dev/null || true
    return 1
}
place() { sed -n "s|.*\"\($2[^ \"]*\).*|\1|p" "$1" | head -n 1; }
