# The main job on every runner, as one table: virtual time, real time over socketcand with the controller in cubectl's own
# process, vcan (written by the stage vcan), and the emulated Cortex-M4F (image of the stage qemu-live). Then many
# throws at random targets, and many arms that are not the model.
#
# Real time needs a machine that is not busy elsewhere, so the controller of this program runs at the paper's 17 ms here,
# with gains tuned for it, and what the machine's other work spoils is tried again, twice.
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }
cargo build --quiet --release --locked -p host -p hil-sim
target=thumbv7em-none-eabihf
elf=$PWD/target/boards/$target/release/firmware-qemu
(cd firmware/boards/qemu && CARGO_TARGET_DIR=../../../target/boards cargo build --quiet --release --locked --target $target)
bin=$PWD/target/release
out=$PWD/target/throw
mkdir -p "$out"
rm -rf "$out"/{sim,socketcand,qemu}
soon() { if chrt -f 20 true 2>/dev/null; then exec chrt -f 20 "$@"; else exec "$@"; fi; }
pids=()
end_all() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2>/dev/null || true; done
    for pid in "${pids[@]}"; do wait "$pid" || true; done
    pids=()
}
trap end_all EXIT

"$bin/cubectl" tune --period 0.017 --out "$out/gains-17ms.toml" >/dev/null
"$bin/cubectl" throw --target 1,1,-1 --no-store --out "$out/sim"

attempt() { # name, options of throw...
    local name=$1 dir=$out/$1 socketcand= slcan=
    shift
    rm -rf "$dir" "$dir.log"
    (soon "$bin/hil-sim" serve --bus socketcand://127.0.0.1:0/can0 --bus slcan://127.0.0.1:0 --json \
        >"$dir.log" </dev/null) &
    pids+=($!)
    for _ in $(seq 100); do
        socketcand=$(sed -n 's|.*socketcand://127.0.0.1:\([0-9]*\)/can0.*|\1|p' "$dir.log" | head -n 1)
        slcan=$(sed -n 's|.*slcan://127.0.0.1:\([0-9]*\).*|\1|p' "$dir.log" | head -n 1)
        [ -n "$socketcand" ] && [ -n "$slcan" ] && break
        sleep 0.1
    done
    if [ "$name" = qemu ]; then
        (cd "$out" && soon qemu-system-arm -M netduinoplus2 -kernel "$elf" -display none -monitor none \
            -semihosting-config enable=on,target=native -serial "tcp:127.0.0.1:$slcan,nodelay=on" </dev/null) &
        pids+=($!)
    fi
    local status=0
    timeout 120 "$bin/cubectl" throw --target 1,1,-1 --no-store --bus "socketcand://127.0.0.1:$socketcand/can0" \
        --out "$dir" "$@" </dev/null || status=$?
    end_all
    return $status
}
throw() {
    for try in 1 2 3; do
        if attempt "$@"; then return; fi
    done
    echo "$1: no throw came to its end" >&2
    return 1
}
throw socketcand --controller soft --gains "$out/gains-17ms.toml"
throw qemu --controller 10

rows=("virtual time=$out/sim/summary.json" "socketcand=$out/socketcand/summary.json")
[ ! -s "$out/vcan.json" ] || rows+=("vcan=$out/vcan.json")
rows+=("QEMU Cortex-M4F=$out/qemu/summary.json")
.ci/throw-table "${rows[@]}"

THROWS=${THROWS:-1000} SEEDS=${SEEDS:-200} cargo test --release --locked -p cell-tests --test throw -- --ignored --nocapture
