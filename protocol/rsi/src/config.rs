//! The configuration file of the controller: its address, and the values of each direction.
//!
//! A controller reads it to know what to send; a client reads the same file to know the names.

use std::fmt;

use roxmltree::{Document, Node};

use crate::error::{ConfigError, ConfigProblem};
use crate::names::{AXIS_NAMES, CARTESIAN_NAMES};
use crate::telegram::Element;
use crate::value::ValueType;
use crate::{MAX_CONFIG_BYTES, xml};

/// Most entries of one direction.
pub const MAX_ENTRIES: usize = 128;
/// Highest number of an object input or output.
pub const MAX_INDEX: u8 = 64;

/// Transport of the telegrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Protocol {
    /// Stream; KR C2 only.
    Tcp,
    /// Datagrams; the only transport of a KR C4.
    Udp,
}

/// A tag: `Name` or `Name.attribute`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Tag {
    pub element: String,
    /// Name of the attribute; `None` for a scalar.
    pub attribute: Option<String>,
}

impl Tag {
    fn parse(text: &str) -> Option<Self> {
        let (element, attribute) = match text.split_once('.') {
            Some((element, attribute)) => (element, Some(attribute)),
            None => (text, None),
        };
        let valid = xml::is_name(element) && attribute.is_none_or(xml::is_name) && element != "IPOC";
        valid.then(|| Self { element: element.to_owned(), attribute: attribute.map(str::to_owned) })
    }

    /// Puts a value into the list of elements; equal names share one element.
    pub(crate) fn put(&self, elements: &mut Vec<Element>, text: String) {
        let Some(attribute) = &self.attribute else {
            elements.push(Element::scalar(&self.element, text));
            return;
        };
        let value = (attribute.clone(), text);
        match elements.iter_mut().find(|element| element.name == self.element) {
            Some(element) => element.attributes.push(value),
            None => elements.push(Element {
                name: self.element.clone(),
                attributes: vec![value],
                text: String::new(),
            }),
        }
    }
}

impl fmt::Display for Tag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.attribute {
            Some(attribute) => write!(f, "{}.{attribute}", self.element),
            None => f.write_str(&self.element),
        }
    }
}

/// A value that the controller has by itself (`DEF_...`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Internal {
    /// Actual pose of the tool.
    RIst,
    /// Programmed pose of the tool.
    RSol,
    /// Actual axes.
    AIPos,
    /// Programmed axes.
    ASPos,
    /// External axes, actual.
    EIPos,
    /// External axes, programmed.
    ESPos,
    /// Motor currents of the axes.
    MACur,
    /// Motor currents of the external axes.
    MECur,
    /// Number of late answers.
    Delay,
    /// Parameters of a function generator (`DEF_Tech...`).
    Technology,
    /// Text for the pendant (`DEF_EStr`).
    MessageText,
    /// A tag that begins with `DEF_` and is not listed here.
    Other,
}

impl Internal {
    const NAMES: [(&'static str, Self); 10] = [
        ("RIst", Self::RIst),
        ("RSol", Self::RSol),
        ("AIPos", Self::AIPos),
        ("ASPos", Self::ASPos),
        ("EIPos", Self::EIPos),
        ("ESPos", Self::ESPos),
        ("MACur", Self::MACur),
        ("MECur", Self::MECur),
        ("Delay", Self::Delay),
        ("EStr", Self::MessageText),
    ];

    /// From the tag without `DEF_`.
    fn of(tag: &Tag) -> Self {
        let known = Self::NAMES.iter().find(|(name, _)| *name == tag.element && tag.attribute.is_none());
        match known {
            Some((_, internal)) => *internal,
            None if tag.element == "Tech" => Self::Technology,
            None => Self::Other,
        }
    }
}

/// Source or destination of the value of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    Internal(Internal),
    /// Input (sent) or output (received) of the Ethernet object, 1 to 64.
    Object(u8),
}

/// One value that the robot sends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SendEntry {
    /// Its name on the wire; for `DEF_RIst` the element is `RIst`.
    pub tag: Tag,
    pub kind: ValueType,
    /// Where it comes from.
    pub source: Source,
}

/// One value that the robot receives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceiveEntry {
    /// Its name on the wire.
    pub tag: Tag,
    pub kind: ValueType,
    /// Where it goes to.
    pub source: Source,
    /// After a late answer: keep the last value, or take zero.
    pub hold: bool,
}

/// A configuration file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Address of the computer.
    pub ip_number: String,
    pub port: u16,
    /// Transport; UDP if the file does not name one.
    pub protocol: Protocol,
    /// `Type` of answers.
    pub sentype: String,
    /// A byte length stands before each document (`PROTCOLLENGTH`).
    pub length_prefix: bool,
    /// The robot sends only and expects no answers.
    pub only_send: bool,
    /// What the robot sends, in order.
    pub send: Vec<SendEntry>,
    pub receive: Vec<ReceiveEntry>,
}

impl Config {
    /// Reads a file.
    ///
    /// # Errors
    /// The file is not a configuration file: line and reason.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        let of_file = |problem| ConfigError { line: 1, problem: ConfigProblem::Document(problem) };
        let text = xml::text(text.as_bytes(), MAX_CONFIG_BYTES).map_err(of_file)?;
        // Elements, and the white space between them.
        let document = xml::document(text, 2 * (2 * MAX_ENTRIES + 32)).map_err(of_file)?;
        let reader = Reader { document: &document };
        let root = document.root_element();
        if root.tag_name().name() != "ROOT" {
            return Err(reader.error(root, ConfigProblem::NoElement("ROOT")));
        }
        let config = reader.child(root, "CONFIG")?;
        let ip = reader.child(config, "IP_NUMBER")?;
        let only_send =
            reader.word(config, "ONLYSEND", "TRUE or FALSE", &[("TRUE", true), ("FALSE", false)])?;
        let only_send = only_send.unwrap_or(false);
        let send = reader.send(root)?;
        let receive =
            if only_send && find(root, "RECEIVE").is_none() { Vec::new() } else { reader.receive(root)? };
        Ok(Self {
            ip_number: content(ip).to_owned(),
            port: reader.port(config)?,
            protocol: reader
                .word(config, "PROTOCOL", "TCP or UDP", &[("TCP", Protocol::Tcp), ("UDP", Protocol::Udp)])?
                .unwrap_or(Protocol::Udp),
            sentype: content(reader.child(config, "SENTYPE")?).to_owned(),
            length_prefix: reader
                .word(config, "PROTCOLLENGTH", "On or Off", &[("On", true), ("Off", false)])?
                .unwrap_or(false),
            only_send,
            send,
            receive,
        })
    }

    /// Places in [`Config::receive`] of an axis correction: the first element with attributes `A1` to `A6`
    /// (`AKorr` or `AK` in most files).
    #[must_use]
    pub fn axis_correction(&self) -> Option<[usize; 6]> {
        self.six(&AXIS_NAMES)
    }

    /// Places in [`Config::receive`] of a Cartesian correction: the first element with attributes X, Y, Z, A, B, C.
    #[must_use]
    pub fn cartesian_correction(&self) -> Option<[usize; 6]> {
        self.six(&CARTESIAN_NAMES)
    }

    /// Place in [`Config::receive`] of the scalar `name`.
    #[must_use]
    pub fn scalar(&self, name: &str) -> Option<usize> {
        self.receive.iter().position(|entry| entry.tag.element == name && entry.tag.attribute.is_none())
    }

    fn six(&self, names: &[&str; 6]) -> Option<[usize; 6]> {
        let place = |element: &str, attribute: &str| {
            self.receive.iter().position(|entry| {
                entry.tag.element == element
                    && entry.tag.attribute.as_deref() == Some(attribute)
                    && entry.kind == ValueType::Double
            })
        };
        self.receive.iter().find_map(|entry| {
            let mut places = [0; 6];
            for (slot, name) in places.iter_mut().zip(names) {
                *slot = place(&entry.tag.element, name)?;
            }
            Some(places)
        })
    }
}

fn find<'a, 'i>(parent: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    parent.children().find(|node| node.is_element() && node.tag_name().name() == name)
}

fn content<'a>(node: Node<'a, '_>) -> &'a str {
    node.text().unwrap_or_default().trim()
}

struct Reader<'a, 'i> {
    document: &'a Document<'i>,
}

impl<'a, 'i> Reader<'a, 'i> {
    fn error(&self, node: Node<'_, '_>, problem: ConfigProblem) -> ConfigError {
        ConfigError { line: self.document.text_pos_at(node.range().start).row, problem }
    }

    fn bad(
        &self,
        node: Node<'_, '_>,
        place: &'static str,
        text: &str,
        expected: &'static str,
    ) -> ConfigError {
        let text = text.chars().take(40).collect();
        self.error(node, ConfigProblem::Value { place, text, expected })
    }

    fn child(&self, parent: Node<'a, 'i>, name: &'static str) -> Result<Node<'a, 'i>, ConfigError> {
        find(parent, name).ok_or_else(|| self.error(parent, ConfigProblem::NoElement(name)))
    }

    fn port(&self, config: Node<'a, 'i>) -> Result<u16, ConfigError> {
        let node = self.child(config, "PORT")?;
        let port = content(node).parse().ok().filter(|port| *port > 0);
        port.ok_or_else(|| self.bad(node, "PORT", content(node), "1 to 65535"))
    }

    /// One of some words; `None` if the element is not there.
    fn word<T: Copy>(
        &self,
        config: Node<'a, 'i>,
        name: &'static str,
        expected: &'static str,
        words: &[(&str, T)],
    ) -> Result<Option<T>, ConfigError> {
        let Some(node) = find(config, name) else { return Ok(None) };
        let known = words.iter().find(|(word, _)| word.eq_ignore_ascii_case(content(node)));
        match known {
            Some((_, value)) => Ok(Some(*value)),
            None => Err(self.bad(node, name, content(node), expected)),
        }
    }

    fn entries(
        &self,
        root: Node<'a, 'i>,
        direction: &'static str,
    ) -> Result<Vec<(Node<'a, 'i>, Tag, ValueType, Source)>, ConfigError> {
        let list = self.child(self.child(root, direction)?, "ELEMENTS")?;
        let mut entries: Vec<(Node<'a, 'i>, Tag, ValueType, Source)> = Vec::new();
        for node in list.children().filter(|n| n.is_element() && n.tag_name().name() == "ELEMENT") {
            if entries.len() == MAX_ENTRIES {
                return Err(self.error(node, ConfigProblem::TooMany(MAX_ENTRIES)));
            }
            let (tag, kind, source) = self.entry(node)?;
            if entries.iter().any(|(_, other, ..)| *other == tag) {
                return Err(self.error(node, ConfigProblem::TagTwice(tag.to_string())));
            }
            let mixed = entries.iter().any(|(_, other, ..)| {
                other.element == tag.element && other.attribute.is_none() != tag.attribute.is_none()
            });
            if mixed {
                return Err(self.error(node, ConfigProblem::Mixed(tag.element)));
            }
            entries.push((node, tag, kind, source));
        }
        Ok(entries)
    }

    fn entry(&self, node: Node<'a, 'i>) -> Result<(Tag, ValueType, Source), ConfigError> {
        let attribute = |name: &'static str| {
            node.attribute(name).ok_or_else(|| self.error(node, ConfigProblem::NoAttribute(name)))
        };
        let (tag_text, kind_text, index) = (attribute("TAG")?, attribute("TYPE")?, attribute("INDX")?);
        let kind = ValueType::from_name(kind_text)
            .ok_or_else(|| self.bad(node, "TYPE", kind_text, "BOOL, STRING, LONG or DOUBLE"))?;
        let internal = tag_text.strip_prefix("DEF_");
        let tag = Tag::parse(internal.unwrap_or(tag_text))
            .ok_or_else(|| self.bad(node, "TAG", tag_text, "Name or Name.attribute; IPOC is reserved"))?;
        let source = match (internal, index) {
            (Some(_), "INTERNAL") => Source::Internal(Internal::of(&tag)),
            (Some(_), _) => {
                return Err(self.bad(node, "INDX", index, "INTERNAL for a tag that begins with DEF_"));
            }
            (None, _) => {
                let number = index.parse().ok().filter(|n| (1..=MAX_INDEX).contains(n));
                Source::Object(number.ok_or_else(|| {
                    self.bad(node, "INDX", index, "1 to 64; INTERNAL is for tags that begin with DEF_")
                })?)
            }
        };
        Ok((tag, kind, source))
    }

    fn send(&self, root: Node<'a, 'i>) -> Result<Vec<SendEntry>, ConfigError> {
        let entries = self.entries(root, "SEND")?;
        Ok(entries.into_iter().map(|(_, tag, kind, source)| SendEntry { tag, kind, source }).collect())
    }

    fn receive(&self, root: Node<'a, 'i>) -> Result<Vec<ReceiveEntry>, ConfigError> {
        let entry = |(node, tag, kind, source): (Node<'a, 'i>, Tag, ValueType, Source)| {
            let hold = match node.attribute("HOLDON").unwrap_or("0") {
                "0" => false,
                "1" => true,
                other => return Err(self.bad(node, "HOLDON", other, "0 or 1")),
            };
            Ok(ReceiveEntry { tag, kind, source, hold })
        };
        self.entries(root, "RECEIVE")?.into_iter().map(entry).collect()
    }
}
