# Cyphal against tools that are not ours: pycyphal and yakut, unmodified, pinned, over socketcand.
#
# The public regulated data types come with a crate (they are on no Python index); cargo checks its hash.
here=tests/interop/cyphal
work=target/interop-cyphal
mkdir -p $work/dsdl/src
# The node is built while the packages come from the net.
bash -e .ci/debug-build.sh & build=$!
. .ci/timed.sh
. .ci/wait.sh
. .ci/venv.sh cyphal $here/requirements.txt

cat >$work/dsdl/Cargo.toml <<'TOML'
[package]
name = "dsdl"
edition = "2024"
[dependencies]
canadensis_dsdl_frontend = "=0.6.0"
[workspace]
TOML
touch $work/dsdl/src/lib.rs
regulated=$(cargo metadata --format-version 1 --manifest-path $work/dsdl/Cargo.toml | python -c '
import json, pathlib, sys
package = next(p for p in json.load(sys.stdin)["packages"] if p["name"] == "canadensis_dsdl_frontend")
print(pathlib.Path(package["manifest_path"]).parent / "tests/public_regulated_data_types")')
export CYPHAL_PATH=$regulated:$PWD/protocol/dsdl PYCYPHAL_PATH=$PWD/$work/compiled
rm -rf "$PYCYPHAL_PATH"

echo "--- golden vectors"
for name in vectors transport_vectors; do
    python $here/make_$name.py >$work/$name.txt 2>$work/$name.log || { cat $work/$name.log; exit 1; }
    cmp $work/$name.txt protocol/tests/cyphal_$name.txt
done

wait $build
node=target/debug/examples/cyphal_node
$node 127.0.0.1:0 >$work/node.log & good=$!
$node 127.0.0.1:0 60 1 >$work/lossy.log & lossy=$!
trap 'kill $good $lossy' EXIT
port_of() { # process, log. Port 0 above: any free one; the node prints the address it got.
    wait_for "$1" says "$2" '^socketcand://'
    sed -n 's|^socketcand://127.0.0.1:\([0-9]*\)/can0$|\1|p' "$2"
}
good_port=$(port_of $good $work/node.log)
lossy_port=$(port_of $lossy $work/lossy.log)

echo "--- pycyphal"
check() { timed timeout 120 python $here/check.py 127.0.0.1 "$@"; }
# Most of its time the upload over the lossy bus waits; meanwhile the other node is asked.
check "$lossy_port" upload-lossy >$work/lossy-check.log 2>&1 & lossy_check=$!
check "$good_port" services
check "$good_port" upload
wait $lossy_check || { cat $work/lossy-check.log; exit 1; }
cat $work/lossy-check.log

echo "--- yakut"
export UAVCAN__CAN__IFACE=socketcand:can0:127.0.0.1:$good_port UAVCAN__CAN__MTU=8 UAVCAN__NODE__ID=101
yakut() { timeout 60 $venv/bin/yakut --format json "$@" 2>>$work/yakut.log; }
expect() { # expect WHAT GOT WANTED
    if [ "$2" != "$3" ]; then echo "$1: got $2, wanted $3"; tail $work/yakut.log; exit 1; fi
    echo "$1: $2"
}
: >$work/yakut.log
expect "registers listed" "$(yakut register-list 42 | python -c 'import json, sys; print(len(json.load(sys.stdin)))')" 19
expect "register written" "$(yakut register-access 42 demo.natural16 7 65535)" "[7,65535]"
expect "register read" "$(yakut register-access 42 demo.natural16)" "[7,65535]"
expect "command" "$(yakut execute-command 42 100 olleh)" '{"status":0,"output":"hello"}'
crc=$(yakut execute-command 42 101)
expect "file crc by command and register" \
    "$(echo "$crc" | python -c 'import json, sys; print(int.from_bytes(json.load(sys.stdin)["output"], "little"))')" \
    "$(yakut register-access 42 file.crc64)"
