#!/bin/sh
# Inside the machine of .ci/vcan-vm: eight simulated motors on CAN FD behind the kernel's interface, asked by `cubectl doctor`. First on an
# interface that takes classical frames only. Nothing here depends on the speed of the programs.
set -e
export PATH="$PATH:/"
ip link show vcan0 >/dev/null 2>&1 || ip link add vcan0 type vcan
(cat /openarm7.toml && printf '\n[bus]\ndata_bit_rate_bit_s = 5_000_000\n') >/tmp/arm.toml
doctor() {
    code=0
    cubectl doctor --robot /tmp/arm.toml --bus vcan0 </dev/null >/tmp/doctor.txt 2>&1 || code=$?
    cat /tmp/doctor.txt
}
says() {
    grep -q "$1" /tmp/doctor.txt || { echo "doctor does not say '$1'"; exit 1; }
}
cell() { # robot
    : >/tmp/sim.log
    hil-sim serve --robot $1 --bus vcan0 --json </dev/null >/tmp/sim.log 2>&1 &
    server=$!
}
serving() {
    for look in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
        if grep -q '"serving"' /tmp/sim.log; then return; fi
        sleep 1
    done
}
ip link set vcan0 mtu 16
ip link set vcan0 up
doctor
[ $code -eq 9 ]
says 'sudo ip link set vcan0 mtu 72 up'
cell /tmp/arm.toml
refused=0
wait $server || refused=$?
cat /tmp/sim.log
[ $refused -eq 5 ]
grep -q 'sudo ip link set vcan0 mtu 72 up' /tmp/sim.log
ip link set vcan0 down
ip link set vcan0 mtu 72
ip link set vcan0 up
# Motors that are set to classical CAN.
cell /openarm7.toml
serving
doctor
kill -INT $server && wait $server || true
[ $code -eq 9 ]
says 'it answers by classical frames; its register 35 holds 4'
cell /tmp/arm.toml
serving
doctor
kill -INT $server && wait $server || true
[ $code -eq 0 ]
says '8 answer to CAN FD frames with bit rate switch'
# By the account of the cell: a question and an answer in that form, and none to the others.
tail -n 1 /tmp/sim.log >/tmp/cell.json
for id in 011 012 013 014 015 016 017 018; do
    grep -q "\"id\":\"$id\"" /tmp/cell.json || { echo "no answer with id $id"; exit 1; }
done
grep -q '"data_bit_rate_bit_s":5000000' /tmp/cell.json
grep -q '"error_share":0.0' /tmp/cell.json
