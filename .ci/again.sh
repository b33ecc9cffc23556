# Sourced by stages that need real time on a machine that others share, which is held up now and then:
#   again N COMMAND…     runs it until it ends well, N times at most, with a longer pause each time
# What failed for a reason of its own fails N times.
again() {
    local tries=$1 try status
    shift
    for try in $(seq "$tries"); do
        status=0
        "$@" || status=$?
        [ $status -ne 0 ] || return 0
        echo "try $try of $tries ended with $status: $*" >&2
        [ "$try" -eq "$tries" ] || sleep $((5 * try))
    done
    return $status
}
