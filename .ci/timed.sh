# Sourced by stages in which wall-clock time is what is tested, with programs that are not ours or that must keep real time:
#   timed COMMAND…    runs it, and once more if it fails. Each use and each repeat is counted; `.ci/run` fails if more than
#                     one use in four needed its repeat. $tried is 1 or 2
# A COMMAND that ends with $not_repeated (99) failed for a reason that has nothing to do with time.
# Everything else runs in lock step (virtual time over the socket), where nothing is repeated.
not_repeated=99
timed() {
    local status=0
    mkdir -p target/ci
    tried=1
    echo "$*" >>target/ci/timed
    "$@" || status=$?
    [ $status -ne 0 ] || return 0
    echo "ended with $status: $*" >&2
    [ $status -ne $not_repeated ] || return $status
    tried=2
    echo "$*" >>target/ci/repeated
    sleep 5
    "$@"
}
