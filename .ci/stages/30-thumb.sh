# The no_std rooms compile for the target of the boards.
cargo build --release --locked --target thumbv7em-none-eabihf -p protocol -p firmware
