//! The configuration file of the controller, read for both of its uses.

use rsi_protocol::{
    Config, Internal, Ipoc, Protocol, RobotData, RobotWriter, Source, Telegram, Value, ValueType,
};

const FILE: &str = include_str!("data/axis_absolute.xml");

#[test]
fn all_fields_are_read() {
    let config = Config::parse(FILE).unwrap();
    assert_eq!(
        (config.ip_number.as_str(), config.port, config.protocol),
        ("192.168.1.2", 49152, Protocol::Udp)
    );
    assert_eq!((config.sentype.as_str(), config.only_send, config.length_prefix), ("ImFree", false, false));
    let sources: Vec<Source> = config.send.iter().map(|entry| entry.source).collect();
    let internal = [Internal::RIst, Internal::RSol, Internal::AIPos, Internal::ASPos, Internal::Delay];
    assert_eq!(sources, internal.map(Source::Internal));
    assert_eq!(config.receive.len(), 9);
    let axes = config.axis_correction().unwrap();
    assert!(axes.iter().zip(1..).all(|(place, n)| config.receive[*place].source == Source::Object(n)));
    assert!(axes.iter().all(|place| config.receive[*place].hold));
    assert_eq!(config.cartesian_correction(), None);
    let stop = &config.receive[config.scalar("Stop").unwrap()];
    assert_eq!((stop.kind, stop.hold), (ValueType::Bool, false));
    assert_eq!(config.receive[0].source, Source::Internal(Internal::MessageText));
}

#[test]
fn file_without_optional_elements_is_udp_and_expects_answers() {
    let text = FILE
        .replace("<PROTOCOL>UDP</PROTOCOL>", "")
        .replace("<PROTCOLLENGTH>Off</PROTCOLLENGTH>", "")
        .replace("<ONLYSEND>FALSE</ONLYSEND>", "")
        .replace(" UNIT=\"0\"", "");
    assert_eq!(Config::parse(&text), Config::parse(FILE));
}

#[test]
fn robot_that_only_sends_needs_no_receive_part() {
    let start = FILE.find("  <RECEIVE>").unwrap();
    let text = format!("{}</ROOT>", &FILE[..start]);
    assert_eq!(Config::parse(&text).unwrap_err().to_string(), "line 3: no element <RECEIVE>");
    let config = Config::parse(&text.replace("FALSE", "TRUE")).unwrap();
    assert!(config.only_send && config.receive.is_empty());
}

#[test]
fn equal_names_share_one_element_and_object_inputs_are_sent() {
    let text = FILE.replace(
        "<ELEMENT TAG=\"DEF_Delay\" TYPE=\"LONG\" INDX=\"INTERNAL\" UNIT=\"0\"/>",
        "<ELEMENT TAG=\"Digout.o1\" TYPE=\"BOOL\" INDX=\"1\"/><ELEMENT TAG=\"Krl\" TYPE=\"STRING\" INDX=\"3\"/>\
         <ELEMENT TAG=\"Digout.o2\" TYPE=\"BOOL\" INDX=\"2\"/>",
    );
    let config = Config::parse(&text).unwrap();
    let value = |index| match index {
        1 => Some(Value::Bool(true)),
        3 => Some(Value::Text("a<b & \"c\"".to_owned())),
        _ => None,
    };
    let bytes = RobotWriter::new(&config, 1).write(Ipoc::new(7), &RobotData::default(), value).unwrap();
    let written = String::from_utf8(bytes.clone()).unwrap();
    let end = r#"<Digout o1="1" o2="0"/><Krl>a&lt;b &amp; &quot;c&quot;</Krl><IPOC>7</IPOC></Rob>"#;
    assert!(written.ends_with(end), "{written}");
    let telegram = Telegram::parse(&bytes, rsi_protocol::Root::Rob).unwrap();
    assert_eq!(telegram.element("Krl").unwrap().text, "a<b & \"c\"");
}

#[test]
fn wrong_files_are_refused_with_line_and_reason() {
    let table = [
        ("<PORT>49152</PORT>", "<PORT>0</PORT>", "line 6: PORT is '0', expected 1 to 65535"),
        ("<PORT>49152</PORT>", "", "line 4: no element <PORT>"),
        ("<PROTOCOL>UDP", "<PROTOCOL>CAN", "line 7: PROTOCOL is 'CAN', expected TCP or UDP"),
        ("<ONLYSEND>FALSE", "<ONLYSEND>0", "line 10: ONLYSEND is '0', expected TRUE or FALSE"),
        (
            "INDX=\"1\"",
            "INDX=\"65\"",
            "line 24: INDX is '65', expected 1 to 64; INTERNAL is for tags that begin with DEF_",
        ),
        (
            "\"DEF_Delay\" TYPE=\"LONG\" INDX=\"INTERNAL\"",
            "\"DEF_Delay\" TYPE=\"LONG\" INDX=\"1\"",
            "line 18: INDX is '1', expected INTERNAL for a tag that begins with DEF_",
        ),
        ("TYPE=\"BOOL\"", "TYPE=\"INT\"", "line 31: TYPE is 'INT', expected BOOL, STRING, LONG or DOUBLE"),
        ("TAG=\"Stop\" ", "", "line 31: <ELEMENT> has no attribute TAG"),
        ("HOLDON=\"0\"", "HOLDON=\"2\"", "line 31: HOLDON is '2', expected 0 or 1"),
        ("TAG=\"AKorr.A2\"", "TAG=\"AKorr.A1\"", "line 25: tag 'AKorr.A1' is given twice"),
        ("TAG=\"DiO\"", "TAG=\"AKorr\"", "line 30: 'AKorr' is both an element with attributes and a scalar"),
        (
            "TAG=\"DiO\"",
            "TAG=\"a b\"",
            "line 30: TAG is 'a b', expected Name or Name.attribute; IPOC is reserved",
        ),
        (
            "TAG=\"DiO\"",
            "TAG=\"IPOC\"",
            "line 30: TAG is 'IPOC', expected Name or Name.attribute; IPOC is reserved",
        ),
        ("<ROOT>", "<ROOTS>", "line 1: not an XML document: expected 'ROOTS' tag, not 'ROOT' at 34:1"),
    ];
    for (from, to, reason) in table {
        assert!(FILE.contains(from), "{from}");
        let error = Config::parse(&FILE.replacen(from, to, 1)).unwrap_err();
        assert_eq!(error.to_string(), reason, "{from} -> {to}");
    }
}

#[test]
fn file_with_too_many_entries_is_refused() {
    let entry = |n: usize| format!("<ELEMENT TAG=\"V{n}\" TYPE=\"LONG\" INDX=\"1\"/>\n");
    let with = |count: usize| {
        let entries: String = (0..count).map(entry).collect();
        Config::parse(&FILE.replacen("<ELEMENTS>", &format!("<ELEMENTS>{entries}"), 1))
    };
    assert_eq!(with(123).unwrap().send.len(), 128);
    assert!(with(124).unwrap_err().to_string().ends_with("more than 128 entries"));
    assert!(with(100_000 / 40).is_err());
}
