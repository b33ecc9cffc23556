# The SocketCAN link on a kernel that has CAN, in an emulated machine.
. .ci/vcan-packages.sh
. .ci/debug-build.sh
.ci/vcan-vm target/debug/examples/vcan_check
