# The controller's image for a Cortex-M4F: it links without a way to a panic, without a heap, and its sizes are printed.
. .ci/toolchain.sh
target=thumbv7em-none-eabihf
cargo build --release --locked --target $target -p firmware

export CARGO_TARGET_DIR=$PWD/target/boards
board=firmware/boards/qemu
elf=$CARGO_TARGET_DIR/$target/release/firmware-qemu
panics='core::panicking|panic_fmt|panic_bounds_check|rust_begin_unwind|unwrap_failed|expect_failed|slice_\w*fail|len_mismatch_fail|slice_error_fail|panic_const|panic_nounwind'
heap='__rust_alloc|__rg_alloc|\bmalloc\b'
found() { nm --demangle $elf | grep -E "$panics|$heap" || true; }

# The check itself first: a planted panic must be found.
(cd $board && cargo build --quiet --release --locked --target $target --features planted-panic)
[ -n "$(found)" ] || { echo "the search does not find a planted panic"; exit 1; }

(cd $board && cargo clippy --quiet --release --locked --target $target --features script -- -D warnings && cargo fmt --check)
(cd $board && cargo build --quiet --release --locked --target $target)
if [ -n "$(found)" ]; then
    echo "the image can panic or has a heap:"
    found
    exit 1
fi

# The same with another family of drives.
for family in mit cia402 odrive; do
    (cd $board && cargo build --quiet --release --locked --target $target --features $family)
    [ -z "$(found)" ] || { echo "the image with drives $family can panic or has a heap:"; found; exit 1; }
    echo "image with drives $family, bytes of flash: $(size $elf | awk 'NR == 2 { print $1 + $2 }')"
done
(cd $board && cargo build --quiet --release --locked --target $target)

# Sizes. Banks and settings slots are flash on a real board.
section() { size -A $elf | awk -v name="$1" '$1 == name { print $2 }'; }
symbol() { nm --print-size --radix=d $elf | awk -v name="$1" '$4 ~ name { sum += $2 } END { print sum + 0 }'; }
flash=$(($(section .vector_table) + $(section .text) + $(section .rodata) + $(section .data)))
ram=$(($(section .data) + $(section .bss) + $(section .uninit)))
storage=$(symbol STORAGE)
echo "image for $target, bytes:"
echo "  flash (code, constants, initial values)  $flash, budget 131072"
echo "    of it: codes and tokens (SHA-256, HMAC)  $(symbol 'sha2|authority')"
echo "           freeze frame, trace on the wire   $(symbol history)"
echo "           registers, limits, ceiling        $(symbol registers)"
echo "  static RAM without the emulated storage  $((ram - storage))"
echo "  emulated storage (flash on a board)      $storage"
# 32 KiB, and 4 for new end states in flight, of which 2.6 are used: 1.2 for the pieces of eight joints, 0.6 for their courses
# while they are checked, 0.4 for envelope and events of the committed file, 0.4 for the message, its order and its answer.
echo "  (the node, 12 kB, is on the stack: stage qemu tells how deep that gets; static RAM and stack together: aim 36864)"
[ "$storage" -gt 25000 ] || { echo "implausible: the storage was not found"; exit 1; }
[ "$flash" -le $((128 * 1024)) ] || { echo "the image has grown beyond 128 KiB of flash"; exit 1; }

# The boards with a CAN peripheral, each in a workspace of its own: built, not run.
for lock in firmware/boards/*/Cargo.lock; do
    board=$(basename "${lock%/Cargo.lock}")
    [ "$board" != qemu ] || continue
    (cd firmware/boards/$board && cargo clippy --quiet --release --locked --target $target -- -D warnings && cargo fmt --check)
    (cd firmware/boards/$board && cargo build --quiet --release --locked --target $target)
    size $CARGO_TARGET_DIR/$target/release/firmware-$board
done
