# Every command block of the README and of the pages that need an arm, in order; each is timed.
#   README_CLONE=1 .ci/run readme     in a fresh clone of what is committed, so that the build from clean is timed too
#
# The word after `sh` says what a block needs; what this machine lacks is replaced as follows, and by nothing else:
#   hardware-robot  an industrial robot that connects: a simulated one in lock step
#   hardware    an arm on can0: the simulated cell in lock step (virtual time), whose name replaces `can0`
#   vcan        kernel modules and root: `ip` and `modprobe` are said, not run, and `vcan0` is that port as well
#               (the stages vcan and throw run on a kernel that has them)
#   background  runs until the blocks are done
# The block of all tests is what the stage test runs: it is run here only if that has not passed on this very tree.
# A clone builds with nothing but cargo and a compiler; only the tests share compiled libraries with this tree.
. .ci/tree-state.sh
. .ci/pages.sh
. .ci/wait.sh
root=$PWD
work=$root/target/readme
rm -rf "$work" arm.registers.toml throw1 target/drawn && mkdir -p "$work"

seconds() { date +%s.%N; }
reported() { awk -v what="$1" -v from="$2" -v to="$(seconds)" 'BEGIN { printf "%-56s %8.2f s\n", what, to - from }'; }

if [ -n "${README_CLONE:-}" ]; then
    git diff --quiet HEAD || echo "uncommitted changes are not in the clone"
    begun=$(seconds)
    git clone --quiet --local --no-hardlinks . "$work/clone"
    reported "clone" "$begun"
    cd "$work/clone"
fi
unset CARGO_TARGET_DIR
# `pip install` builds the Python package with the libraries of the stage python; the release profile alone would take minutes.
[ -n "${README_CLONE:-}" ] || export MATURIN_PEP517_ARGS="--profile dev --features features-of-tests"
awk -v dir="$work" '
    /^```sh/ { n += 1; kind = $2 == "" ? "plain" : $2; file = sprintf("%s/%02d-%s.sh", dir, n, kind); next }
    /^```$/ { file = "" }
    file { print > file }' "${pages_with_a_cell[@]}"
blocks=("$work"/[0-9]*.sh)
[ ${#blocks[@]} -ge 8 ] || { echo "only ${#blocks[@]} command blocks found"; exit 1; }
grep -q -- '-- throw --target' "${blocks[0]}" || { echo "the first block is not the throw"; exit 1; }

begun=$(seconds)
cargo build --quiet --release --locked
reported "build (part of the first command)" "$begun"
export PATH="$PWD/target/release:$PATH"

cells=()
end_cells() {
    [ ${#cells[@]} -eq 0 ] || kill -INT "${cells[@]}" 2>/dev/null || true
    cells=()
}
trap end_cells EXIT
opened() { (exec 3<>"/dev/tcp/127.0.0.1/$1") 2>/dev/null; } # port
serve() { # serve SCHEME PORT [OPTION]: a simulated cell that is ready when this returns
    local scheme=$1
    shift
    cubectl sim --bus "$scheme://127.0.0.1:$1/can0" "${@:2}" >"$work/cell-$1.log" 2>&1 </dev/null &
    cells+=($!)
    ! wait_for "${cells[-1]}" opened "$1" || return 0
    cat "$work/cell-$1.log"
    return 1
}
serve lockstep 29540
arm=lockstep://127.0.0.1:29540/can0
cat >"$work/stand-in.sh" <<'STAND_IN'
sudo() { "$@"; }
ip() { echo "not run here: ip $*"; }
modprobe() { echo "not run here: modprobe $*"; }
STAND_IN
run_block() {
    begun=$(seconds)
    "${here[@]}" bash -euxo pipefail -c ". '$work/stand-in.sh'; . '$work/$name.here'" >"$work/$name.log" 2>&1 </dev/null
}
for block in "${blocks[@]}"; do
    name=$(basename "$block" .sh)
    case $name in
    *-background)
        if grep -q -- '--rsi' "$block"; then
            bash -c "exec $(cat "$block")" >"$work/$name.log" 2>&1 </dev/null &
            cells+=($!)
            continue
        fi
        port=$(sed -n 's|.*127\.0\.0\.1:\([0-9]*\)/.*|\1|p' "$block" | head -n 1)
        mapfile -t options < <(grep -o -- '--controller' "$block" || true)
        serve socketcand "$port" "${options[@]}"
        continue
        ;;
    *-hardware-robot)
        # The simulated robot in lock step stands in for the one that would connect.
        cubectl sim --robot kr16_2 --rsi 'udp://127.0.0.1:49153?lockstep' >"$work/$name-robot.log" 2>&1 </dev/null &
        cells+=($!)
        sed -e "s|rsi:udp://0.0.0.0:49152|'rsi:udp://127.0.0.1:49153?lockstep'|g" "$block" >"$work/$name.here"
        ;;
    *-hardware | *-vcan)
        # The cell is served already: the line that would serve one on vcan0 is said, not run.
        sed -e 's|^\(cubectl sim .*\) &$|echo "not run here: \1"|' -e "s|--bus v\{0,1\}can0\b|--bus $arm|g" \
            "$block" >"$work/$name.here"
        ;;
    *) cp "$block" "$work/$name.here" ;;
    esac
    here=()
    if grep -q '^cargo test' "$block"; then
        if (cd "$root" && [ "$(cat target/tests-passed 2>/dev/null)" = "$(tree_state)" ]); then
            echo "$name: passed on this tree in the stage test"
            continue
        fi
        here=(env CARGO_TARGET_DIR="$root/target")
    fi
    run_block || { tail -n 60 "$work/$name.log"; echo "block $name failed"; exit 1; }
    reported "$name: $(head -n 1 "$block" | cut -c1-34)" "$begun"
done
rm -rf throw1 throw-[0-9]* arm.registers.toml
echo "--- what the first command says"
cat "$work"/01-plain.log
