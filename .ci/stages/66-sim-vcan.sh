# The simulated drives at a CAN interface of a real kernel, in an emulated machine.
. .ci/vcan-packages.sh
cargo build --release --locked -p host -p hil-sim --bins
. .ci/debug-build.sh
VCAN_VM_WITH=target/release/hil-sim .ci/vcan-vm target/debug/examples/vcan_serve /hil-sim
