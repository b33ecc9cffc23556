# The same calls to the library on this machine and to the image on an emulated Cortex-M4F: the frames must be the
# same, byte for byte. A whole throw over the host link: start-up, upload, arming, run. And a whole catch, with the simulated cell
# and a flying ball: homing, the way to the waiting pose, new end states in flight, a halt.
. .ci/toolchain.sh
command -v qemu-system-arm >/dev/null || { apt-get update -qq && apt-get install -y -qq qemu-system-arm; }

target=thumbv7em-none-eabihf
dir=$PWD/target/qemu
rm -rf "$dir"
. .ci/debug-build.sh
target/debug/examples/record_throw "$dir/throw"
target/debug/examples/record_catch "$dir/catch"

elf=$PWD/target/boards/$target/release/firmware-qemu
(cd firmware/boards/qemu && cargo build --quiet --release --locked --target $target --features script)

run() {
    timeout 120 qemu-system-arm -M netduinoplus2 -kernel "$elf" -display none -monitor none -serial null \
        -semihosting-config enable=on,target=native -icount shift=3,align=off,sleep=off
}
# `firmware/boards/README.md` promises boards at most so many instructions per control step, and per end state taken over.
most_step=10000 most_target=15000
within() { # file, what costs, most: the dearest call of this kind that is reported in the file
    local worst
    worst=$(sed -n "s/^$2: .* calls, .*, worst \([0-9]*\)$/\1/p" "$1")
    [ -n "$worst" ] && [ "$worst" -gt 0 ] || { echo "$1 tells no instructions of a $2"; return 1; }
    [ "$worst" -le "$3" ] || { echo "a $2 took $worst instructions, more than $3"; return 1; }
}
step="control step of six joints" taken="end state taken over"
# `SECURITY.md` says what the digests cost: instructions, and bytes of the image.
most_settings=200000 most_kibibyte=80000 most_flash=1500
settings="digest of the settings" kibibyte="digest of 1 KiB of a file"
flash=0
while read -r _ size _ _; do flash=$((flash + 16#$size)); done < <(nm -S "$elf" | grep -E ' (_ZN4sha2|_ZN12block_buffer|_ZN8firmware9registers6digest10run_digest)')
echo "digests in the image: $flash bytes"
[ "$flash" -gt 0 ] && [ "$flash" -le $most_flash ] || { echo "not between 1 and $most_flash bytes"; exit 1; }
for what in throw catch; do
    cd "$dir/$what"
    echo "$what:"
    run | tee costs.txt
    cmp frames.bin expected.bin
    within costs.txt "$step" $most_step
    within costs.txt "$taken" $most_target
    within costs.txt "$settings" $most_settings
    within costs.txt "$kibibyte" $most_kibibyte
    echo "frame log of $(($(stat -c %s frames.bin) / 24)) frames: identical"
done
# The limits themselves: a step that costs one instruction more is found, and so is a log without a step or without an end state.
sed "s/^\($step: .*worst \)[0-9]*$/\1$((most_step + 1))/" costs.txt >dear.txt
! within dear.txt "$step" $most_step >/dev/null || { echo "a step beyond the limit was not found"; exit 1; }
! within /dev/null "$step" $most_step >/dev/null || { echo "a log without a step was taken"; exit 1; }
sed "s/^\($taken: \).*/\10 calls, instructions mean 0, worst 0/" costs.txt >none.txt
! within none.txt "$taken" $most_target >/dev/null || { echo "a catch without an end state was taken"; exit 1; }
# And the same again: emulated runs repeat exactly.
cd "$dir/throw"
mv frames.bin first.bin
run >again.txt
cmp frames.bin first.bin
cmp costs.txt again.txt
# The comparison itself: another script gives another log.
head -c $((24 * 5000)) script.bin >short.bin && mv short.bin script.bin
run >/dev/null
! cmp -s frames.bin expected.bin || { echo "a shorter script gave the same log"; exit 1; }
