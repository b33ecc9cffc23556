#!/bin/sh
# Inside the machine of .ci/vcan-vm, or on one that has vcan: the simulated cell on vcan0, and a throw over it.
set -e
export PATH="$PATH:/"
ip link show vcan0 >/dev/null 2>&1 || ip link add vcan0 type vcan
# What people read when the interface is missing or down.
for bus in vcan7 vcan0; do
    if cubectl throw --target 1,1,-1 --no-store --bus $bus --out /tmp/refused; then exit 1; fi
    rm -rf /tmp/refused
done
ip link set vcan0 up
hil-sim serve --bus vcan0 </dev/null >/tmp/sim.log 2>&1 &
sleep 2
code=0
cubectl throw --target 1,1,-1 --no-store --bus vcan0 --back --out /tmp/throw </dev/null || code=$?
kill %1 || true
echo "--- summary.json"
cat /tmp/throw/summary.json
echo "--- end of summary.json"
exit $code
