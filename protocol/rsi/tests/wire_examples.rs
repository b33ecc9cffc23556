//! The documents of both generations, byte by byte.

use rsi_protocol::{
    Config, Ipoc, ReadError, RobotData, RobotState, RobotWriter, Root, SensorWriter, Telegram, Value,
    read_answer,
};

const CONFIG: &str = include_str!("data/axis_absolute.xml");
const ROBOT: &[u8] = br#"<Rob Type="KUKA"><RIst X="930.0000" Y="0.0000" Z="1162.0000" A="180.0000" B="0.0000" C="180.0000"/><RSol X="930.0000" Y="0.0000" Z="1162.0000" A="180.0000" B="0.0000" C="180.0000"/><AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/><ASPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/><Delay D="0"/><IPOC>4711</IPOC></Rob>"#;
const FIRST: &[u8] = br#"<Rob Type="KUKA"><IPOC>4710</IPOC></Rob>"#;
const ANSWER: &[u8] = br#"<Sen Type="ImFree"><AKorr A1="0.000000" A2="-0.008640" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/><IPOC>4711</IPOC></Sen>"#;

const AXES_DEG: [f64; 6] = [0.0, -90.0, 90.0, 0.0, 90.0, 0.0];
const TOOL_MM_DEG: [f64; 6] = [930.0, 0.0, 1162.0, 180.0, 0.0, 180.0];

fn config() -> Config {
    Config::parse(CONFIG).expect("the example file is valid")
}

fn data() -> RobotData {
    RobotData {
        rist_mm_deg: TOOL_MM_DEG,
        rsol_mm_deg: TOOL_MM_DEG,
        aipos_deg: AXES_DEG,
        aspos_deg: AXES_DEG,
        ..RobotData::default()
    }
}

/// An answer that corrects the axes only.
fn correction(config: &Config, axes_deg: [f64; 6]) -> impl Fn(&rsi_protocol::ReceiveEntry) -> Option<Value> {
    let places = config.axis_correction().expect("the file has an axis correction");
    let tags = places.map(|place| config.receive[place].tag.clone());
    move |entry| tags.iter().position(|tag| *tag == entry.tag).map(|axis| Value::Double(axes_deg[axis]))
}

#[test]
fn examples_have_the_documented_lengths() {
    assert_eq!((ROBOT.len(), FIRST.len(), ANSWER.len()), (386, 40, 135));
}

#[test]
fn robot_telegram_is_written_and_read_byte_by_byte() {
    let config = config();
    let writer = RobotWriter::new(&config, 4);
    let written = writer.write(Ipoc::new(4711), &data(), |_| None).unwrap();
    assert_eq!(String::from_utf8(written).unwrap(), String::from_utf8(ROBOT.to_vec()).unwrap());
    let telegram = Telegram::parse(ROBOT, Root::Rob).unwrap();
    assert_eq!(telegram.write().unwrap(), ROBOT);
    let state = RobotState::read(&telegram).unwrap();
    assert_eq!(state.rist_mm_deg, Some(TOOL_MM_DEG));
    assert_eq!((state.aipos_deg, state.aspos_deg), (Some(AXES_DEG), Some(AXES_DEG)));
    assert_eq!((state.delay, state.eipos), (Some(0), None));
}

#[test]
fn first_telegram_of_a_kr_c2_holds_the_ipoc_only() {
    assert_eq!(RobotWriter::first(Ipoc::new(4710)).unwrap(), FIRST);
    let telegram = Telegram::parse(FIRST, Root::Rob).unwrap();
    assert!(telegram.elements.is_empty());
    assert_eq!(telegram.ipoc.value(), 4710);
    assert_eq!(RobotState::read(&telegram).unwrap(), RobotState::default());
}

#[test]
fn answer_is_written_and_read_byte_by_byte() {
    let config = config();
    let axes_deg = [0.0, -0.00864, 0.0, 0.0, 0.0, 0.0];
    let written =
        SensorWriter::new(&config, 6).write(Ipoc::new(4711), correction(&config, axes_deg)).unwrap();
    assert_eq!(String::from_utf8(written).unwrap(), String::from_utf8(ANSWER.to_vec()).unwrap());
    let telegram = Telegram::parse(ANSWER, Root::Sen).unwrap();
    assert_eq!(telegram.kind.as_deref(), Some("ImFree"));
    let values = read_answer(&telegram, &config).unwrap();
    let places = config.axis_correction().unwrap();
    assert_eq!(places.map(|place| values[place].as_ref().and_then(Value::number)), axes_deg.map(Some));
    // The outputs are not in this answer.
    assert_eq!(values[config.scalar("DiO").unwrap()], None);
}

#[test]
fn kr_c4_sends_one_decimal_and_a_larger_step() {
    let config = config();
    let written = RobotWriter::new(&config, 1).write(Ipoc::new(4_208_163_634), &data(), |_| None).unwrap();
    let text = String::from_utf8(written).unwrap();
    assert!(text.starts_with(r#"<Rob Type="KUKA"><RIst X="930.0" Y="0.0" Z="1162.0""#), "{text}");
    assert!(text.ends_with(r#"<Delay D="0"/><IPOC>4208163634</IPOC></Rob>"#), "{text}");
}

/// The older form: declaration, name space, `<Dat>`, padded IPOC, CR LF, blanks before `/>`, NUL at the end.
#[test]
fn older_form_of_the_answer_is_read() {
    let old = concat!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\r\n",
        "<Sen TYPE=\"ImFree\" xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" ",
        "xsi:noNamespaceSchemaLocation=\"ExternalData.xsd\">\r\n",
        "  <Dat TaskType=\"b\">\r\n    <EStr>Info: hello</EStr>\r\n",
        "    <AKorr A6=\"6\" A1=\"+0.5\" A2=\"-0.25\" A3=\".125\" A4=\"0\" A5=\"0.0\" />\r\n",
        "    <DiO>125</DiO>\r\n    <Unknown x=\"1\"/>\r\n    <IPOC>0000004711</IPOC>\r\n  </Dat>\r\n</Sen>\r\n\0",
    );
    let config = config();
    let telegram = Telegram::parse(old.as_bytes(), Root::Sen).unwrap();
    assert_eq!(telegram.kind.as_deref(), Some("ImFree"));
    assert_eq!((telegram.ipoc, telegram.ipoc.to_string().as_str()), (Ipoc::new(4711), "0000004711"));
    let values = read_answer(&telegram, &config).unwrap();
    let axes =
        config.axis_correction().unwrap().map(|place| values[place].as_ref().unwrap().number().unwrap());
    assert_eq!(axes, [0.5, -0.25, 0.125, 0.0, 0.0, 6.0]);
    assert_eq!(values[config.scalar("DiO").unwrap()], Some(Value::Long(125)));
}

/// Found by fuzzing: the inner `<Dat>` was read as an element that cannot be written back.
#[test]
fn container_inside_a_container_and_attributes_of_other_name_spaces_are_skipped() {
    let text = "<Sen Type=\"ImFree\" xmlns:x=\"u\"><Dat><Dat TaskType=\"b\"><IPOC>7</IPOC></Dat><DiO x:a=\"1\" \
                a=\"2\">5</DiO><IPOC>1</IPOC></Dat></Sen>";
    let telegram = Telegram::parse(text.as_bytes(), Root::Sen).unwrap();
    assert_eq!(telegram.ipoc.value(), 1);
    assert_eq!(telegram.write().unwrap(), br#"<Sen Type="ImFree"><DiO a="2">5</DiO><IPOC>1</IPOC></Sen>"#);
}

#[test]
fn echoed_ipoc_keeps_its_digits() {
    let telegram = Telegram::parse(br#"<Rob Type="KUKA"><IPOC>0000000099</IPOC></Rob>"#, Root::Rob).unwrap();
    let config = config();
    let answer = SensorWriter::new(&config, 6).write(telegram.ipoc, |_| None).unwrap();
    assert_eq!(answer, br#"<Sen Type="ImFree"><IPOC>0000000099</IPOC></Sen>"#);
}

#[test]
fn documents_that_break_a_rule_are_refused_with_the_reason() {
    let rob = |text: &str| Telegram::parse(text.as_bytes(), Root::Rob).map(|t| RobotState::read(&t));
    let refusal = |text: &str| match rob(text) {
        Ok(Ok(_)) => panic!("accepted: {text}"),
        Ok(Err(error)) | Err(error) => error.to_string(),
    };
    let table = [
        ("<Rob></Rob>", "no element <IPOC>"),
        ("<Sen><IPOC>1</IPOC></Sen>", "the root element is <Sen>, expected <Rob>"),
        ("<Rob><IPOC>1</IPOC><IPOC>1</IPOC></Rob>", "element <IPOC> occurs twice"),
        ("<Rob><Delay D=\"0\"/><Delay D=\"1\"/><IPOC>1</IPOC></Rob>", "element <Delay> occurs twice"),
        ("<Rob><AIPos A1=\"1\"/><IPOC>1</IPOC></Rob>", "element <AIPos> has no attribute A2"),
        ("<Rob><Delay D=\"-1\"/><IPOC>1</IPOC></Rob>", "Delay.D is '-1', expected a count"),
        ("<Rob><Delay/><IPOC>1</IPOC></Rob>", "element <Delay> has no attribute D"),
    ];
    for (text, reason) in table {
        assert_eq!(refusal(text), reason, "{text}");
    }
    for ipoc in ["", "-1", "+1", "1.0", "1e3", "18446744073709551616", "000000000000000000001"] {
        let text = format!("<Rob><IPOC>{ipoc}</IPOC></Rob>");
        assert!(refusal(&text).starts_with(&format!("<IPOC> is '{ipoc}'")), "{}", refusal(&text));
    }
    assert_eq!(rob("<Rob><IPOC>18446744073709551615</IPOC></Rob>").unwrap(), Ok(RobotState::default()));
    for number in ["1e10", "nan", "inf", "0x10", "1,5", "", "e-3", "--1", "1000000000"] {
        let text = format!(
            "<Rob><AIPos A1=\"{number}\" A2=\"0\" A3=\"0\" A4=\"0\" A5=\"0\" A6=\"0\"/><IPOC>1</IPOC></Rob>"
        );
        assert!(refusal(&text).starts_with("AIPos.A1 is "), "{text}: {}", refusal(&text));
    }
    assert!(refusal("<!DOCTYPE Rob [<!ENTITY a \"b\">]><Rob><IPOC>1</IPOC></Rob>").starts_with("not an XML"));
    assert!(refusal("<Rob><IPOC>1</IPOC></Rob><Rob/>").starts_with("not an XML document"));
    assert!(matches!(
        Telegram::parse(&vec![b'<'; 5000], Root::Rob),
        Err(ReadError::TooLong { len: 5000, max: 4096 })
    ));
    assert!(matches!(Telegram::parse(b"<Rob>\xff</Rob>", Root::Rob), Err(ReadError::NotText { at: 5 })));
}

#[test]
fn one_wrong_value_refuses_the_whole_answer() {
    let text = "<Sen Type=\"ImFree\"><AKorr A1=\"1\" A2=\"x\"/><IPOC>1</IPOC></Sen>";
    let telegram = Telegram::parse(text.as_bytes(), Root::Sen).unwrap();
    let error = read_answer(&telegram, &config()).unwrap_err();
    assert!(error.to_string().starts_with("AKorr.A2 is 'x'"), "{error}");
}

#[test]
fn values_that_cannot_be_decimals_are_not_written() {
    let config = config();
    let write = |x: f64| {
        SensorWriter::new(&config, 6).write(Ipoc::new(1), correction(&config, [x, 0.0, 0.0, 0.0, 0.0, 0.0]))
    };
    for x in [f64::NAN, f64::INFINITY, 1e9, -1e12, 999_999_999.999_999_9] {
        assert!(write(x).is_err(), "{x}");
    }
    let text = String::from_utf8(write(-1e-9).unwrap()).unwrap();
    assert!(text.contains(r#"A1="0.000000""#), "minus zero: {text}");
}
