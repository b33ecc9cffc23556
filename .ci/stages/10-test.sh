# The second command of the README: the tests that need nothing installed and take seconds.
. .ci/tree-state.sh
# Some tests wait for programs. More of them at a time keep the cores busy.
export RUST_TEST_THREADS=$((2 * $(nproc)))
cargo test --workspace --locked
# For the stage readme, which need not do it again.
tree_state >target/tests-passed
