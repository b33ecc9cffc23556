# Faults: every kind in every phase of a throw and at every joint, judged from the plant itself; about four minutes on two
# cores. The test stage runs one in forty of them.
cargo test --release --locked -p cell-tests --test trust -- --ignored --nocapture
