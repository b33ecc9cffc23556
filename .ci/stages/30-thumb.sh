# The no_std rooms compile for the target of the boards; a linked program that uses all of `protocol`
# has no path to a panic; and its size is told, part by part.
. .ci/toolchain.sh
target=thumbv7em-none-eabihf
cargo build --release --locked --target $target -p protocol -p firmware

export CARGO_TARGET_DIR=$PWD/target/size
elf=$CARGO_TARGET_DIR/$target/release/protocol-size
# What every panic ends up in, and the helpers of core that are only there to panic.
panics='core::panicking|panic_fmt|panic_bounds_check|rust_begin_unwind|unwrap_failed|expect_failed|slice_\w*fail|len_mismatch_fail|slice_error_fail|panic_const|panic_nounwind'

link() { # features
    (cd protocol/size && cargo build --quiet --release --locked --target $target --features "$1")
}
flash() { # vectors + code + constants + initial values, bytes
    size $elf | awk 'NR == 2 { print $1 + $2 }'
}
panic_symbols() {
    nm --demangle $elf | grep -E "$panics" || true
}

# The check itself first: a program with a planted panic must be caught.
link planted-panic
if [ -z "$(panic_symbols)" ]; then
    echo "the search for panic symbols does not find a planted one; nm says:"
    nm --demangle $elf | head -50
    exit 1
fi

all=powercube,cyphal,nodes,text,bits
for features in $all cyphal-node; do
    link $features
    found=$(panic_symbols)
    if [ -n "$found" ]; then
        echo "protocol ($features) can panic; the linked program holds:"
        echo "$found"
        exit 1
    fi
done

link ""
start=$(flash)
echo "flash of a program for $target, optimised for size, in bytes"
echo "  start-up code and compiler runtime   $start"
for part in powercube cyphal nodes text bits; do
    link $part
    printf '  %-36s %d\n' "$part, both directions" $(($(flash) - start))
done
link $all
printf '  %-36s %d\n' "everything" "$(flash)"

# A controller's half of Cyphal, without the calls of the measuring program around it.
link cyphal-node
limit=8192
cyphal=$(nm --demangle --print-size --radix=d $elf |
    awk '/protocol::cyphal|protocol_size::cyphal::part|FnOnce::call_once|switch.table.*cyphal/ { sum += $2 } END { print sum }')
echo "Cyphal in a controller (serves and publishes): $cyphal bytes of code, at most $limit"
[ "$cyphal" -gt 4096 ] || { echo "implausibly little: the symbols were not found"; exit 1; }
[ "$cyphal" -le $limit ]
