# The no_std packages compile for the target of the boards. The stages qemu and firmware search the linked images for panics.
. .ci/toolchain.sh
cargo build --release --locked --target thumbv7em-none-eabihf -p protocol -p firmware
