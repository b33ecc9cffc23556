# The simulated cell: same seed, same log, in both build profiles and on every host; a thousand random situations.
# Its speed: `cargo bench -p hil-sim`.
. .ci/debug-build.sh
# Released are programs only, as the README builds them: with examples the libraries would have other features, and be
# built once more for it.
cargo build --release --locked -p host -p hil-sim --bins
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
# The same bits on other machines: checksums of the logs as first recorded. After a wanted change of the simulator:
#   (cd target/sim-stage && sha256sum *.release.log) >hil-sim/scenarios/SHA256SUMS
(cd "$out" && sha256sum --check --strict ../../hil-sim/scenarios/SHA256SUMS)
# The seed must matter, or the comparison above proves nothing.
target/release/hil-sim run hil-sim/scenarios/all_faults.toml --quiet --seed 12 --log "$out/other.log"
if cmp -s "$out/other.log" "$out/all_faults.release.log"; then
    echo "another seed gave the same log" >&2
    exit 1
fi
target/release/hil-sim swarm --seeds 1000 --duration-s 0.5
