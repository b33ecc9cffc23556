# The simulated cell: same seed, same log, in both build profiles; a thousand random situations; its speed.
cargo build --locked -p hil-sim
cargo build --release --locked -p hil-sim
out=target/sim-stage
rm -rf "$out" && mkdir -p "$out"
for scenario in hil-sim/scenarios/*.toml; do
    name=$(basename "$scenario" .toml)
    target/debug/hil-sim run "$scenario" --quiet --log "$out/$name.debug.log"
    target/release/hil-sim run "$scenario" --log "$out/$name.release.log"
    target/release/hil-sim run "$scenario" --quiet --log "$out/$name.again.log"
    cmp "$out/$name.debug.log" "$out/$name.release.log"
    cmp "$out/$name.release.log" "$out/$name.again.log"
done
# The seed must matter, or the comparison above proves nothing.
target/release/hil-sim run hil-sim/scenarios/all_faults.toml --quiet --seed 12 --log "$out/other.log"
if cmp -s "$out/other.log" "$out/all_faults.release.log"; then
    echo "another seed gave the same log" >&2
    exit 1
fi
# A log replayed gives the same answers.
target/release/hil-sim replay "$out/cycle.release.log" --scenario hil-sim/scenarios/cycle.toml
target/release/hil-sim swarm --seeds 1000 --duration-s 0.5
# Speed: printed, never asserted.
cargo bench --locked -p hil-sim --bench virtual_time
