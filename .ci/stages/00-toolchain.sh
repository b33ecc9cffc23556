# What rust-toolchain.toml names, also where rustup's automatic installation is switched off.
channel=$(sed -n 's/^channel *= *"\(.*\)"/\1/p' rust-toolchain.toml)
rustup toolchain list | grep -q "^$channel" || rustup toolchain install "$channel" --profile minimal
rustup component add --toolchain "$channel" clippy rustfmt
rustup target add --toolchain "$channel" thumbv7em-none-eabihf
cargo --version
rustc --version
