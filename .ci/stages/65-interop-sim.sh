# The simulated drives against clients that are not ours, unmodified, pinned. PowerCubes: python-can, over socketcand and as an
# SLCAN adapter at a pseudo-terminal, both at the same time on one simulated bus. Damiao motors: damiao-motor, ODrive axes:
# odrive-can, CANopen servos: canopen, all over socketcand. Our controller with CANopen slaves of durand, in virtual time.
. .ci/timed.sh
. .ci/serve.sh
. .ci/venv.sh sim tests/interop/sim/requirements.txt
cargo build --release --locked -p host -p hil-sim --bins
log=target/interop-sim.log
server=
trap '[ -z "$server" ] || kill $server 2>/dev/null || true' EXIT
# Its steps are tied by && where `timed` asks for its outcome: there `set -e` does not end it.
clients() {
    serve "$log" socketcand://127.0.0.1:0/can0 slcan:/dev/ptmx || return 1
    local port device
    port=$(place "$log" socketcand: | sed 's|.*:\([0-9]*\)/.*|\1|')
    device=$(place "$log" slcan: | sed 's|^slcan:||')
    local status=0
    echo "--- python-can over socketcand" &&
        timeout 180 python tests/interop/sim/powercubes.py socketcand 127.0.0.1 "$port" &&
        echo "--- python-can over SLCAN at $device" &&
        timeout 180 python tests/interop/sim/powercubes.py slcan "$device" || status=$?
    kill -INT $server
    wait $server || status=$?
    server=
    return $status
}
timed clients
motors() { # client, options of serve-motors...
    local client=$1 log=target/interop-$1.log status=0 port
    shift
    target/release/hil-sim serve-motors "$@" --bus socketcand://127.0.0.1:0/can0 --json >"$log" </dev/null &
    server=$!
    wait_for $server says "$log" '"event":"real time"' || { cat "$log"; return 1; }
    port=$(place "$log" socketcand: | sed 's|.*:\([0-9]*\)/.*|\1|')
    echo "--- $client over socketcand" &&
        CAN_CONFIG="{\"host\": \"127.0.0.1\", \"port\": $port, \"tcp_tune\": true}" timeout 180 \
            python "tests/interop/sim/$client.py" 127.0.0.1 "$port" || status=$?
    kill -INT $server
    wait $server || status=$?
    server=
    return $status
}
timed motors damiao --damiao 8009:1:0x11 --damiao 4310:2:0x12
timed motors cia402 --canopen 3
# Our controller is the master: five servos are durand, one is simulated. Their units are those of `serve-motors`.
durand() {
    local log=target/interop-durand.log robot=target/interop-durand.toml status=0 place=lockstep://127.0.0.1:0/can0 ports
    sed 's/counts_per_turn = [0-9]*/counts_per_turn = 409600/; s/rated_nm = [0-9.]*/rated_nm = 50/' robots/canopen6.toml >$robot
    target/release/hil-sim serve-motors --canopen 3 --bus $place --bus $place --bus $place --json >"$log" </dev/null &
    server=$!
    wait_for $server says "$log" '"event":"real time"' || { cat "$log"; return 1; }
    ports=$(sed -n 's|.*lockstep://127.0.0.1:\([0-9]*\)/.*|\1|p' "$log")
    echo "--- durand in lock step"
    # shellcheck disable=SC2086 # three ports
    timeout 180 python tests/interop/sim/durand_servos.py target/release/cubectl $robot $ports || status=$?
    kill -INT $server
    wait $server || status=$?
    server=
    return $status
}
durand
# Our controller with simulated ODrives: the maker's DBC reads every frame of a motion.
odrive_frames() {
    local out=target/interop-odrive
    rm -rf $out
    target/release/cubectl move --robot robots/odrive6.toml --joints 0.3,0.4,0.5,0,0.2,0 --home --yes --out $out &&
        timeout 180 python tests/interop/sim/odrive_frames.py $out/bus.log
}
timed odrive_frames
timed motors odrive --odrive 0:0.6 --odrive 1:0.6:index --odrive-watchdog-ms 500
tail -n 1 "$log" | python -c '
import json, sys
report = json.load(sys.stdin)
print("latency at the server, us:", report["latency_us"], "late:", report["lateness_us"])
assert report["latency_us"]["count"] > 200
assert all(node["errors"]["ack"] == 0 for node in report["bus"]["nodes"])'
