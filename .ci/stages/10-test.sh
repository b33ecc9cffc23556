# The second command of the README: every test that needs nothing installed.
cargo test --workspace --locked
