# Fuzzing of everything in `protocol` that reads foreign bytes, and of the whole controller under scripts of frames: at
# least ten million executions in all, from the committed seeds. A found input is left in the folder `artifacts` beside
# `seeds`.
#   FUZZ_LONG=1 .ci/run fuzz     a thousand million executions: about two hours of one core
export CARGO_TARGET_DIR=$PWD/target/fuzz
# What `cargo fuzz build --sanitizer none` asks of the compiler: counters at each edge, and the operands of comparisons. No
# sanitizer: the crate forbids unsafe code, so what can go wrong is a panic. Then it needs no nightly compiler either.
# A target is named, or these flags would hold for build scripts too.
host=$(rustc -vV | sed -n 's/^host: //p')
coverage=(level=4 inline-8bit-counters pc-table trace-compares)
for fuzz in protocol/fuzz firmware/fuzz; do
    RUSTFLAGS="-Cpasses=sancov-module ${coverage[*]/#/-Cllvm-args=-sanitizer-coverage-} \
        -Cllvm-args=-simplifycfg-branch-fold-threshold=0 -Ccodegen-units=1 --cfg fuzzing" \
        cargo build --release --locked --manifest-path $fuzz/Cargo.toml --target "$host"
done
bin=$CARGO_TARGET_DIR/$host/release
out=$CARGO_TARGET_DIR/runs
rm -rf "$out"

# target, executions in thousands: in a run of CI, in a long one; longest input in bytes.
# Most of the long run goes to the targets that read what any node of the bus may send.
table='powercube 2500 550000 13
cyphal_frames 1000 40000 256
cyphal_transfers 300 5000 400
candump 2500 345000 80
slcan 1000 30000 160
socketcand 1000 15000 160
controller 100 2000 2000
rsi_telegram 500 10000 1200
rsi_config 200 4000 4000
rsi_stream 300 6000 5000
dtrack 1000 15000 1000
vrpn 1000 15000 600
mit 500 10000 13
odrive 500 10000 13
canopen 500 10000 130'
if [ -n "${FUZZ_LONG:-}" ]; then least=1000000000; else least=10000000; fi
plan=$(awk -v long="${FUZZ_LONG:-}" '{ print $1, long ? $3 : $2, $4 }' <<<"$table")

one() { # target thousands max_len
    local log=$out/$1.log corpus=$out/$1 fuzz=protocol/fuzz
    [ -d $fuzz/seeds/"$1" ] || fuzz=firmware/fuzz
    local artifacts=$fuzz/artifacts/$1
    mkdir -p "$corpus" "$artifacts"
    "$bin/$1" "$corpus" $fuzz/seeds/"$1" -runs="$2"000 -max_len="$3" -timeout=10 \
        -artifact_prefix="$artifacts"/ -print_final_stats=1 >"$log" 2>&1
}
export -f one
export bin out

# Two at a time; a failed one does not stop the others.
start=$SECONDS
status=0
xargs -P "$(nproc)" -L 1 bash -euo pipefail -c 'one "$@"' fuzz <<<"$plan" || status=$?

total=0
while read -r target _; do
    log=$out/$target.log
    runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
    took=$(sed -n 's/^Done [0-9]* runs in \([0-9]*\) second.*/\1/p' "$log")
    if [ -z "$took" ]; then
        echo "$target FAILED after ${runs:-no} executions:"
        grep -A 12 -E 'panicked|ERROR|SUMMARY' "$log" | head -30 || tail -20 "$log"
        status=1
    else
        printf '%-18s %10d executions %8d per second\n' "$target" "$runs" $((runs / (took > 0 ? took : 1)))
    fi
    total=$((total + ${runs:-0}))
done <<<"$plan"
printf '%-18s %10d executions in %d s\n' "all" "$total" $((SECONDS - start))
[ $total -ge $least ] || { echo "fewer than $least executions"; status=1; }
exit $status
