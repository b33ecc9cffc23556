# Format, lints as errors, documentation without a warning; licences, sources and duplicate crates.
. .ci/toolchain.sh
cargo fmt --all --check
cargo clippy --workspace --all-targets --locked -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked
. .ci/deny/check.sh
