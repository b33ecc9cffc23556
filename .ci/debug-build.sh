# Sourced by stages that run unoptimised programs or examples: builds them all, just as the stage test does. Built one by
# one they would have other features of the libraries they share, and those would be compiled again for each.
cargo test --quiet --workspace --locked --no-run
