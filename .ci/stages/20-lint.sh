# Format, lints as errors; licences, sources and duplicate crates.
. .ci/toolchain.sh
cargo fmt --all --check
cargo clippy --workspace --all-targets --locked -- -D warnings
. .ci/deny/check.sh
