# The SocketCAN link on a kernel that has CAN, in an emulated machine.
. .ci/vcan-packages.sh
cargo build --release --locked -p can-link --example vcan_check
.ci/vcan-vm target/release/examples/vcan_check

# The main job over vcan0: the simulated cell as one process, the throw as another. On a machine that has vcan and
# where we may make one it runs right here.
cargo build --release --locked -p host -p hil-sim
mkdir -p target/throw
export VCAN_VM_WITH="target/release/cubectl target/release/hil-sim"
if ip link add vcan0 type vcan 2>/dev/null || ip link show vcan0 >/dev/null 2>&1; then
    run=(env PATH="$PWD/target/release:$PATH" sh .ci/vcan-throw.sh)
else
    run=(.ci/vcan-vm .ci/vcan-throw.sh)
fi
code=0
"${run[@]}" >target/throw/vcan.log 2>&1 || code=$?
sed -n '1,/^--- summary.json/p' target/throw/vcan.log
sed -n '/^--- summary.json/,/^--- end of summary.json/p' target/throw/vcan.log | sed '1d;$d' >target/throw/vcan.json
[ $code -eq 0 ]
.ci/throw-table vcan=target/throw/vcan.json
