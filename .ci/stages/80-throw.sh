# The main job on every runner, as one table. The ball must land within 10 mm in each, by the simulated cell's own account.
#
#   virtual time    everything in one program
#   lock step       cell, controller and cubectl are programs that share virtual time over a socket: the controller inside
#                   cubectl, as a process of its own, and on an emulated Cortex-M4F whose instructions are counted. Each is
#                   thrown twice, the second time on a machine with six times as many busy loops as cores; the recordings
#                   must be the same, byte for byte. Nothing is repeated
#   real time       inside cubectl and as a process of its own, by a clock that takes four seconds for one (.ci/slow.sh): a machine of
#                   CI stops for up to 50 ms, longer than any control period. A throw that was stopped, or refused because no
#                   period holds, is repeated once (.ci/timed.sh counts); one that landed too far off never. The emulated Cortex-M4F homes the arm over SLCAN and does not throw: its UART
#                   takes one byte at a time and carries 20 to 55 kB/s, by machine. A cycle of a throw is 12 exchanges of 44
#                   bytes, so 26 ms at 20 kB/s, and telemetry; the longest period of the controller is 40 ms
#   vcan            over a CAN interface of a kernel: in an emulated machine that counts instructions, which nobody holds up
#                   and where nothing is repeated; where this kernel has vcan itself, in real time
#
# Then many throws at random targets, and many arms that are not the model.
#
# By hand, from the root (after the builds below):
#   target/release/hil-sim serve --bus socketcand://127.0.0.1:29536/can0 --bus slcan://127.0.0.1:3333 &
#   qemu-system-arm -M netduinoplus2 -kernel target/boards/thumbv7em-none-eabihf/release/firmware-qemu -display none \
#       -monitor none -semihosting-config enable=on,target=native -serial tcp:127.0.0.1:3333,nodelay=on &
#   target/release/cubectl home --bus socketcand://127.0.0.1:29536/can0 --controller 10
# Here QEMU runs without -icount: its timers are then the machine's clock. Start it in a folder without `script.bin`.
. .ci/toolchain.sh
. .ci/timed.sh
. .ci/serve.sh
. .ci/slow.sh
. .ci/vcan-packages.sh
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }
target=thumbv7em-none-eabihf
cargo build --quiet --release --locked -p host -p hil-sim --bins
cargo build --quiet --release --locked -p cell-tests --example board
board() { # features: the board's program
    (cd firmware/boards/qemu && cargo build --quiet --release --locked --target $target "$@")
}
bin=$PWD/target/release
out=$PWD/target/throw
rm -rf "$out"
mkdir -p "$out"
board --features script
cp target/boards/$target/release/firmware-qemu "$out/coupled.elf"
board
elf=$PWD/target/boards/$target/release/firmware-qemu
emulator() { # program, options…
    local program=$1
    shift
    exec qemu-system-arm -M netduinoplus2 -kernel "$program" -display none -monitor none \
        -semihosting-config enable=on,target=native "$@" </dev/null
}
pids=()
end_all() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2>/dev/null || true; done
    # An emulator that waits for the other end of a pipe does not hear it.
    for _ in $(seq 100); do
        kill -0 "${pids[@]}" 2>/dev/null || break
        sleep 0.1
    done
    for pid in "${pids[@]}"; do kill -KILL "$pid" 2>/dev/null || true; done
    for pid in "${pids[@]}"; do wait "$pid" || true; done
    pids=()
}
trap end_all EXIT
# Waits until the file of a process says something.
said() { # process, file, text
    wait_for "$1" says "$2" "$3" && return 0
    shift
    echo "$1 does not say '$2':" >&2
    cat "$1" >&2
    return 1
}
rows=("virtual time=$out/sim/summary.json")

echo "--- virtual time"
"$bin/cubectl" throw --target 1,1,-1 --out "$out/sim"

in_step() { # name, runner
    local dir=$out/$1 runner=$2 clients=2 words=(--controller 10) bus=
    mkdir -p "$dir"
    [ "$runner" != soft ] || { clients=1 words=(--controller soft); }
    serve "$dir.cell.json" "lockstep://127.0.0.1:0/can0?clients=$clients" || return 1
    pids+=("$server")
    bus=$(place "$dir.cell.json" lockstep:)
    case $runner in
    process)
        "$bin/cubectl" controller run --bus "$bus" --period-ms 5 >"$dir/controller.log" 2>&1 </dev/null &
        pids+=($!)
        ;;
    board)
        words+=(--gains "$PWD/host/tuner/gains/powercube6-5ms.toml")
        mkfifo "$dir/cell.in" "$dir/cell.out"
        (cd "$dir" && emulator "$out/coupled.elf" -serial null -icount shift=3,align=off,sleep=off) &
        pids+=($!)
        "$bin/examples/board" "$bus" "$dir" >"$dir/board.log" 2>&1 &
        pids+=($!)
        ;;
    esac
    # Clients have their turns in the order in which they asked for lock step, and they do that some time after they have connected.
    [ "$runner" = soft ] || said "$server" "$dir.cell.json" 'turn 1 in lock step' || return 1
    local status=0
    timeout 900 "$bin/cubectl" throw --yes --target 1,1,-1 --bus "$bus" --out "$dir/out" "${words[@]}" </dev/null || status=$?
    # The cell first: time stands when the throw has left.
    end_all
    [ $status -eq 0 ] || cat "$dir"/*.log 2>/dev/null || true
    return $status
}
twice() { # runner, words for the table
    local runner=$1 words=$2 loops=()
    echo "--- $words"
    in_step "$runner" "$runner"
    for _ in $(seq $((6 * $(nproc)))); do
        (while :; do :; done) &
        loops+=($!)
    done
    local status=0
    in_step "$runner-busy" "$runner" || status=$?
    kill "${loops[@]}"
    wait "${loops[@]}" 2>/dev/null || true
    [ $status -eq 0 ] || return $status
    cmp "$out/$runner/out/bus.log" "$out/$runner-busy/out/bus.log"
    echo "$words: the same $(wc -l <"$out/$runner/out/bus.log") frames on a busy machine"
    rows+=("$words=$out/$runner/out/summary.json,$out/$runner.cell.json")
}
twice soft "lock step, inside cubectl"
twice process "lock step, own process"
twice board "lock step, Cortex-M4F"

# The joints stand where the controller reports, by the account of the cell.
homed() { # output of home, account of the cell
    python3 - "$@" <<'PYTHON'
import json, sys
reported = {module["module"]: module["position_rad"] for module in json.load(open(sys.argv[1]))["modules"]}
drives = json.loads(open(sys.argv[2]).read().strip().splitlines()[-1])["drives"]
off = {drive["module"]: abs(drive["q_rad"] - reported[drive["module"]]) for drive in drives}
assert len(off) == 6 and max(off.values()) < 1e-3, off
assert all(abs(drive["v_rad_s"]) < 1e-3 for drive in drives), drives
print(f"6 joints homed and at rest, {1e3 * max(off.values()):.2f} mrad from what was reported at most")
PYTHON
}
attempt() { # name, options...
    local name=$1 dir=$out/$1 socketcand= slcan=
    shift
    rm -rf "$dir" "$dir.cell.json"
    # An emulator has the timers of the machine.
    clock=("${slower[@]}")
    [ "$name" != qemu ] || clock=()
    serve "$dir.cell.json" socketcand://127.0.0.1:0/can0 slcan://127.0.0.1:0 || return 1
    pids+=("$server")
    socketcand=$(place "$dir.cell.json" socketcand:)
    slcan=$(place "$dir.cell.json" slcan: | sed 's|^slcan://||')
    case $name in
    qemu)
        (cd "$out" && emulator "$elf" -serial "tcp:$slcan,nodelay=on") &
        pids+=($!)
        # Real-time priority where it is allowed, as our own programs ask for.
        chrt -a -f -p 35 $! 2>/dev/null || true
        ;;
    own)
        "${clock[@]}" "$bin/cubectl" controller run --bus "$socketcand" >"$dir.controller.log" 2>&1 </dev/null &
        pids+=($!)
        # It measures first, and is on the bus then.
        said $! "$dir.controller.log" 'Ctrl-C stops' || true
        ;;
    esac
    local status=0
    local reader=
    if [ "$name" = own ]; then
        # Another person looks at the settings while the arm moves. It must leave the motion alone.
        (sleep 36 && exec "${clock[@]}" "$bin/cubectl" controller registers list --bus "$socketcand" >"$dir.registers" 2>&1 </dev/null) &
        reader=$!
    fi
    if [ "$name" = qemu ]; then
        timeout 120 "$bin/cubectl" home --json --bus "$socketcand" "$@" >"$dir.json" </dev/null || status=$?
        end_all
        [ $status -ne 0 ] || homed "$dir.json" "$dir.cell.json" || status=$not_repeated
        return $status
    fi
    timeout 480 "${clock[@]}" "$bin/cubectl" throw --yes --target 1,1,-1 --bus "$socketcand" --out "$dir" "$@" </dev/null || status=$?
    # A throw that has failed keeps its own reason.
    [ -z "$reader" ] || wait "$reader" || [ $status -ne 0 ] || status=$not_repeated
    # The ball is still in the air.
    sleep 4
    end_all
    if [ $status -eq 0 ]; then
        # The row of the table to come: it ends with 1 if the ball landed too far off. That has nothing to do with time.
        .ci/throw-table "$name=$dir/summary.json,$dir.cell.json" || status=$not_repeated
    elif [ $status -eq 11 ] || [ $status -eq 12 ]; then
        # Missed, or not released.
        status=$not_repeated
    fi
    [ $status -eq 0 ] || cat "$dir.controller.log" 2>/dev/null || true
    return $status
}
throw() { # name, words for the table, options of throw...
    local name=$1 words=$2
    shift 2
    echo "--- $words"
    timed attempt "$name" "$@" || { echo "$name: no throw came to its end" >&2; return 1; }
    rows+=("$words=$out/$name/summary.json#$tried,$out/$name.cell.json")
}
throw socketcand "socketcand, inside cubectl" --controller soft
throw own "socketcand, own process" --controller 10
echo "--- QEMU Cortex-M4F, SLCAN"
timed attempt qemu --controller 10

echo "--- vcan"
vcan() {
    local code=0
    "${run[@]}" >"$out/vcan.log" 2>&1 || code=$?
    sed '/^--- summary.json/,/^--- end/d' "$out/vcan.log"
    return $code
}
tried=1
if ip link add vcan0 type vcan 2>/dev/null || ip link show vcan0 >/dev/null 2>&1; then
    run=(env PATH="$bin:$PATH" sh .ci/vcan-throw.sh)
    timed vcan
else
    export VCAN_VM_WITH="target/release/cubectl target/release/hil-sim"
    run=(.ci/vcan-vm .ci/vcan-throw.sh)
    vcan
fi
sed -n '/^--- summary.json/,/^--- cell.json/p' "$out/vcan.log" | sed '1d;$d' >"$out/vcan.json"
sed -n '/^--- cell.json/,/^--- end/p' "$out/vcan.log" | sed '1d;$d' >"$out/vcan.cell.json"
rows+=("vcan=$out/vcan.json#$tried,$out/vcan.cell.json")

echo "--- table"
.ci/throw-table "${rows[@]}"

# In the profile of the stage test, which has built them. All of them take three minutes in the release profile, and its build:
#   THROWS=1000 SEEDS=200 cargo test --release -p cell-tests --test throw -- --ignored --nocapture
THROWS=${THROWS:-150} SEEDS=${SEEDS:-200} cargo test --workspace --locked --test throw -- --ignored --nocapture
