# The industrial robot by the clock, ten times slower than real time (.ci/slow.sh): `cubectl throw` leads the one that `cubectl sim`
# plays. Both generations, UDP and TCP, 12 ms and 4 ms, all at once. The observer is the simulated robot: it says whether the bottle was hit, how long
# the answers took, how many were late, and how many of its cycles this machine held up. In lock step the same is tested by
# host/tests/robot_link.rs, where nothing depends on the machine.
#
# Each throw is tried once. An answer that is late by a whole cycle stops a robot; a machine that stops the client for half a
# cycle may cause this. Such a throw is counted as held up, and its report is judged all the same. The stage fails if a report is
# not what happened, if an answer was late on a machine that was on time, or if each throw was held up.
. .ci/timed.sh
. .ci/wait.sh
. .ci/pauses.sh

cargo build --quiet --release --locked -p host -p hil-sim --bins
cubectl=$PWD/target/release/cubectl
out=$PWD/target/rsi
rm -rf "$out" && mkdir -p "$out"
plan() { # name, period in ms
    "$cubectl" plan throw --robot kr16_2 --target 2.5,0,0.6 --lag-ms 24 --period-ms "$2" --starts 8 --out "$out/$1.json" </dev/null
}
plan slow 12
plan fast 4

throw() { # description, scheme, port, plan, cycle in ms
    local name=$1 place=$2://127.0.0.1:$3 dir=$out/$1 client robot_status=0 status=0
    # The client first: a robot counts telegrams that nobody answers.
    "${slow[@]}" "$cubectl" throw --robot kr16_2 --plan "$out/$4.json" --bus "rsi:$place" --rsi "robots/kr16_2/$name.toml" --yes \
        --out "$dir" >"$dir.throw" 2>&1 </dev/null &
    client=$!
    wait_for $client says "$dir.throw" 'waiting for the robot' || { cat "$dir.throw"; return 1; }
    # A robot that comes in the client's first cycle and a half may be in the middle of a run: the client would look at it for 24 cycles.
    sleep 1
    "${slow[@]}" "$cubectl" sim --robot kr16_2 --rsi "$place" --scenario "robots/kr16_2/$name.toml" --bottle 2.5,0,0.6 --runs 1 --for-s 120 \
        >"$dir.robot" 2>&1 </dev/null || robot_status=$?
    # A robot that was refused never comes: its client would wait for it.
    [ $robot_status -eq 0 ] || kill -INT $client
    wait $client || status=$?
    echo "$5 $robot_status $status" >"$dir.ended"
}
judge() { # description
    local dir=$out/$1 cycle_ms robot_status status word=thrown paused
    read -r cycle_ms robot_status status <"$dir.ended"
    echo "--- $1; the client ended with $status; largest pause of this machine $pause_ms ms"
    cat "$dir.robot"
    [ $robot_status -eq 0 ] || { cat "$dir.throw"; return 1; }
    paused=$(python3 -c "print('yes' if $pause_ms > $cycle_ms / 2 else 'no')")
    if ! grep -q ' 0 late answers, 0 refused, [0-9]* cycles held up' "$dir.robot"; then
        [ $paused = yes ] || { echo "late or refused answers"; cat "$dir.throw"; return 1; }
        word='held up'
    elif [ $status -ne 0 ] && [ $paused = yes ] && grep -q ' [1-9][0-9]* cycles held up' "$dir.robot"; then
        # The robot itself stood still, and its client heard nothing for too long.
        word='held up'
    fi
    if grep -q 'bottle hit' "$dir.robot"; then
        [ $status -eq 0 ] || { echo "the bottle was hit, and the client says otherwise"; cat "$dir.throw"; return 1; }
    else
        cat "$dir.throw"
        [ "$word" = 'held up' ] || { echo "the bottle was not hit"; return 1; }
        # A ball that left the hand late misses; nobody watches it, and the client must say so.
        if grep -q 'ball: in the hand' "$dir.robot" || [ $status -ne 0 ]; then
            [[ $status =~ ^(8|13)$ ]] || { echo "nothing was thrown, or the arm stopped, and the client ended with $status"; return 1; }
        else
            grep -q '^thrown, not observed' "$dir.throw" || { echo "the bottle was missed, and the client says otherwise"; return 1; }
        fi
    fi
    echo "$word" >"$dir.word"
}
status=0
throws=()
watch_pauses
throw kr_c2 udp 49261 slow 12 &
throws+=($!)
throw kr_c2_tcp tcp 49262 slow 12 &
throws+=($!)
throw kr_c4 udp 49263 fast 4 &
throws+=($!)
throw kr_c4_12ms udp 49264 slow 12 &
throws+=($!)
for one in "${throws[@]}"; do
    wait "$one" || status=1
done
end_pauses
[ $status -eq 0 ]
for name in kr_c2 kr_c2_tcp kr_c4 kr_c4_12ms; do
    judge $name || status=1
done
[ $status -eq 0 ]
grep -qx thrown "$out"/*.word || { echo "no throw could be judged: the machine held up each of them"; exit 1; }

# A tracked target that moves by 20 mm while the client waits for the robot: nothing is thrown, and the recording runs again.
moved() {
    local data=127.0.0.1:49272 place=udp://127.0.0.1:49265 dir=$out/moved before after client status=0
    rm -rf "$dir" "$dir".*
    local robot=("$cubectl" sim --robot kr16_2 --tracker $data --runs 1 --for-s 120)
    "${robot[@]}" --bottle 2.5,0,0.6 --rsi "udp://127.0.0.1:49266?lockstep" >"$dir.before" 2>&1 </dev/null &
    before=$!
    "$cubectl" throw --robot kr16_2 --target tracker --tracker $data --starts 2 --bus "rsi:$place" --yes \
        --out "$dir" >"$dir.throw" 2>&1 </dev/null &
    client=$!
    wait_for $client says "$dir.throw" 'waiting for the robot' || { cat "$dir.throw"; return 1; }
    kill $before
    wait $before || true
    "${robot[@]}" --bottle 2.5,0.02,0.6 --rsi "$place" >"$dir.after" 2>&1 </dev/null &
    after=$!
    wait $client || status=$?
    kill $after
    wait $after || true
    echo "--- a target that moved, $place"
    tail -n 3 "$dir.throw"
    [ $status -eq 9 ] || { echo "ended with $status, not 9"; return 1; }
    # Each look is a mean of frames with noise, and how many frames there are depends on the clock.
    grep -Eq 'moved by (19\.[89]|20\.[0-2]) mm' "$dir.throw" && grep -q 'nothing was thrown' "$dir.throw" || return 1
    "$cubectl" log replay "$dir" | grep '^identical: '
}
timed moved
# Where the ball lands over 200 seeds, in virtual time: six rows of docs/measured/industrial-robot.md, each within its bounds.
# As the stage test has built it: alone, its libraries would have other features in the release profile, and be built once more for it.
. .ci/debug-build.sh
target/debug/examples/rsi_landings 200 --check
