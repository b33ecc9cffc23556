# The industrial robot in real time: `cubectl throw` leads the one that `cubectl sim` plays, by the clock of this machine. Both
# generations, UDP and TCP, 12 ms and 4 ms. The witness is the simulated robot: it tells whether the bottle was hit, and how long
# the answers took, how many were late (none may be), and how many of its cycles this machine held up. In lock step the same is tested by host/tests/robot_link.rs, where nothing depends on the machine.
. .ci/timed.sh
. .ci/wait.sh

cargo build --quiet --release --locked -p host -p hil-sim --bins
cubectl=$PWD/target/release/cubectl
out=$PWD/target/rsi
rm -rf "$out" && mkdir -p "$out"
plan() { # name, period in ms
    "$cubectl" plan throw --robot kr16_2 --target 2.5,0,0.6 --lag-ms 24 --period "$2" --starts 8 --out "$out/$1.json" </dev/null
}
plan slow 12
plan fast 4

throw() { # description, scheme, port, plan
    local name=$1 place=$2://127.0.0.1:$3 dir=$out/$1 client status=0
    rm -rf "$dir" "$dir".*
    # The client first: a robot counts telegrams that nobody answers.
    "$cubectl" throw --robot kr16_2 --plan "$out/$4.json" --bus "rsi:$place" --rsi "robots/kr16_2/$name.toml" --yes \
        --out "$dir" >"$dir.throw" 2>&1 </dev/null &
    client=$!
    wait_for $client says "$dir.throw" 'waiting for the robot' || { cat "$dir.throw"; return 1; }
    "$cubectl" sim --robot kr16_2 --rsi "$place" --scenario "robots/kr16_2/$name.toml" --bottle 2.5,0,0.6 --runs 1 --for 120 \
        >"$dir.robot" 2>&1 </dev/null || status=$?
    # A robot that was refused never comes: its client would wait for it.
    [ $status -eq 0 ] || kill -INT $client
    wait $client || status=$?
    echo "--- $name, $place"
    cat "$dir.robot"
    [ $status -eq 0 ] || { cat "$dir.throw"; return $status; }
    grep -q 'bottle hit' "$dir.robot" || { echo "$name: the bottle is not hit"; return 1; }
    grep -q ' 0 late answers, 0 refused, [0-9]* cycles held up' "$dir.robot" || { echo "$name: late or refused answers"; return 1; }
}
pair() { # two throws at the same time
    local first status=0
    throw "${@:1:4}" &
    first=$!
    throw "${@:5:4}" || status=$?
    wait $first || status=$?
    return $status
}
timed pair kr_c2 udp 49261 slow kr_c2_tcp tcp 49262 slow
timed pair kr_c4 udp 49263 fast kr_c4_12ms udp 49264 slow

# A tracked target that moves by 20 mm while the client waits for the robot: nothing is thrown, and the recording runs again.
moved() {
    local data=127.0.0.1:49272 place=udp://127.0.0.1:49265 dir=$out/moved before after client status=0
    rm -rf "$dir" "$dir".*
    local robot=("$cubectl" sim --robot kr16_2 --tracker $data --runs 1 --for 120)
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
    "$cubectl" replay "$dir" | grep '^identical: '
}
timed moved
# Where the ball lands over 200 seeds, in virtual time: six rows of docs/measured/industrial-robot.md, each within its bounds.
cargo run --quiet --release --locked -p operator --example rsi_landings -- 200 --check
