# The links against a client that is not ours: python-can, unmodified, pinned; over socketcand, and over
# SLCAN through TCP and through a pseudo-terminal.
. .ci/timed.sh
. .ci/wait.sh
. .ci/venv.sh sim tests/interop/sim/requirements.txt
. .ci/debug-build.sh
server=
trap '[ -z "$server" ] || kill $server' EXIT
for spec in socketcand://127.0.0.1:0/can0 slcan://127.0.0.1:0 slcan:/dev/ptmx; do
    # Port 0: any free one; the server prints where it is.
    log=target/echo_server.log
    : >$log
    target/debug/examples/echo_server $spec >$log &
    server=$!
    wait_for $server test -s $log
    echo "--- $(cat $log)"
    timed timeout 120 python protocol/link/tests/python_can.py "$(cat $log)" 2>target/python_can.log ||
        { cat target/python_can.log; exit 1; }
    kill $server
    server=
done
