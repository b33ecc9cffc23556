# Tests that take a core 5 s or longer, too long for the gate: 5 of the planner, 3 of the operator. Suites with a stage of their own run
# their long tests there.
cargo test --workspace --locked --test tests -- --ignored | tee target/long.log
grep -q 'ok\. 5 passed' target/long.log
grep -q 'ok\. 3 passed' target/long.log
