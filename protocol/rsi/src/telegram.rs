//! Both documents of the exchange: a root with a type, elements with attributes or text, and the `IPOC`.

use crate::error::{ReadError, WriteError};
use crate::ipoc::Ipoc;
use crate::value::{DECIMAL, parse_decimal};
use crate::{MAX_NODES, MAX_READ_BYTES, MAX_WRITTEN_BYTES, xml};

/// Direction of a telegram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Root {
    /// Robot to computer.
    Rob,
    /// Computer to robot.
    Sen,
}

impl Root {
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rob => "Rob",
            Self::Sen => "Sen",
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Element {
    pub name: String,
    /// Names and values, in order.
    pub attributes: Vec<(String, String)>,
    /// Its text; empty for an element with attributes.
    pub text: String,
}

impl Element {
    /// An element with text only.
    #[must_use]
    pub fn scalar(name: &str, text: impl Into<String>) -> Self {
        Self { name: name.to_owned(), attributes: Vec::new(), text: text.into() }
    }

    #[must_use]
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// Six decimals, all of which must be there.
    ///
    /// # Errors
    /// An attribute is missing or is not a decimal.
    pub fn six(&self, names: &[&str; 6]) -> Result<[f64; 6], ReadError> {
        let mut out = [0.0; 6];
        for (value, name) in out.iter_mut().zip(names) {
            let text = self.attribute(name).ok_or_else(|| ReadError::Missing {
                element: self.name.clone(),
                attribute: (*name).to_owned(),
            })?;
            *value = parse_decimal(text.trim())
                .ok_or_else(|| ReadError::bad_value(format!("{}.{name}", self.name), text, DECIMAL))?;
        }
        Ok(out)
    }
}

/// A telegram of either direction.
#[derive(Clone, Debug, PartialEq)]
pub struct Telegram {
    pub root: Root,
    /// `Type` of the root; `None` if it is absent.
    pub kind: Option<String>,
    /// Elements in the order of the document, without `IPOC`.
    pub elements: Vec<Element>,
    /// Number of the cycle.
    pub ipoc: Ipoc,
}

impl Telegram {
    /// Reads one document.
    ///
    /// The children of `<Dat>` (the older form of answers) are read as if they stood in the root.
    ///
    /// # Errors
    /// The bytes are not one such document.
    pub fn parse(bytes: &[u8], expected: Root) -> Result<Self, ReadError> {
        let text = xml::text(bytes, MAX_READ_BYTES)?;
        let document = xml::document(text, MAX_NODES)?;
        let root = document.root_element();
        if root.tag_name().name() != expected.name() {
            let found = root.tag_name().name().chars().take(40).collect();
            return Err(ReadError::WrongRoot { found, expected: expected.name() });
        }
        let kind = root.attributes().find(|attribute| attribute.name().eq_ignore_ascii_case("type"));
        let mut elements: Vec<Element> = Vec::new();
        let mut ipoc = None;
        let flattened = root.children().flat_map(|child| {
            let dat = child.tag_name().name() == "Dat";
            let (own, inner) = if dat { (None, Some(child.children())) } else { (Some(child), None) };
            own.into_iter().chain(inner.into_iter().flatten())
        });
        for node in flattened.filter(roxmltree::Node::is_element) {
            let name = node.tag_name().name();
            if name == "Dat" {
                // Nested `<Dat>`; no program writes this.
                continue;
            }
            if name == "IPOC" {
                let number = node.text().unwrap_or_default().trim().parse()?;
                if ipoc.replace(number).is_some() {
                    return Err(ReadError::Twice(name.to_owned()));
                }
                continue;
            }
            if elements.iter().any(|element| element.name == name) {
                return Err(ReadError::Twice(name.to_owned()));
            }
            let own = node.attributes().filter(|attribute| attribute.namespace().is_none());
            elements.push(Element {
                name: name.to_owned(),
                attributes: own.map(|a| (a.name().to_owned(), a.value().to_owned())).collect(),
                text: node.text().unwrap_or_default().to_owned(),
            });
        }
        let ipoc = ipoc.ok_or(ReadError::NoIpoc)?;
        Ok(Self { root: expected, kind: kind.map(|attribute| attribute.value().to_owned()), elements, ipoc })
    }

    #[must_use]
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }

    /// Writes the document: one line, no declaration, `"/>` without a blank, `IPOC` last.
    ///
    /// # Errors
    /// A name or text cannot be written in XML, or the document is too long for its receivers.
    pub fn write(&self) -> Result<Vec<u8>, WriteError> {
        let mut out = String::with_capacity(512);
        out.push('<');
        out.push_str(self.root.name());
        if let Some(kind) = &self.kind {
            push_attribute(&mut out, "Type", kind)?;
        }
        out.push('>');
        for element in &self.elements {
            out.push('<');
            xml::push_name(&mut out, &element.name)?;
            for (name, value) in &element.attributes {
                push_attribute(&mut out, name, value)?;
            }
            if element.text.is_empty() && !element.attributes.is_empty() {
                out.push_str("/>");
            } else {
                out.push('>');
                xml::push_escaped(&mut out, &element.text)?;
                push_end(&mut out, &element.name);
            }
        }
        out.push_str("<IPOC>");
        out.push_str(&self.ipoc.to_string());
        push_end(&mut out, "IPOC");
        push_end(&mut out, self.root.name());
        if out.len() > MAX_WRITTEN_BYTES {
            return Err(WriteError::TooLong { len: out.len() });
        }
        Ok(out.into_bytes())
    }
}

fn push_attribute(out: &mut String, name: &str, value: &str) -> Result<(), WriteError> {
    out.push(' ');
    xml::push_name(out, name)?;
    out.push_str("=\"");
    xml::push_escaped(out, value)?;
    out.push('"');
    Ok(())
}

fn push_end(out: &mut String, name: &str) {
    out.push_str("</");
    out.push_str(name);
    out.push('>');
}
