//! The text of a sheet: sections in brackets, `key=value`, comments after a semicolon.

use std::collections::BTreeMap;

use protocol::canopen::Object;

use super::{Eds, EdsError, Entry, Identity, Number};

type Values = BTreeMap<String, (usize, String)>;

/// Sections that only name, count or comment.
const NAMELESS: u16 = 0;

struct Section {
    line: usize,
    values: Values,
}

fn error(line: usize, problem: impl Into<String>) -> EdsError {
    EdsError { line, problem: problem.into() }
}

fn unsigned(text: &str) -> Option<i64> {
    let digits = |text: &str, radix| match text.chars().next() {
        // `from_str_radix` takes a sign.
        Some(first) if first.is_ascii_hexdigit() => i64::from_str_radix(text, radix).ok(),
        _ => None,
    };
    match text.strip_prefix("0x").or(text.strip_prefix("0X")) {
        Some(hex) => digits(hex, 16),
        None if text.len() > 1 && text.starts_with('0') => digits(text, 8),
        None => digits(text, 10),
    }
}

/// `16`, `-1`, `0x10`, `020` (octal), `$NODEID+0x600`, `0x600+$NODEID`.
fn number(text: &str) -> Option<Number> {
    let (mut value, mut adds_node) = (None, false);
    for part in text.split('+').map(str::trim) {
        if part.eq_ignore_ascii_case("$NODEID") {
            if std::mem::replace(&mut adds_node, true) {
                return None;
            }
        } else {
            let read = match part.strip_prefix('-') {
                Some(rest) => -unsigned(rest)?,
                None => unsigned(part)?,
            };
            if value.replace(read).is_some() {
                return None;
            }
        }
    }
    (value.is_some() || adds_node).then_some(Number { value: value.unwrap_or(0), adds_node })
}

impl Section {
    fn text(&self, key: &str) -> Option<&(usize, String)> {
        self.values.get(key).filter(|(_, text)| !text.is_empty())
    }

    fn number(&self, key: &str) -> Result<Option<Number>, EdsError> {
        let Some((line, text)) = self.text(key) else { return Ok(None) };
        let read = number(text).ok_or_else(|| error(*line, format!("{key} = {text} is not a number")))?;
        Ok(Some(read))
    }

    /// A number that does not depend on the node.
    fn plain(&self, key: &str, max: i64) -> Result<Option<i64>, EdsError> {
        let Some(read) = self.number(key)? else { return Ok(None) };
        let line = self.text(key).map_or(self.line, |(line, _)| *line);
        if read.adds_node || !(0..=max).contains(&read.value) {
            return Err(error(line, format!("{key} is 0 to {max}")));
        }
        Ok(Some(read.value))
    }

    fn entry(&self) -> Result<Entry, EdsError> {
        let data_type = self.plain("datatype", 0xFFFF)?;
        let data_type = data_type.ok_or_else(|| error(self.line, "DataType is missing"))? as u16;
        let access = self.text("accesstype").map_or("", |(_, text)| text.as_str());
        let is_writable = match access.to_ascii_lowercase().as_str() {
            "rw" | "wo" | "rwr" | "rww" => true,
            "ro" | "const" => false,
            _ => {
                return Err(error(
                    self.line,
                    format!("AccessType '{access}' is not ro, wo, rw, rwr, rww or const"),
                ));
            }
        };
        let mut entry = Entry {
            name: self.text("parametername").map(|(_, text)| text.clone()).unwrap_or_default(),
            data_type,
            is_writable,
            is_mappable: self.plain("pdomapping", 1)? == Some(1),
            ..Entry::default()
        };
        // Texts and domains have values that are no numbers; those of real numbers are of no use here.
        if entry.bytes().is_some() && !matches!(data_type, 0x08 | 0x11) {
            entry.low = self.number("lowlimit")?;
            entry.high = self.number("highlimit")?;
            // Nothing depends on it, and sheets of programs have `0.0` for integers.
            entry.default = self.number("defaultvalue").unwrap_or_default();
            entry.configured = self.number("parametervalue")?;
        }
        Ok(entry)
    }
}

/// `1018`, `1018sub2`, `1018value`: index, and what follows.
fn object_name(name: &str) -> Option<(u16, &str)> {
    let (index, rest) = name.split_at_checked(4)?;
    let index =
        u16::from_str_radix(index, 16).ok().filter(|_| index.chars().all(|c| c.is_ascii_hexdigit()))?;
    let is_object =
        rest.is_empty() || rest.starts_with("sub") || matches!(rest, "value" | "name" | "denotation");
    (is_object && index != NAMELESS).then_some((index, rest))
}

fn sections(text: &str) -> Result<BTreeMap<String, Section>, EdsError> {
    let mut all: BTreeMap<String, Section> = BTreeMap::new();
    let mut open: Option<String> = None;
    for (line, text) in text.lines().enumerate().map(|(at, text)| (at + 1, text.trim())) {
        if text.is_empty() || text.starts_with(';') || text.starts_with('#') {
            continue;
        }
        if let Some(name) = text.strip_prefix('[') {
            let name = name.split_once(']').ok_or_else(|| error(line, "] is missing"))?.0;
            let name = name.trim().to_ascii_lowercase();
            if all.insert(name.clone(), Section { line, values: Values::new() }).is_some() {
                return Err(error(line, format!("section [{name}] comes twice")));
            }
            open = Some(name);
            continue;
        }
        let (key, value) =
            text.split_once('=').ok_or_else(|| error(line, "neither a section nor key=value"))?;
        // A comment behind a value; a name may hold a semicolon only without a blank before it.
        let value = value.split_once(" ;").or(value.split_once("\t;")).map_or(value, |(value, _)| value);
        let section = open.as_ref().and_then(|open| all.get_mut(open));
        let section = section.ok_or_else(|| error(line, "a value before the first section"))?;
        section.values.insert(key.trim().to_ascii_lowercase(), (line, value.trim().to_owned()));
    }
    Ok(all)
}

impl Eds {
    /// Reads a sheet.
    ///
    /// # Errors
    /// A line that is not of the form, a type or an access that is missing or unknown, a sheet without objects.
    pub fn read(text: &str) -> Result<Self, EdsError> {
        let all = sections(text)?;
        let mut entries = BTreeMap::new();
        for (name, section) in &all {
            let Some((index, rest)) = object_name(name) else { continue };
            if let Some(sub) = rest.strip_prefix("sub") {
                let sub = u8::from_str_radix(sub, 16);
                let sub =
                    sub.map_err(|_| error(section.line, format!("[{name}]: a sub-index is 0 to FF")))?;
                entries.insert(Object::new(index, sub), section.entry()?);
            } else if rest.is_empty() {
                let count = section.plain("compactsubobj", 254)?.unwrap_or(0) as u8;
                let has_subs = section.plain("subnumber", 255)?.is_some_and(|count| count > 0);
                if count > 0 {
                    compact(&all, name, index, count, &section.entry()?, &mut entries)?;
                } else if !has_subs {
                    entries.insert(Object::new(index, 0), section.entry()?);
                }
            }
        }
        if entries.is_empty() {
            return Err(error(1, "no object has a section: it is not an EDS or DCF"));
        }
        let info = all.get("deviceinfo");
        let of = |key| match info {
            Some(info) => info.plain(key, u32::MAX.into()).map(|value| value.map(|value| value as u32)),
            None => Ok(None),
        };
        let identity = Identity {
            vendor: of("vendornumber")?,
            product: of("productnumber")?,
            revision: of("revisionnumber")?,
        };
        Ok(Self { identity, entries })
    }
}

/// An array whose sub-indices are alike; the values of a DCF stand in a section of their own.
fn compact(
    all: &BTreeMap<String, Section>,
    name: &str,
    index: u16,
    count: u8,
    like: &Entry,
    entries: &mut BTreeMap<Object, Entry>,
) -> Result<(), EdsError> {
    let own = all.get(&format!("{name}value"));
    let first = Entry { name: "number of entries".to_owned(), data_type: 0x05, ..Entry::default() };
    entries.entry(Object::new(index, 0)).or_insert(first);
    for sub in 1..=count {
        let configured = own.map(|own| own.number(&sub.to_string())).transpose()?.flatten();
        let entry = Entry { configured: configured.or(like.configured), ..like.clone() };
        entries.entry(Object::new(index, sub)).or_insert(entry);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::canopen::NodeId;

    /// The forms that sheets of makers have: another case, blanks, comments, octal and hexadecimal numbers, compact arrays, values of a DCF.
    const SHEET: &str = "; made by hand\r\n[DeviceInfo]\r\nVendorNumber=0x000000FB\r\nProductNumber = 1629487104\r\n\r\n[1000]\r\n\
        ParameterName=Device Type\r\nObjectType=0x7\r\nDataType=0x0007\r\nAccessType=ro\r\nDefaultValue=0x20192 ; servo\r\nPDOMapping=0\r\n\
        [1018]\nSubNumber=2\nObjectType=9\n[1018SUB0]\nDataType=5\nAccessType=CONST\n[1018Sub1]\nDataType=7\nAccessType=ro\nDefaultValue=0373\n\
        [1400]\nSubNumber=2\n[1400sub1]\nDataType=7\nAccessType=rw\nDefaultValue=$NodeID+0x200\nParameterValue=0x203\n\
        [1600]\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=3\n[1600Value]\nNrOfEntries=1\n2=0x607A0020\n\
        [6098]\nDataType=2\nAccessType=rww\nPDOMapping=1\nLowLimit=-128\nHighLimit=37\n[1008]\nDataType=9\nAccessType=const\nDefaultValue=a; b\n\
        [1017]\nDataType=6\nAccessType=rw\nDefaultValue=0.0\n[Comments]\nLines=0\n";

    #[test]
    fn objects_types_access_limits_values_and_identity_are_read() {
        let eds = Eds::read(SHEET).unwrap();
        let node = NodeId::new(3).unwrap();
        let entry = |index, sub| eds.entries.get(&Object::new(index, sub)).unwrap();
        assert_eq!(eds.identity, Identity { vendor: Some(0xFB), product: Some(0x6120_0000), revision: None });
        assert_eq!(entry(0x1017, 0).default, None, "0.0 is left out");
        assert_eq!(entry(0x1000, 0).default.unwrap().of(node), 0x20192);
        assert_eq!(entry(0x1018, 1).default.unwrap().of(node), 0xFB, "octal");
        assert_eq!(entry(0x1400, 1).default.unwrap().of(node), 0x203);
        assert_eq!(entry(0x1400, 1).configured.unwrap().of(node), 0x203);
        assert_eq!(entry(0x1600, 2).configured.unwrap().of(node), 0x607A_0020);
        assert_eq!(entry(0x1600, 3).configured, None);
        assert_eq!(entry(0x1600, 0).bytes(), Some(1));
        let homing = entry(0x6098, 0);
        assert!(homing.is_writable && homing.is_mappable && homing.is_signed());
        assert_eq!((homing.low.unwrap().of(node), homing.high.unwrap().of(node)), (-128, 37));
        assert_eq!(entry(0x1008, 0).bytes(), None);
        assert_eq!(eds.entries.len(), 11, "{:?}", eds.entries.keys());
    }

    #[test]
    fn a_line_that_is_wrong_is_named_with_its_number() {
        for (text, line, problem) in [
            ("[1000]\nDataType=seven\nAccessType=ro\n", 2, "datatype = seven is not a number"),
            ("[1000]\nAccessType=ro\n", 1, "DataType is missing"),
            ("[1000]\nDataType=7\nAccessType=maybe\n", 1, "AccessType 'maybe'"),
            ("[1000]\nDataType=7\nAccessType=ro\n[1000]\n", 4, "comes twice"),
            ("[1000\n", 1, "] is missing"),
            ("DataType=7\n", 1, "before the first section"),
            ("[1000]\nDataType\n", 2, "neither a section"),
            ("[1000]\nDataType=7\nAccessType=ro\nLowLimit=$NODEID+$NODEID\n", 4, "is not a number"),
            ("[1000sub100]\nDataType=7\nAccessType=ro\n", 1, "a sub-index is 0 to FF"),
            ("[DeviceInfo]\nVendorNumber=1\n", 1, "not an EDS or DCF"),
        ] {
            let error = Eds::read(text).unwrap_err();
            assert_eq!(error.line, line, "{error}");
            assert!(error.problem.contains(problem), "{error}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in "(\\[[0-9a-fA-Fsubv]{0,9}\\]|[A-Za-z]{0,14}=[$NODEIDx0-9+-]{0,12}|;|\n){0,40}") {
            let _ = Eds::read(&text);
        }
    }
}
