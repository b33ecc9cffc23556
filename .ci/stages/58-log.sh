# The recordings against readers that are not ours: the public MCAP and protobuf packages, the schemas of their publisher,
# python-can and can-utils, unmodified.
. .ci/venv.sh log tests/interop/log/requirements.txt
. .ci/debug-build.sh
if ! command -v log2asc >/dev/null; then
    sudo=$([ "$(id -u)" -eq 0 ] || echo sudo)
    $sudo apt-get update -q
    $sudo apt-get install -y -q --no-install-recommends can-utils
fi
out=target/log-stage
rm -rf "$out" && mkdir -p "$out"
python tests/interop/log/make_schemas.py "$out/foxglove.binpb"
cmp "$out/foxglove.binpb" host/operator/src/log/schemas/foxglove.binpb
check() { python tests/interop/log/check_log.py "$@" --robot robots/powercube6.toml --layout docs/viewer/cubecell.layout.json; }
# A controller starts up and homes, in virtual time.
target/debug/cubectl log record "$out/boot" --controller --for-s 3
check "$out/boot"
# A whole throw: its control cycles, the gripper that opens.
target/debug/cubectl throw --target 1.0,1.0,-1.0 --starts 0 --out "$out/throw"
check "$out/throw/bus"
# A drive that goes silent under a controller.
printf '%s\n' 'schema_version = 1' 'name = "a drive goes silent"' 'seed = 3' 'duration_s = 3.0' \
    '[[fault]]' 'kind = "silent"' 'target = "module 3"' 'start_s = 1.5' >"$out/silent.toml"
target/debug/cubectl log record "$out/fault" --controller --for-s 3 --scenario "$out/silent.toml"
check "$out/fault" --with-fault
# can-utils. A log of the simulated cell begins at zero, from where log2asc does not count; so the times are moved to those that a
# bus would have given. Then one header, and as many frames as the log has; of a log that is torn off, all before the tear.
frames() { grep -c '^ *[0-9]*\.[0-9]* *1 ' "$1"; }
sed 's/^(0000000/(1700000/' "$out/throw/bus.log" >"$out/wall.log"
log2asc -I "$out/wall.log" -O "$out/wall.asc" sim
test "$(frames "$out/wall.asc")" -eq "$(wc -l <"$out/wall.log")"
test "$(grep -c '^date' "$out/wall.asc")" -eq 1
span() { awk -v from="$1" -v to="$2" 'BEGIN { printf "%.3f", to - from }'; }
stamp() { sed -E 's/^.([0-9]+\.[0-9]+).*/\1/'; }
test "$(tail -1 "$out/wall.asc" | awk '{ printf "%.3f", $1 }')" = \
    "$(span "$(head -1 "$out/wall.log" | stamp)" "$(tail -1 "$out/wall.log" | stamp)")"
head -c 40000 "$out/wall.log" >"$out/torn.log"
! log2asc -I "$out/torn.log" -O "$out/torn.asc" sim
test "$(frames "$out/torn.asc")" -eq "$(wc -l <"$out/torn.log")"
echo "log2asc: $(frames "$out/wall.asc") frames of a throw, $(frames "$out/torn.asc") of a torn log"
