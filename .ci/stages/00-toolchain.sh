. .ci/toolchain.sh
cargo --version
rustc --version
