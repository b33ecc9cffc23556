#!/bin/sh
# Inside the machine of .ci/vcan-vm: seven simulated motors of an arm and the one of its hand on CAN FD, and a controller that finds them over
# the kernel's interface. First on an interface that takes classical frames only.
set -e
export PATH="$PATH:/"
ip link show vcan0 >/dev/null 2>&1 || ip link add vcan0 type vcan
(cat /openarm7.toml && printf '\n[bus]\ndata_bit_rate_bit_s = 5_000_000\n') >/tmp/arm.toml
home() {
    code=0
    cubectl home --robot /tmp/arm.toml --bus vcan0 --controller soft --json </dev/null >/tmp/home.json 2>/tmp/home.txt || code=$?
    cat /tmp/home.txt
}
ip link set vcan0 mtu 16
ip link set vcan0 up
home
if [ $code -eq 0 ] || ! grep -q 'sudo ip link set vcan0 mtu 72 up' /tmp/home.txt; then
    echo "home ended with $code on a classical interface"
    exit 1
fi
ip link set vcan0 down
ip link set vcan0 mtu 72
ip link set vcan0 up
printf 'schema_version = 1\nrobot = "/tmp/arm.toml"\nduration_s = 1000\n' >/tmp/cell.toml
hil-sim serve --scenario /tmp/cell.toml --bus vcan0 --json </dev/null >/tmp/sim.log 2>&1 &
server=$!
for look in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
    if grep -q '"serving"' /tmp/sim.log; then break; fi
    sleep 1
done
home
kill -INT $server && wait $server || true
cat /tmp/home.json
if [ $code -ne 0 ]; then
    tail -n 3 /tmp/sim.log
    exit $code
fi
# Both ends by the account of the cell: commands and answers of all eight motors, and no error on the bus.
tail -n 1 /tmp/sim.log >/tmp/cell.json
for id in 001 002 003 004 005 006 007 008 011 012 013 014 015 016 017 018; do
    grep -q "\"id\":\"$id\"" /tmp/cell.json || { echo "no frame with id $id"; cat /tmp/cell.json; exit 1; }
done
grep -q '"data_bit_rate_bit_s":5000000' /tmp/cell.json && grep -q '"error_share":0.0' /tmp/cell.json
