# Faults: every kind in every phase of a throw and at every joint, judged from the plant itself; about two minutes on two
# cores. The test stage runs one in forty of them. Then random throws from a fixed first seed: one minute.
cargo test --locked -p cell-tests --test trust -- --ignored --nocapture
cargo build --quiet --locked -p host --bins
rm -rf target/swarm-found
target/debug/cubectl swarm --first 0 --seeds 1000 --out target/swarm-found
