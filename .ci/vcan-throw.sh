#!/bin/sh
# Inside the machine of .ci/vcan-vm, or on one that has vcan: the simulated cell on vcan0 as one process, and a throw over it
# as another. Prints the summary of the throw and the report of the cell between marks.
set -e
export PATH="$PATH:/"
ip link show vcan0 >/dev/null 2>&1 || ip link add vcan0 type vcan
# What people read when the interface is missing or down.
for bus in vcan7 vcan0; do
    if cubectl throw --yes --target 1,1,-1 --bus $bus --out /tmp/refused; then exit 1; fi
    rm -rf /tmp/refused
done
ip link set vcan0 up
rm -rf /tmp/throw
hil-sim serve --bus vcan0 --json </dev/null >/tmp/sim.log 2>&1 &
server=$!
# It is there when it says so.
for look in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
    if grep -q '"serving"' /tmp/sim.log; then break; fi
    sleep 1
done
# Not on the console, which would get a progress bar.
code=0
cubectl throw --yes --target 1,1,-1 --bus vcan0 --out /tmp/throw </dev/null >/tmp/throw.log 2>&1 || code=$?
cat /tmp/throw.log
# The ball is still in the air.
sleep 1
kill -INT $server && wait $server || true
echo "--- summary.json"
cat /tmp/throw/summary.json
echo "--- cell.json"
tail -n 1 /tmp/sim.log
echo "--- end"
# An interface that goes down ends the cell with the command that helps.
hil-sim serve --bus vcan0 --json --duration-s 60 </dev/null >/tmp/down.log 2>/tmp/down.txt &
server=$!
for look in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
    if grep -q '"serving"' /tmp/down.log; then break; fi
    sleep 1
done
ip link set vcan0 down
down=0
wait $server || down=$?
if [ $down -ne 5 ] || ! grep -q "sudo ip link set vcan0 up" /tmp/down.txt; then
    cat /tmp/down.txt
    echo "hil-sim ended with $down where its interface went down"
    exit 1
fi
exit $code
