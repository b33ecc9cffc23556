# The viewer's log against readers that are not ours: the public MCAP and protobuf packages, unmodified, pinned.
. .ci/venv.sh log tests/interop/log/requirements.txt
. .ci/debug-build.sh
out=target/log-stage
rm -rf "$out" && mkdir -p "$out"
# A controller starts up and homes, in virtual time; then what stops it.
target/debug/cubectl record "$out/boot" --controller --for 3
python tests/interop/log/check_log.py "$out/boot"
