# Tests that take a core 5 s or longer, too long for the gate: those that say so in `#[ignore = "…: run by the stage long of CI"]`. Each
# of them runs, and no other. Suites with a stage of their own run their long tests there.
cargo test --workspace --locked --test tests -- --ignored | tee target/long.log
marked=$(grep -rhE --include='*.rs' '#\[ignore = ".*: run by the stage long of CI"\]' firmware hil-sim host protocol robots tests | wc -l)
passed=$(grep -cE '^test .* \.\.\. ok$' target/long.log)
echo "$passed of $marked long tests passed"
[ "$marked" -gt 0 ] && [ "$passed" -eq "$marked" ]
