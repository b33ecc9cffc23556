# The second command of the README: every test that needs nothing installed.
. .ci/tree-state.sh
cargo test --workspace --locked
# For the stage readme, which need not do it again.
tree_state >target/tests-passed
