# Sourced by stages that judge programs by the clock, which a machine of CI holds up by 10 to 30 ms:
#   "${slow[@]}" COMMAND…   runs it by a clock that takes 10 s for one (libfaketime): such a pause is 1 to 3 ms of its time.
#   "${slower[@]}"         the same with four seconds for one
# Programs that work together are all started so. What they do is the same; a pause of the machine only weighs less.
faketime=$(echo /usr/lib/*/faketime/libfaketimeMT.so.1)
[ -e "$faketime" ] || {
    sudo=$([ "$(id -u)" -eq 0 ] || echo sudo)
    $sudo apt-get update -q
    $sudo apt-get install -y -q --no-install-recommends libfaketime
    faketime=$(echo /usr/lib/*/faketime/libfaketimeMT.so.1)
}
slow=(env "LD_PRELOAD=$faketime" 'FAKETIME=+0 x0.1')
slower=(env "LD_PRELOAD=$faketime" 'FAKETIME=+0 x0.25')
