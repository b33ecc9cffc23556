# Faults: every kind in every phase of a throw and at every joint, judged from the plant itself; about three minutes on two
# cores. The test stage runs one in forty of them. Then random throws from a fixed first seed: one minute.
cargo test --release --locked -p cell-tests --test trust -- --ignored --nocapture
cargo build --quiet --release --locked -p host --bins
rm -rf target/swarm-found
target/release/cubectl swarm --first 0 --seeds 1000 --out target/swarm-found
