# The small programs that show how to use the packages from a program of one's own. Each ends with an error if the
# simulated world, or a second computation, does not agree with what it prints.
. .ci/debug-build.sh
target/debug/examples/hello_drive | tee target/hello_drive.log
grep -q 'the axis stands at 1.0' target/hello_drive.log
target/debug/examples/ask_position | grep -q 'module 3 is at -0.75 rad'
target/debug/examples/certified_gains | grep -c 'error at the release' | grep -qx 6
target/debug/examples/own_task
rm -f target/plan_throw.json
target/debug/examples/plan_throw 1.0 1.0 -1.0 target/plan_throw.json
target/debug/cubectl plan check target/plan_throw.json
target/debug/examples/throw_in_process 1.0 1.0 -1.0 | tee target/throw_in_process.log
grep -q 'landed' target/throw_in_process.log
# A target that no throw reaches ends with an error.
if target/debug/examples/plan_throw 90 0 0; then
    echo "a target 90 m away was planned" >&2
    exit 1
fi
# A board of one's own: the loop of the firmware over drivers of the field's traits, in front of the simulated arm.
target/debug/board-example | tee target/board_example.log
grep -q 'joint 6 has turned by 0.2' target/board_example.log
# The boards build in their own folders, as a newcomer builds them.
(cd firmware/boards/stm32 && cargo build --quiet --release --locked)
