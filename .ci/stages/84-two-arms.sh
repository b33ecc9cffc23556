# Rallies through the public interfaces: `hil-sim serve-two-arms` plays two arms on two buses, ball and tracker, `cubelab rally` throws and
# catches. What is reported must be what happened; the simulated cell is the judge. One throw is with a tracker that loses one frame in ten.
#
# First in lock step: buses, tracker and programs have one virtual time, so each ball is caught, and a second run, at the same time as the
# first, has the same outcome to the last digit. Then three rallies of ten throws.
#
# Then by the clock, ten times slower than real time (.ci/slow.sh), with a control period of 10 ms; three throws at once, each tried once. A
# controller waits two thirds of a period for the answer of a drive, and two answers in a row that come later stop its arm. A machine that stops
# for that long may do this or miss a ball. The cell measures its own lag, and a process beside both how late it is woken; the program under test
# sees neither: such a throw is counted as held up, and its report is judged all the same. The stage fails if a report is not what happened, if an
# arm stops by itself on a machine that was on time, or if all throws were held up.
. .ci/wait.sh
. .ci/pauses.sh
cargo build --quiet --release --locked -p lab -p hil-sim -p host --bins
out=target/two-arms
rm -rf "$out" && mkdir -p "$out"
cp hil-sim/src/two_arms/two_arms.toml "$out/lossy.toml"
printf '\n[[fault]]\nkind = "frames-lost"\nprobability = 0.1\n' >>"$out/lossy.toml"

in_step() { # name, first port, cell file, options of cubelab
    local name=$out/$1 first=$2 file=$3 cell status=0
    shift 3
    local places=(--bus-thrower "lockstep://127.0.0.1:$first/can0" --bus-catcher "lockstep://127.0.0.1:$((first + 1))/can0")
    target/release/hil-sim serve-two-arms --homed --json --cell "$file" --bus-thrower "${places[1]}?clients=2" \
        --bus-catcher "${places[3]}?clients=2" --data "127.0.0.1:$((first + 2))" >"$name.cell" 2>&1 </dev/null &
    cell=$!
    wait_for $cell says "$name.cell" '"event":"lock step"' || { cat "$name.cell"; return 1; }
    timeout 1200 target/release/cubelab rally --yes --json --cell "$file" "${places[@]}" --tracker "127.0.0.1:$((first + 2))" "$@" \
        >"$name.reported" 2>"$name.words" </dev/null || status=$?
    # It ends with its clients.
    [ $status = 0 ] || kill -INT $cell
    wait $cell && [ $status = 0 ] || { cat "$name.words" "$name.cell"; return 1; }
    # Without the ports, how long this machine took to decide, and to leave at the end.
    sed -e '/"event":"\(serving\|lock step\)"/d' -e 's/"datagrams":[0-9]*,//; s/"unsent":[0-9]*,//; s/"simulated_s":[0-9.]*,//' \
        "$name.cell" >"$name.outcome"
    sed '/longest_decision_s/d' "$name.reported" >>"$name.outcome"
}
# What cubelab reports of each throw against what the cell saw: all are caught.
judge_rally() { # name, throws
    python3 - "$out/$1" "$2" <<'PY'
import json, sys

name, throws = sys.argv[1], int(sys.argv[2])
cell = [json.loads(line) for line in open(name + ".cell")][-1]["throws"]
rally = json.load(open(name + ".reported"))
reported = [(e["thrower"], e["reported"] == "caught") for e in rally["exchanges"]]
happened = [(t["thrower"], t["caught"]) for t in cell]
miss_mm = [1e3 * t["crossing"]["miss_m"] for t in cell if t["crossing"]]
print(f"{name}: {rally['length']} of {throws} caught; off the axis at most {max(miss_mm, default=0):.1f} mm")
assert reported == happened, (reported, happened)
assert happened == [(1 + k % 2, True) for k in range(throws)], happened
assert rally["length"] == throws and rally["complete"], rally["length"]
assert not any(t["touched_floor"] for t in cell), cell
for exchange in rally["exchanges"]:
    trace = exchange["trace"]
    for who, least in (("thrower", 50), ("catcher", 100), ("ball", 50)):
        assert len(trace[who]["t_s"]) > least, (who, len(trace[who]["t_s"]))
PY
}
step_twice() { # name, first port, throws, cell file, options of cubelab
    local name=$1 first=$2 throws=$3 again
    shift 3
    in_step "$name-again" $((first + 3)) "$@" --throws "$throws" &
    again=$!
    in_step "$name" "$first" "$@" --throws "$throws" && wait $again || { wait $again; echo "$name: did not end in lock step"; return 1; }
    cmp "$out/$name.outcome" "$out/$name-again.outcome" || { echo "$name: two runs in lock step differ"; return 1; }
    judge_rally "$name" "$throws"
}
rally() { # first port, seed
    in_step "rally-$2" "$1" hil-sim/src/two_arms/two_arms.toml --throws 10 --seed "$2" && judge_rally "rally-$2" 10
}

# One arm and a ball that is thrown by hand: exit code, and whether the cell saw the ball come to rest in the cup.
alone() { # name, first port, ball, exit code, caught
    local name=$out/$1 place=lockstep://127.0.0.1:$2/can0 cell status=0
    target/release/hil-sim serve-two-arms --homed --json "--ball=$3" --ball-at-s 10 --bus-catcher "$place?clients=2" \
        --data "127.0.0.1:$(($2 + 1))" >"$name.cell" 2>&1 </dev/null &
    cell=$!
    wait_for $cell says "$name.cell" '"event":"lock step"' || { cat "$name.cell"; return 1; }
    timeout 300 target/release/cubectl catch --yes --for-s 12 --bus "$place" --tracker "127.0.0.1:$(($2 + 1))" \
        >"$name.reported" 2>"$name.words" </dev/null || status=$?
    kill -INT $cell 2>/dev/null || true
    wait $cell || { cat "$name.cell"; return 1; }
    echo "$name: $(head -n 1 "$name.reported") ($status)"
    [ $status = "$4" ] && says "$name.cell" "\"throws\":\[{\"caught\":$5" || { cat "$name.words" "$name.cell"; return 1; }
}

throw() { # name, first port, cell file, options of cubelab
    local name=$out/$1 first=$2 file=$3 cell status=0
    shift 3
    local places=(--bus-thrower "socketcand://127.0.0.1:$first/can0" --bus-catcher "socketcand://127.0.0.1:$((first + 1))/can0")
    "${slow[@]}" target/release/hil-sim serve-two-arms --homed --json --cell "$file" "${places[@]}" --data "127.0.0.1:$((first + 2))" \
        --duration-s 60 >"$name.cell" 2>&1 </dev/null &
    cell=$!
    wait_for $cell says "$name.cell" '"event":"real time"' || { cat "$name.cell"; return 1; }
    "${slow[@]}" target/release/cubelab rally --yes --json --throws 1 --period 10 --cell "$file" "${places[@]}" --tracker "127.0.0.1:$((first + 2))" "$@" \
        >"$name.reported" 2>"$name.words" </dev/null || status=$?
    kill -INT $cell
    wait $cell || { cat "$name.cell"; return 1; }
    echo $status >"$name.status"
}
judge() { # name
    python3 - "$out/$1" "$(cat "$out/$1.status")" "$pause_ms" <<'PY' || return $?
import json, sys

REPLY_DEADLINE_MS = 10 * 2 / 3  # reply_deadline_us of the controllers' settings
name, status, pause_ms = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])


def wrong(what):
    print(what)
    sys.exit(1)


cell = [json.loads(line) for line in open(name + ".cell")][-1]
held_up = max(*cell["worst_lag_ms"], pause_ms) > REPLY_DEADLINE_MS
throw = (cell["throws"] or [{"caught": False, "crossing": None}])[-1]
caught, released = throw["caught"], bool(cell["throws"])
reported = json.load(open(name + ".reported"))
if "what" in reported:
    # A fault or a refusal before the throw.
    print(f"{name}: ended with {status}; lag {cell['worst_lag_ms']} ms, pause {pause_ms} ms: {reported['what']}")
    if status != 8 or caught or not held_up:
        sys.exit(1)
    print("held up", file=open(name + ".caught", "w"))
    sys.exit(0)
broken = reported["broken"]
[reported] = reported["exchanges"]
word = reported["reported"]
print(f"{name}: reported {word} ({status}); caught: {caught}; released: {released}; "
      f"{(throw['crossing'] or {}).get('miss_m')} m off the axis; thrown: {reported['thrown']}; broken off: {broken}; "
      f"clocks {reported['clocks']}; lag {cell['worst_lag_ms']} ms, pause {pause_ms} ms")
if word == "caught" and not caught or word.startswith(("missed", "declined", "nothing")) and caught:
    wrong("what was reported is not what happened")
if (word == "caught" and reported["thrown"] == "ended" and broken is None) != (status == 0):
    wrong("the exit code is not what was reported")
if (reported["thrown"] != "ended" or broken is not None) and not held_up:
    wrong("an arm stopped by itself, and the machine was on time")
if reported["thrown"] == "ended" and not released:
    wrong("the thrower reported the end of a throw, and the ball was not released")
print("caught" if caught else "held up" if held_up else "missed", file=open(name + ".caught", "w"))
PY
}
status=0
step_twice step-knows 29600 2 hil-sim/src/two_arms/two_arms.toml --seed 1 || status=1
step_twice step-eyes 29610 1 hil-sim/src/two_arms/two_arms.toml --seed 2 --eyes-only || status=1
step_twice step-lossy 29620 1 "$out/lossy.toml" --seed 3 --eyes-only || status=1
alone hand-caught 29650 2.0,0.1,0.2,-2.3,-0.1,3.4 0 true || status=1
alone hand-declined 29652 2.0,0,0.2,1,0,1 3 false || status=1
rallies=()
for seed in 1 2 3; do
    rally $((29630 + 3 * seed)) $seed &
    rallies+=($!)
done
for one in "${rallies[@]}"; do
    wait "$one" || status=1
done
# Another seed is another throw.
! cmp -s "$out/step-knows.outcome" "$out/step-eyes.outcome" || { echo "two seeds gave one outcome"; status=1; }
watch_pauses
throws=()
throw knows 29556 hil-sim/src/two_arms/two_arms.toml --seed 1 &
throws+=($!)
throw eyes 29560 hil-sim/src/two_arms/two_arms.toml --seed 2 --eyes-only &
throws+=($!)
throw lossy 29564 "$out/lossy.toml" --seed 3 --eyes-only &
throws+=($!)
for one in "${throws[@]}"; do
    wait "$one" || status=1
done
end_pauses
for name in knows eyes lossy; do
    [ ! -e "$out/$name.status" ] || judge $name || status=1
done
for word in caught missed 'held up'; do
    echo "$(cat "$out"/*.caught | grep -c "$word" || true) $word"
done
grep -lqE 'caught|missed' "$out"/*.caught || { echo "no throw could be judged: the machine held up each of them"; status=1; }
exit $status
