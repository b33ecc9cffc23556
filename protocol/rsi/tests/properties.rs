//! Round trips, and invalid input.

use proptest::prelude::*;
use rsi_protocol::{
    Config, Element, Ipoc, MAX_WRITTEN_BYTES, RobotState, Root, SensorWriter, Telegram, Value, WriteError,
    read_answer,
};

const FILE: &str = include_str!("data/axis_absolute.xml");

fn name() -> impl Strategy<Value = String> {
    "[A-Za-z_][A-Za-z0-9_-]{0,12}".prop_filter("reserved", |name| name != "IPOC" && name != "Dat")
}

fn text() -> impl Strategy<Value = String> {
    "[ -~\\t\\n\\r\u{e4}\u{20ac}]{0,24}"
}

fn element() -> impl Strategy<Value = Element> {
    let attributes = prop::collection::btree_map(name(), text(), 0..4);
    (name(), attributes, text()).prop_map(|(name, attributes, text)| Element {
        name,
        attributes: attributes.into_iter().filter(|(key, _)| key != "xmlns").collect(),
        text,
    })
}

fn telegram() -> impl Strategy<Value = Telegram> {
    let elements = prop::collection::vec(element(), 0..6);
    let root = prop::sample::select(vec![Root::Rob, Root::Sen]);
    (root, prop::option::of(text()), elements, any::<u64>(), 1..=20_u8).prop_map(
        |(root, kind, mut elements, value, digits)| {
            let mut names = std::collections::BTreeSet::new();
            elements.retain(|element| names.insert(element.name.clone()));
            Telegram { root, kind, elements, ipoc: Ipoc::padded(value, digits) }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, ..ProptestConfig::default() })]

    #[test]
    fn telegram_is_read_as_it_was_written(telegram in telegram()) {
        match telegram.write() {
            Ok(bytes) => {
                prop_assert!(bytes.len() <= MAX_WRITTEN_BYTES);
                let read = Telegram::parse(&bytes, telegram.root).unwrap();
                prop_assert_eq!(&read, &telegram);
                prop_assert_eq!(read.ipoc.to_string(), telegram.ipoc.to_string());
            }
            Err(error) => prop_assert!(matches!(error, WriteError::TooLong { .. }), "{}", error),
        }
    }

    #[test]
    fn correction_is_read_to_the_last_written_decimal(
        axes in prop::array::uniform6(-400.0..400.0_f64), decimals in 4..=6_u8, outputs in any::<i32>(),
    ) {
        let config = Config::parse(FILE).unwrap();
        let places = config.axis_correction().unwrap();
        let dio = config.scalar("DiO").unwrap();
        let bytes = SensorWriter::new(&config, decimals).write(Ipoc::new(1), |entry| {
            let place = config.receive.iter().position(|other| other == entry)?;
            if place == dio {
                return Some(Value::Long(outputs));
            }
            places.iter().position(|p| *p == place).map(|axis| Value::Double(axes[axis]))
        }).unwrap();
        let values = read_answer(&Telegram::parse(&bytes, Root::Sen).unwrap(), &config).unwrap();
        for (place, axis) in places.iter().zip(axes) {
            let read = values[*place].as_ref().unwrap().number().unwrap();
            prop_assert!((read - axis).abs() <= 0.5001 * 10f64.powi(-i32::from(decimals)), "{} {}", read, axis);
        }
        prop_assert_eq!(&values[dio], &Some(Value::Long(outputs)));
    }

    #[test]
    fn no_bytes_make_the_readers_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let config = Config::parse(FILE).unwrap();
        for root in [Root::Rob, Root::Sen] {
            if let Ok(telegram) = Telegram::parse(&bytes, root) {
                let _ = (RobotState::read(&telegram), read_answer(&telegram, &config));
            }
        }
        let _ = Config::parse(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn no_damage_to_a_document_makes_the_readers_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 1..8),
    ) {
        let mut robot = br#"<Rob Type="KUKA"><AIPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="90.0" A6="0.0"/><Delay D="0"/><IPOC>4711</IPOC></Rob>"#.to_vec();
        let mut config = FILE.as_bytes().to_vec();
        for document in [&mut robot, &mut config] {
            for (at, byte, remove) in &edits {
                let at = at.index(document.len());
                if *remove { document.remove(at); } else { document[at] = *byte; }
            }
        }
        if let Ok(telegram) = Telegram::parse(&robot, Root::Rob) {
            let _ = RobotState::read(&telegram);
        }
        let _ = Config::parse(&String::from_utf8_lossy(&config));
    }
}
