# The SocketCAN link on a kernel that has CAN, in an emulated machine: every kind of frame, and motors on CAN FD.
. .ci/vcan-packages.sh
. .ci/debug-build.sh
.ci/vcan-vm target/debug/examples/vcan_check
VCAN_VM_WITH="target/debug/cubectl target/debug/hil-sim robots/openarm7.toml" .ci/vcan-vm .ci/vcan-fd.sh
