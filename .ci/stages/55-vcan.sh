# The SocketCAN link on a kernel that has CAN, in an emulated machine.
. .ci/vcan-packages.sh
cargo build --release --locked -p can-link --example vcan_check
.ci/vcan-vm target/release/examples/vcan_check
