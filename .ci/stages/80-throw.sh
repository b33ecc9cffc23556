# The main job on every runner, as one table: virtual time; real time over socketcand, with the controller inside cubectl
# and as a process of its own; real time over vcan, in an emulated machine where this one has no vcan; and on an emulated
# Cortex-M4F. The ball must land within 10 mm in each, by the simulated cell's own account. Then many throws at random
# targets, and many arms that are not the model.
#
# Real time needs a machine that is not busy elsewhere. cubectl measures what holds, chooses its period, and refuses if
# none does; a controller that is held up later stops the arm, and where the simulated cell is held up for some 20 ms the
# ball lands too far off. Each is tried again, later each time, because a machine that others share is held up for a
# while; the table says how often.
#
# By hand, from the root (after the builds below):
#   target/release/hil-sim serve --bus socketcand://127.0.0.1:29536/can0 --bus slcan://127.0.0.1:3333 &
#   qemu-system-arm -M netduinoplus2 -kernel target/boards/thumbv7em-none-eabihf/release/firmware-qemu -display none \
#       -monitor none -semihosting-config enable=on,target=native -serial tcp:127.0.0.1:3333,nodelay=on &
#   target/release/cubectl throw --target 1,1,-1 --bus socketcand://127.0.0.1:29536/can0 --controller 10
# QEMU runs without -icount: its timers are then the machine's clock. Start it in a folder without `script.bin`.
. .ci/again.sh
. .ci/serve.sh
. .ci/vcan-packages.sh
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }
cargo build --quiet --release --locked -p host -p hil-sim --bins
target=thumbv7em-none-eabihf
elf=$PWD/target/boards/$target/release/firmware-qemu
(cd firmware/boards/qemu && CARGO_TARGET_DIR=../../../target/boards cargo build --quiet --release --locked --target $target)
bin=$PWD/target/release
out=$PWD/target/throw
rm -rf "$out"
mkdir -p "$out"
pids=()
end_all() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2>/dev/null || true; done
    for pid in "${pids[@]}"; do wait "$pid" || true; done
    pids=()
}
trap end_all EXIT

echo "--- virtual time"
"$bin/cubectl" throw --target 1,1,-1 --no-store --out "$out/sim"

attempt() { # name, options of throw...
    local name=$1 dir=$out/$1 socketcand= slcan=
    shift
    rm -rf "$dir" "$dir.cell.json"
    serve "$dir.cell.json" socketcand://127.0.0.1:0/can0 slcan://127.0.0.1:0 || return 1
    pids+=("$server")
    socketcand=$(place "$dir.cell.json" socketcand:)
    slcan=$(place "$dir.cell.json" slcan: | sed 's|^slcan://||')
    case $name in
    qemu)
        (cd "$out" && exec qemu-system-arm -M netduinoplus2 -kernel "$elf" -display none -monitor none \
            -semihosting-config enable=on,target=native -serial "tcp:$slcan,nodelay=on" </dev/null) &
        pids+=($!)
        # Real-time priority where it is allowed, as our own programs ask for.
        chrt -a -f -p 35 $! 2>/dev/null || true
        ;;
    process)
        "$bin/cubectl" controller --bus "$socketcand" >"$dir.controller.log" 2>&1 </dev/null &
        pids+=($!)
        # It measures first, and is on the bus then.
        for _ in $(seq 50); do
            grep -q 'Ctrl-C stops' "$dir.controller.log" && break
            kill -0 $! 2>/dev/null || break
            sleep 0.1
        done
        ;;
    esac
    local status=0
    timeout 120 "$bin/cubectl" throw --target 1,1,-1 --no-store --bus "$socketcand" --out "$dir" "$@" </dev/null || status=$?
    # The ball is still in the air.
    sleep 1
    end_all
    # The row of the table to come: it ends with 1 if the ball landed too far off.
    [ $status -ne 0 ] || .ci/throw-table "$name=$dir/summary.json,$dir.cell.json" || status=$?
    [ $status -eq 0 ] || cat "$dir.controller.log" 2>/dev/null || true
    return $status
}
rows=("virtual time=$out/sim/summary.json")
throw() { # name, words for the table, options of throw...
    local name=$1 words=$2
    shift 2
    echo "--- $words"
    again 6 attempt "$name" "$@" || { echo "$name: no throw came to its end" >&2; return 1; }
    rows+=("$words=$out/$name/summary.json#$tried,$out/$name.cell.json")
}
throw socketcand "socketcand, inside cubectl" --controller soft
throw process "socketcand, own process" --controller 10
throw qemu "QEMU Cortex-M4F, SLCAN" --controller 10

echo "--- vcan"
if ip link add vcan0 type vcan 2>/dev/null || ip link show vcan0 >/dev/null 2>&1; then
    run=(env PATH="$bin:$PATH" sh .ci/vcan-throw.sh)
else
    export VCAN_VM_WITH="target/release/cubectl target/release/hil-sim"
    run=(.ci/vcan-vm .ci/vcan-throw.sh)
fi
code=0
"${run[@]}" >"$out/vcan.log" 2>&1 || code=$?
sed '/^--- summary.json/,/^--- end/d' "$out/vcan.log"
[ $code -eq 0 ]
sed -n '/^--- summary.json/,/^--- cell.json/p' "$out/vcan.log" | sed '1d;$d' >"$out/vcan.json"
sed -n '/^--- cell.json/,/^--- end/p' "$out/vcan.log" | sed '1d;$d' >"$out/vcan.cell.json"
rows+=("vcan=$out/vcan.json#$(sed -n 's/^--- tries //p' "$out/vcan.log"),$out/vcan.cell.json")

echo "--- table"
.ci/throw-table "${rows[@]}"

# In the profile of the stage test, which has built them. All of them, in the release profile, take three minutes and their build:
#   THROWS=1000 SEEDS=200 cargo test --release -p cell-tests --test throw -- --ignored --nocapture
THROWS=${THROWS:-150} SEEDS=${SEEDS:-60} cargo test --workspace --locked --test throw -- --ignored --nocapture
