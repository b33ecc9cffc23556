# Real throws in real time: the simulated cell behind a socketcand and an SLCAN port, a controller as one more node on its
# bus, and cubectl as the host that uploads, arms and runs over Cyphal. The ball must land within 10 mm.
# Controllers: the Cortex-M4F image in QEMU on the SLCAN port, and the same core as a Linux process.
#
# By hand, from the root (after the builds below):
#   target/release/hil-sim serve --scenario target/live/qemu/cell.toml \
#       --bus socketcand://127.0.0.1:29536/can0 --bus slcan://127.0.0.1:3333 &
#   qemu-system-arm -M netduinoplus2 -kernel target/boards/thumbv7em-none-eabihf/release/firmware-qemu -display none \
#       -monitor none -semihosting-config enable=on,target=native -serial tcp:127.0.0.1:3333,nodelay=on &
#   target/release/cubectl run target/live/qemu/throw.ctrj --bus socketcand://127.0.0.1:29536/can0 --controller 10
# The board opens the SLCAN channel by itself, has node-ID 10, and a period of 34 ms (firmware/boards/qemu/src/live.rs says
# why). QEMU runs without -icount: its timers are then the machine's clock. Start it in a folder without `script.bin`.
#
# Real time needs a machine that is not busy elsewhere: an attempt in which the controller stops the arm because its cycles
# came late is tried again, twice.
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }
target=thumbv7em-none-eabihf
elf=$PWD/target/boards/$target/release/firmware-qemu
cargo build --quiet --release --locked -p hil-sim -p host
cargo build --quiet --release --locked -p cell-tests --example published_throw
(cd firmware/boards/qemu && CARGO_TARGET_DIR=../../../target/boards cargo build --quiet --release --locked --target $target)
bin=$PWD/target/release
out=$PWD/target/live
rm -rf "$out"
mkdir -p "$out"

# Real-time priority where it is allowed, as the README of a real arm advises.
soon() { if chrt -f 20 true 2>/dev/null; then exec chrt -f 20 "$@"; else exec "$@"; fi; }
pids=()
end_all() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2>/dev/null || true; done
    for pid in "${pids[@]}"; do wait "$pid" || true; done
    pids=()
}
trap end_all EXIT

qemu() { # slcan port
    cd "$dir"
    soon qemu-system-arm -M netduinoplus2 -kernel "$elf" -display none -monitor none \
        -semihosting-config enable=on,target=native -serial "tcp:127.0.0.1:$slcan,nodelay=on"
}
process() { soon "$bin/cubectl" controller --bus "socketcand://127.0.0.1:$socketcand/can0" "$@"; }

attempt() { # name, period in us, controller...
    local name=$1 period=$2 dir=$out/$1 socketcand= slcan=
    shift 2
    rm -rf "$dir"
    "$bin/examples/published_throw" "$period" "$dir"
    (soon "$bin/hil-sim" serve --scenario "$dir/cell.toml" --bus socketcand://127.0.0.1:0/can0 \
        --bus slcan://127.0.0.1:0 --json >"$dir/sim.log" </dev/null) &
    pids+=($!)
    for _ in $(seq 100); do
        socketcand=$(sed -n 's|.*socketcand://127.0.0.1:\([0-9]*\)/can0.*|\1|p' "$dir/sim.log" | head -n 1)
        slcan=$(sed -n 's|.*slcan://127.0.0.1:\([0-9]*\).*|\1|p' "$dir/sim.log" | head -n 1)
        [ -n "$socketcand" ] && [ -n "$slcan" ] && break
        sleep 0.1
    done
    ("$@" >"$dir/controller.log" 2>&1 </dev/null) &
    pids+=($!)
    local status=0
    timeout 60 "$bin/cubectl" run "$dir/throw.ctrj" --bus "socketcand://127.0.0.1:$socketcand/can0" --controller 10 \
        --json --record "$dir/bus" >"$dir/run.json" 2>"$dir/run.log" || status=$?
    # The ball is still in the air.
    sleep 0.8
    end_all
    [ $status -eq 0 ] || { echo "  $name: $(cat "$dir/run.log" "$dir/controller.log" | tr '\n' ' ')"; return 1; }
    python3 - "$dir" "$name" "$period" <<'PY'
import json, pathlib, re, statistics, sys
dir, name, period_us = pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
report = json.loads(dir.joinpath("sim.log").read_text().splitlines()[-1])
run = json.loads(dir.joinpath("run.json").read_text())
landing = report["throw"]["landing_m"]
assert landing, "the ball was not released"
miss_mm = 1e3 * ((landing[0] - 1.0) ** 2 + (landing[1] - 1.0) ** 2) ** 0.5
# Motions to module 1 as the host saw them: the cycle on the bus.
times = [float(m[1]) for m in re.finditer(r"^\(([0-9.]+)\) \S+ 0E1#0B0E", dir.joinpath("bus.candump").read_text(), re.M)]
gaps = [1e6 * (b - a) for a, b in zip(times, times[1:])]
late = sorted(abs(gap - period_us) for gap in gaps if gap < 3 * period_us)
at = lambda share: late[min(len(late) - 1, int(share * len(late)))]
print(f"  {name}: landed {miss_mm:.1f} mm beside the target; {run['cycles_late']} late cycles, "
      f"{run['replies_missed']} missed replies; cycle jitter on the bus, us: median {at(0.5):.0f}, 99 % {at(0.99):.0f}, "
      f"worst {late[-1]:.0f} of {len(late)} cycles; bus late by us: {report['lateness_us']}")
sys.exit(0 if miss_mm <= 10.0 else 1)
PY
}
throw() {
    for try in 1 2 3; do
        if attempt "$@"; then return; fi
    done
    echo "$1: no throw landed within 10 mm" >&2
    return 1
}
throw qemu 34000 qemu
throw linux 17000 process --paper
