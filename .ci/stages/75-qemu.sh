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
