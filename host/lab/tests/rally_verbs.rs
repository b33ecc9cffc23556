//! `cubelab rally`: what is printed and with which code it ends.

use crate::cubelab;

#[test]
fn wrong_input_is_refused_with_its_code() {
    for (words, code) in [
        ("rally --trouble rain", host::exit::USAGE),
        ("rally --trouble frames-lost:2", host::exit::USAGE),
        ("rally --court /nowhere.toml", host::exit::BAD_INPUT),
        ("rally --bus-thrower can0", host::exit::USAGE),
        ("rally --tracker 127.0.0.1:5000", host::exit::USAGE),
        ("rally --bus-thrower can0 --bus-catcher can0 --tracker 127.0.0.1:0", host::exit::BAD_INPUT),
        ("rally --bus-thrower can0 --bus-catcher sim --tracker 127.0.0.1:0", host::exit::BAD_INPUT),
        ("rally --bus-thrower can0 --bus-catcher can1 --tracker 127.0.0.1:0 --throws 3", host::exit::USAGE),
        ("rally --study 10 --throws 3", host::exit::USAGE),
        ("rally --study 10 --hand hold", host::exit::USAGE),
    ] {
        let ended = cubelab(words);
        assert_eq!(ended.status.code(), Some(i32::from(code)), "{words}: {ended:?}");
    }
}

#[test]
fn a_ball_that_is_not_released_ends_the_rally_and_is_reported() {
    let ended = cubelab("rally --throws 2 --eyes-only --trouble not-released");
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::NOT_RELEASED)), "{ended:?}");
    let printed = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert!(printed.contains("0 catches in a row") && printed.contains("nothing thrown"), "{printed}");
}
