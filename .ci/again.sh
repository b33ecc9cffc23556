# Sourced by stages that need real time on a machine that others share, which is held up now and then:
#   again N COMMAND…     runs it until it ends well, N times at most, with a pause that doubles; $tried is which time it is
# What failed for a reason of its own fails N times.
again() {
    local tries=$1 status
    shift
    for tried in $(seq "$tries"); do
        status=0
        "$@" || status=$?
        [ $status -ne 0 ] || return 0
        echo "try $tried of $tries ended with $status: $*" >&2
        [ "$tried" -eq "$tries" ] || sleep $((5 << (tried - 1)))
    done
    return $status
}
