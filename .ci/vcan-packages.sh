# Sourced by stages that use .ci/vcan-vm: installs what that needs, if it is not there.
missing=()
for package in qemu-system-x86 busybox-static cpio; do
    dpkg -s $package >/dev/null 2>&1 || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
    sudo=$([ "$(id -u)" -eq 0 ] || echo sudo)
    $sudo apt-get update -q
    $sudo apt-get install -y -q --no-install-recommends "${missing[@]}"
fi
