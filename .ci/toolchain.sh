# Sourced by stages that compile for the boards, or need clippy and rustfmt: what rust-toolchain.toml names, also where
# rustup's automatic installation is switched off. Quick if all is there; a toolchain without rustup is taken as it is.
if command -v rustup >/dev/null; then
    channel=$(sed -n 's/^channel *= *"\(.*\)"/\1/p' rust-toolchain.toml)
    rustup toolchain list | grep -q "^$channel" || rustup toolchain install "$channel" --profile minimal
    components=$(rustup component list --toolchain "$channel" --installed)
    for component in clippy rustfmt; do
        grep -q "^$component" <<<"$components" || rustup component add --toolchain "$channel" $component
    done
    rustup target list --toolchain "$channel" --installed | grep -q '^thumbv7em-none-eabihf$' ||
        rustup target add --toolchain "$channel" thumbv7em-none-eabihf
fi
