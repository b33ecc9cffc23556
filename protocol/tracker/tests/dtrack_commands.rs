//! The command channel of DTrack.

use proptest::prelude::*;
use tracker_protocol::dtrack::{Answer, Command, MAX_MESSAGE_BYTES, Messages, Output};

#[test]
fn commands_are_read_and_written() {
    let udp = |host: &str, port| Output::Udp { host: host.to_owned(), port };
    let table = [
        ("dtrack2 tracking start", Command::TrackingStart),
        ("dtrack2 tracking stop", Command::TrackingStop),
        ("dtrack2 get system access", Command::GetAccess),
        ("dtrack2 getmsg", Command::GetMessage),
        ("dtrack2 get status active", Command::GetStatus),
        (
            "dtrack2 set output net ch01 udp my_ip 5000",
            Command::SetOutput { channel: 1, to: udp("my_ip", 5000) },
        ),
        ("dtrack2 set output net ch05 none", Command::SetOutput { channel: 5, to: Output::None }),
        (
            "dtrack2 set output active ch01 all yes",
            Command::SetOutputActive { channel: 1, kind: "all".to_owned(), on: true },
        ),
        ("dtrack2 get config active_config", Command::GetConfig),
        ("dtrack2 set config active_config standard", Command::SetConfig("standard".to_owned())),
        ("dtrack2 set output net ch06 none", Command::Other("set output net ch06 none".to_owned())),
        ("dtrack2 tracking  start", Command::Other("tracking  start".to_owned())),
        (
            "dtrack2 set output net ch01 udp a 70000",
            Command::Other("set output net ch01 udp a 70000".to_owned()),
        ),
    ];
    for (text, command) in table {
        assert_eq!(Command::parse(text), Some(command.clone()), "{text}");
        assert_eq!(command.to_string(), text);
    }
    assert_eq!(Command::parse("dtrack 10 3"), None);
}

#[test]
fn answers_are_read_and_written() {
    let message = Answer::Message {
        origin: "system".to_owned(),
        status: "info".to_owned(),
        frame: 17,
        id: 3,
        text: "a \"b\"".to_owned(),
    };
    let table = [
        ("dtrack2 ok", Answer::Ok),
        ("dtrack2 err 4 \"no tracking\"", Answer::Err { code: 4, text: "no tracking".to_owned() }),
        ("dtrack2 set system access full", Answer::Set("system access full".to_owned())),
        ("dtrack2 msg system info 17 3 \"a \"b\"\"", message),
    ];
    for (text, answer) in table {
        assert_eq!(Answer::parse(text), Some(answer.clone()), "{text}");
        assert_eq!(answer.to_string(), text);
    }
    let access = Answer::parse("dtrack2 set system access full").unwrap();
    assert_eq!(
        (access.value_of("system access"), access.value_of("system")),
        (Some("full"), Some("access full"))
    );
    assert_eq!((access.value_of("status active"), Answer::Ok.value_of("")), (None, None));
    for wrong in
        ["dtrack2", "dtrack2 okay", "dtrack2 err x \"\"", "dtrack2 err 1 x", "dtrack2 msg a b 1", "ok"]
    {
        assert_eq!(Answer::parse(wrong), None, "{wrong}");
    }
}

#[test]
fn messages_end_with_nul_and_are_bounded() {
    let mut messages = Messages::default();
    assert_eq!(messages.push(b"dtrack2 get"), []);
    assert_eq!(
        messages.push(b"msg\0dtrack2 ok\0\0x"),
        [Some("dtrack2 getmsg".to_owned()), Some("dtrack2 ok".to_owned()), Some(String::new())]
    );
    assert_eq!(messages.push(b"\n\0"), [None], "line feeds do not belong into a message");
    let long = vec![b'a'; MAX_MESSAGE_BYTES];
    assert_eq!(messages.push(&long), []);
    assert_eq!(messages.push(b"\0"), [Some("a".repeat(MAX_MESSAGE_BYTES))]);
    messages.push(&vec![b'a'; 100 * MAX_MESSAGE_BYTES]);
    assert_eq!(messages.push(b"\0next\0"), [None, Some("next".to_owned())]);
    assert_eq!(Messages::frame(&Command::GetMessage), b"dtrack2 getmsg\0");
}

proptest! {
    #[test]
    fn what_is_read_is_written_the_same(rest in "[ -~]{0,60}") {
        let text = format!("dtrack2 {rest}");
        if let Some(command) = Command::parse(&text) {
            prop_assert_eq!(Command::parse(&command.to_string()), Some(command));
        }
        if let Some(answer) = Answer::parse(&text) {
            prop_assert_eq!(Answer::parse(&answer.to_string()), Some(answer));
        }
    }

    #[test]
    fn size_of_the_pieces_changes_nothing(
        bytes in prop::collection::vec(prop_oneof![Just(0_u8), any::<u8>()], 0..900), size in 1..300_usize,
    ) {
        let whole = Messages::default().push(&bytes);
        let mut messages = Messages::default();
        let pieces: Vec<_> = bytes.chunks(size).flat_map(|chunk| messages.push(chunk)).collect();
        prop_assert_eq!(whole, pieces);
    }
}
