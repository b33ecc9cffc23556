# The main job on every runner, as one table; then many throws, and many arms that are not the model.
mkdir -p target/throw
cargo build --release --locked -p host -p hil-sim
bin=target/release
rm -rf target/throw/sim target/throw/socketcand
$bin/cubectl throw --target 1,1,-1 --no-store --out target/throw/sim
port=29600
$bin/hil-sim serve --bus socketcand://127.0.0.1:$port/can0 </dev/null >target/throw/serve.log 2>&1 &
server=$!
trap 'kill $server 2>/dev/null || true' EXIT
sleep 1
$bin/cubectl throw --target 1,1,-1 --no-store --bus socketcand://127.0.0.1:$port/can0 --back \
    --out target/throw/socketcand </dev/null
kill $server
rows=("virtual time=target/throw/sim/summary.json" "socketcand=target/throw/socketcand/summary.json")
# Written by the stages vcan and qemu, if they ran before.
[ ! -s target/throw/vcan.json ] || rows+=("vcan=target/throw/vcan.json")
[ ! -s target/throw/qemu.json ] || rows+=("QEMU Cortex-M4F=target/throw/qemu.json")
.ci/throw-table "${rows[@]}"
THROWS=${THROWS:-1000} SEEDS=${SEEDS:-200} cargo test --release --locked -p cell-tests --test throw -- --ignored --nocapture
