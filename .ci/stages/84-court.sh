# A throw and its catch in real time through the public doors: `hil-sim serve-court` plays two arms on two buses, ball and tracker,
# `cubectl rally` throws and catches. The court is the witness: what is told must be what happened. The last run is with a
# tracker that loses one frame in ten. At least two of three are caught. A machine that is held up may stop a throw or miss a ball
# and must say so. Virtual machines of two cores are: they stand for 4 to 9 ms at a time (the kernel's clock of samples stands too),
# and two drive answers in a row that are missed at a period of 5 ms stop an arm. The court tells its own lag, which the program under
# test does not see: a throw during which the court was late by more than a period is made again, with another seed, at most three times.
. .ci/timed.sh
. .ci/wait.sh
cargo build --quiet --release --locked -p host -p hil-sim --bins
out=target/court
rm -rf "$out" && mkdir -p "$out"
cp hil-sim/src/court/two_arms.toml "$out/lossy.toml"
printf '\n[[fault]]\nkind = "frames-lost"\nprobability = 0.1\n' >>"$out/lossy.toml"

throw() { # name, first port, court file, options of cubectl
    local name=$out/$1 first=$2 file=$3 court status=0
    shift 3
    local places=(--bus-thrower "socketcand://127.0.0.1:$first/can0" --bus-catcher "socketcand://127.0.0.1:$((first + 1))/can0")
    target/release/hil-sim serve-court --homed --json --court "$file" "${places[@]}" --data "127.0.0.1:$((first + 2))" \
        --duration-s 60 >"$name.court" 2>&1 </dev/null &
    court=$!
    wait_for $court says "$name.court" '"event":"real time"' || { cat "$name.court"; return 1; }
    target/release/cubectl rally --yes --json --court "$file" "${places[@]}" --tracker "127.0.0.1:$((first + 2))" "$@" \
        >"$name.told" 2>"$name.words" </dev/null || status=$?
    kill -INT $court
    wait $court || { cat "$name.court"; return 1; }
    python3 - "$name" $status $not_repeated <<'PY' || return $?
import json, sys

PERIOD_MS = 5
name, status = sys.argv[1], int(sys.argv[2])


def wrong(what):
    print(what)
    sys.exit(int(sys.argv[3]))


court = [json.loads(line) for line in open(name + ".court")][-1]
held_up = max(court["worst_lag_ms"]) > PERIOD_MS
caught = court["caught"]
try:
    told = json.load(open(name + ".told"))
except ValueError:
    # A fault or a refusal before the throw.
    words = open(name + ".words").read()
    print(f"{name}: ended with {status}; lag {court['worst_lag_ms']} ms: {words}")
    if status != 8 or caught or not held_up:
        sys.exit(1)
    print("held up", file=open(name + ".caught", "w"))
    sys.exit(0)
word = told["told"]
print(f"{name}: told {word} ({status}); caught: {caught}; released: {court['released']}; "
      f"{(court['crossing'] or {}).get('miss_m')} m off the axis; clocks {told['clocks']}; lag {court['worst_lag_ms']} ms")
if word == "caught" and not caught or word.startswith(("missed", "declined", "nothing")) and caught:
    wrong("what was told is not what happened")
if (word == "caught" and told["thrown"] == "ended") != (status == 0):
    wrong("the exit code is not what was told")
if told["thrown"] == "ended" and not court["released"]:
    wrong("the thrower told the end of a throw, and the ball was not released")
print("caught" if caught else "held up" if held_up else "missed", file=open(name + ".caught", "w"))
PY
}
until_judged() { # name, first port, court file, seed, options of cubectl
    local name=$1 first=$2 file=$3 seed=$4
    shift 4
    for more in 0 10 20 30; do
        throw "$name" "$first" "$file" --seed $((seed + more)) "$@" || return $?
        grep -q 'held up' "$out/$name.caught" || return 0
    done
}
all() {
    local caught
    until_judged knows 29556 hil-sim/src/court/two_arms.toml 1 || return $?
    until_judged eyes 29560 hil-sim/src/court/two_arms.toml 2 --eyes-only || return $?
    until_judged lossy 29564 "$out/lossy.toml" 3 --eyes-only || return $?
    caught=$(cat "$out"/*.caught | grep -c caught || true)
    [ "$caught" -ge 2 ] || { echo "only $caught of 3 balls caught"; return 1; }
}
timed all
