# The links against a client that is not ours: python-can, unmodified, pinned; over socketcand, and over
# SLCAN through TCP and through a pseudo-terminal.
venv=target/venv-python-can
[ -x $venv/bin/python ] || python3 -m venv $venv
$venv/bin/pip install --quiet --disable-pip-version-check python-can==4.6.1 pyserial==3.5
cargo build --locked -p can-link --example echo_server
server=
trap '[ -z "$server" ] || kill $server' EXIT
for spec in socketcand://127.0.0.1:0/can0 slcan://127.0.0.1:0 slcan:/dev/ptmx; do
    # Port 0: any free one; the server prints where it is.
    log=target/echo_server.log
    : >$log
    target/debug/examples/echo_server $spec >$log &
    server=$!
    for _ in $(seq 50); do
        [ -s $log ] && break
        sleep 0.1
    done
    echo "--- $(cat $log)"
    timeout 120 $venv/bin/python protocol/link/tests/python_can.py "$(cat $log)" 2>target/python_can.log ||
        { cat target/python_can.log; exit 1; }
    kill $server
    server=
done
