# The socketcand port against a client that is not ours: python-can, unmodified, pinned.
venv=target/venv-python-can
[ -x $venv/bin/python ] || python3 -m venv $venv
$venv/bin/pip install --quiet --disable-pip-version-check python-can==4.6.1
cargo build --locked -p can-link --example echo_server
# Port 0: any free one; the server prints the address it got.
log=target/echo_server.log
target/debug/examples/echo_server 127.0.0.1:0 >$log &
server=$!
trap 'kill $server' EXIT
for _ in $(seq 50); do
    grep -q '^socketcand://' $log && break
    sleep 0.1
done
port=$(sed -n 's|^socketcand://127.0.0.1:\([0-9]*\)/can0$|\1|p' $log)
timeout 120 $venv/bin/python protocol/link/tests/python_can.py 127.0.0.1 "$port" 2>target/python_can.log ||
    { cat target/python_can.log; exit 1; }
