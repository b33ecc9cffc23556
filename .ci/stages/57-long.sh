# Tests that take a core 5 s and longer, too long for the gate: 5 of the planner, 3 of the operator. The suites with a stage of their own
# have others.
cargo test --workspace --locked --test tests -- --ignored | tee target/long.log
grep -q '5 passed' target/long.log
grep -q '3 passed' target/long.log
