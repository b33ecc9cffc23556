# The documentation of all packages without a warning.
. .ci/toolchain.sh
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked
