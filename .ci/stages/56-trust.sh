# Faults: every kind in every phase of a throw and at every joint, judged from the plant itself; about two minutes on two
# cores. The test stage runs one in forty of them. And 400 random pairs of faults; without PAIRS it is 2 000. Then 200 perturbed arms, and random throws from a fixed first seed: two
# minutes.
. .ci/debug-build.sh
# The whole matrices of servos, MIT motors and ODrives do not fit in this time: the test stage runs samples, the rest is for a night.
PAIRS=400 cargo test --workspace --locked --test trust -- --ignored --nocapture --skip drives_that_follow_positions
# Latencies of stops, and how far from its gate the model of a healthy drive stays, over 200 arms.
SEEDS=200 cargo test --workspace --locked --test controller two_hundred -- --ignored --nocapture
rm -rf target/swarm-found
target/debug/cubelab swarm --first 0 --seeds 1000 --out target/swarm-found
# 100 000 drawn steps of orders and faults against the controller; the test stage plays the 10 000 before them, and without SEEDS it
# is a million.
SEEDS=167..1834 cargo test --workspace --locked --test sequences -- --ignored --nocapture
