//! `cubelab rally`: what is printed and with which code it ends.

use crate::cubelab;

#[test]
fn wrong_input_is_refused_with_its_code() {
    for (words, code) in [
        ("rally --fault rain", host::exit::USAGE),
        ("rally --fault frames-lost:2", host::exit::USAGE),
        ("rally --cell /nowhere.toml", host::exit::BAD_INPUT),
        ("rally --bus-thrower can0", host::exit::USAGE),
        ("rally --tracker 127.0.0.1:5000", host::exit::USAGE),
        ("rally --bus-thrower can0 --bus-catcher can0 --tracker 127.0.0.1:0", host::exit::BAD_INPUT),
        ("rally --bus-thrower can0 --bus-catcher sim --tracker 127.0.0.1:0", host::exit::BAD_INPUT),
        (
            "rally --bus-thrower can0 --bus-catcher can1 --tracker 127.0.0.1:0 --fault bias:2",
            host::exit::USAGE,
        ),
        ("rally --study 10 --record /proc/none", host::exit::USAGE),
        ("rally --study 10 --throws 3", host::exit::USAGE),
        ("rally --study 10 --hand hold", host::exit::USAGE),
    ] {
        let ended = cubelab(words);
        assert_eq!(ended.status.code(), Some(i32::from(code)), "{words}: {ended:?}");
    }
}

#[test]
fn a_ball_that_is_not_released_ends_the_rally_and_is_reported() {
    for words in ["--eyes-only --fault not-released", "--fault not-released", "--fault thrower-stops:0.1"] {
        let ended = cubelab(&format!("rally --throws 2 {words}"));
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::NOT_RELEASED)), "{words}: {ended:?}");
        let printed = String::from_utf8_lossy(&ended.stdout).into_owned();
        assert!(printed.contains("0 catches in a row") && printed.contains("nothing thrown"), "{printed}");
    }
}

/// The tracker is dead from 0.1 s after the release on: the ball lies in the cup, and nobody knows it.
#[test]
fn a_catch_that_nobody_knows_of_does_not_count_and_ends_the_rally() {
    let ended = cubelab("rally --throws 2 --fault tracker-dead:0.1");
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::MISSED)), "{ended:?}");
    let printed = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert!(printed.contains("0 catches in a row") && printed.contains("not known"), "{printed}");
}
