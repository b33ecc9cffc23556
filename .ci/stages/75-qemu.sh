# The same calls to the library on this machine and to the image on an emulated Cortex-M4F: the frames must be the
# same, byte for byte. A whole throw over the host link: start-up, upload, arming, run.
. .ci/toolchain.sh
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }

target=thumbv7em-none-eabihf
dir=$PWD/target/qemu
rm -rf "$dir"
. .ci/debug-build.sh
target/debug/examples/record_throw "$dir"

elf=$PWD/target/boards/$target/release/firmware-qemu
(cd firmware/boards/qemu && CARGO_TARGET_DIR=../../../target/boards cargo build --quiet --release --locked --target $target --features script)

cd "$dir"
run() {
    timeout 120 qemu-system-arm -M netduinoplus2 -kernel "$elf" -display none -monitor none -serial null \
        -semihosting-config enable=on,target=native -icount shift=3,align=off,sleep=off
}
run | tee costs.txt
cmp frames.bin expected.bin
# `firmware/boards/README.md` promises boards at most so many instructions per control step.
most=10000
within() { # the dearest control step that is told in the file
    local worst
    worst=$(sed -n 's/^control step of six joints: .*, worst \([0-9]*\)$/\1/p' "$1")
    [ -n "$worst" ] || { echo "$1 tells no instructions of a control step"; return 1; }
    [ "$worst" -le $most ] || { echo "a control step took $worst instructions, more than $most"; return 1; }
}
within costs.txt
# The limit itself: a step that costs one instruction more is found, and so is a log without a step.
sed "s/^\(control step .*worst \)[0-9]*$/\1$((most + 1))/" costs.txt >dear.txt
! within dear.txt >/dev/null || { echo "a step beyond the limit was not found"; exit 1; }
! within /dev/null >/dev/null || { echo "a log without a step was taken"; exit 1; }
echo "frame log of $(($(stat -c %s frames.bin) / 24)) frames: identical"
# And the same again: emulated runs repeat exactly.
mv frames.bin first.bin
run >again.txt
cmp frames.bin first.bin
cmp costs.txt again.txt
# The comparison itself: another script gives another log.
head -c $((24 * 5000)) script.bin >short.bin && mv short.bin script.bin
run >/dev/null
! cmp -s frames.bin expected.bin || { echo "a shorter script gave the same log"; exit 1; }
