# The no_std packages compile for the target of the boards. The stage firmware searches the linked image of a board for panics.
. .ci/toolchain.sh
cargo build --release --locked --target thumbv7em-none-eabihf -p protocol -p firmware
