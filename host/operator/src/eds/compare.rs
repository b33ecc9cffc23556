//! A sheet beside a node, and beside what the controller reads and writes of it.

use std::collections::BTreeMap;
use std::fmt;

use firmware::groups::cia402::{Need, Use};
use protocol::canopen::client::Failure;
use protocol::canopen::{NodeId, Object};

use super::{Eds, Entry};

/// How a sheet, a node and the controller differ. Numbers are those of the node, the sheet and the controller.
#[derive(Clone, Debug, PartialEq)]
pub enum Difference {
    /// Object 1018 names another device.
    Identity { what: &'static str, node: u32, sheet: u32 },
    /// The controller needs an object that the node refuses.
    Refused { failure: Failure, in_sheet: bool },
    /// The controller needs an object that only the node has.
    NotInSheet,
    /// Lengths, bytes.
    Bytes { node: usize, sheet: Option<usize>, needed: Option<usize> },
    /// The controller writes what can only be read by the sheet.
    ReadOnly,
    /// The controller writes a value outside the limits of the sheet.
    Limits { written: i64, low: Option<i64>, high: Option<i64> },
    /// It stands in process data of the controller, and may not by the sheet.
    NotMappable,
    /// The value of a DCF is not the one of the node.
    Value { node: i64, sheet: i64 },
}

/// A difference and where it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    pub object: Object,
    /// Its name in the sheet; empty if it has none.
    pub name: String,
    /// What differs.
    pub difference: Difference,
}

impl Difference {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> &'static str {
        match self {
            Self::Identity { what: "revision", .. } => {
                "take the sheet of this revision; the maker's notes say what changed"
            }
            Self::Identity { .. } => "take the sheet of this device, or check the number of the node",
            Self::Refused { in_sheet: true, .. } => {
                "the sheet is of other firmware: take the one of this revision, or update the node"
            }
            Self::Refused { .. } => {
                "this node cannot be driven so: look for another `mode` of [joint.cia402]"
            }
            Self::NotInSheet => "the sheet is of other firmware; the controller goes by the node",
            Self::Bytes { needed: Some(_), .. } => "the controller cannot use this object: report the device",
            Self::Bytes { .. } => "take the sheet of this revision",
            Self::ReadOnly => "the node decides: `cubectl home` names the object if it refuses",
            Self::Limits { .. } => {
                "change the limits of the joint or the period, or the settings of the servo"
            }
            Self::NotMappable => "the node decides: `cubectl home` names the map if it refuses",
            Self::Value { .. } => "write the value with the maker's tool and store it, or correct the sheet",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let space = if self.name.is_empty() { "" } else { " " };
        write!(f, "{}{space}{}: ", self.object, self.name)?;
        match &self.difference {
            Difference::Identity { what, node, sheet } => {
                write!(f, "the {what} of the node is {node:#010x}, that of the sheet {sheet:#010x}")
            }
            Difference::Refused { failure, in_sheet } => {
                let where_else =
                    if *in_sheet { "the sheet has it" } else { "the sheet does not have it either" };
                write!(f, "the controller needs it; {failure}; {where_else}")
            }
            Difference::NotInSheet => {
                f.write_str("the controller needs it; the node has it, the sheet does not")
            }
            Difference::Bytes { node, sheet, needed } => {
                write!(f, "the node gives {node} bytes")?;
                if let Some(sheet) = sheet {
                    write!(f, ", the sheet says {sheet}")?;
                }
                if let Some(needed) = needed {
                    write!(f, ", the controller uses {needed}")?;
                }
                Ok(())
            }
            Difference::ReadOnly => f.write_str("the controller writes it; by the sheet it can only be read"),
            Difference::Limits { written, low, high } => {
                let end = |end: &Option<i64>| end.map_or("any".to_owned(), |value| value.to_string());
                write!(f, "the controller writes {written}, the sheet allows {} to {}", end(low), end(high))
            }
            Difference::NotMappable => {
                f.write_str("it is in process data of the controller; by the sheet it cannot be")
            }
            Difference::Value { node, sheet } => write!(f, "the node holds {node}, the sheet {sheet}"),
        }
    }
}

/// What was compared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Objects that were read.
    pub read: usize,
    /// What differs.
    pub findings: Vec<Finding>,
}

fn value_of(bytes: &[u8], is_signed: bool) -> Option<i64> {
    let negative = is_signed && bytes.last().is_some_and(|byte| byte & 0x80 != 0);
    let mut all = if negative { [0xFF; 8] } else { [0; 8] };
    all.get_mut(..bytes.len())?.copy_from_slice(bytes);
    Some(i64::from_le_bytes(all))
}

/// What the controller wants of one object.
#[derive(Clone, Debug, Default)]
struct Wanted {
    bytes: Option<usize>,
    written: Vec<u32>,
    is_mapped: bool,
    may_be_absent: bool,
}

/// Compares. `read` asks the node for an object.
pub fn compare<E>(
    eds: &Eds,
    node: NodeId,
    needs: impl Iterator<Item = Need>,
    read: &mut impl FnMut(Object) -> Result<Result<Vec<u8>, Failure>, E>,
) -> Result<Report, E> {
    let mut report = Report::default();
    let mut wanted: BTreeMap<Object, Wanted> = BTreeMap::new();
    for need in needs {
        let own = wanted.entry(need.object).or_insert(Wanted { may_be_absent: true, ..Wanted::default() });
        own.bytes = Some(need.bytes.into());
        own.may_be_absent &= need.may_be_absent;
        match need.purpose {
            Use::Read => {}
            Use::Written(value) => own.written.push(value),
            Use::Mapped => own.is_mapped = true,
        }
    }
    let configured = eds.entries.iter().filter(|(_, entry)| entry.configured.is_some());
    for (object, _) in configured {
        wanted.entry(*object).or_insert(Wanted { may_be_absent: true, ..Wanted::default() });
    }
    let identity = eds.identity;
    for (sub, what, sheet) in
        [(1, "vendor", identity.vendor), (2, "product", identity.product), (3, "revision", identity.revision)]
    {
        let (object, Some(sheet)) = (Object::new(0x1018, sub), sheet) else { continue };
        report.read += 1;
        let found = read(object)?.ok().and_then(|bytes| value_of(&bytes, false));
        let found = found.map(|value| value as u32);
        if let Some(found) = found.filter(|found| *found != sheet) {
            let difference = Difference::Identity { what, node: found, sheet };
            report.findings.push(Finding { object, name: String::new(), difference });
        }
    }
    for (object, wanted) in wanted {
        report.read += 1;
        let entry = eds.entries.get(&object);
        let found = read(object)?;
        let name = entry.map(|entry| entry.name.clone()).unwrap_or_default();
        report.findings.extend(differences(&wanted, entry, node, found).map(|difference| Finding {
            object,
            name: name.clone(),
            difference,
        }));
    }
    Ok(report)
}

fn differences(
    wanted: &Wanted,
    entry: Option<&Entry>,
    node: NodeId,
    found: Result<Vec<u8>, Failure>,
) -> impl Iterator<Item = Difference> {
    let mut all = Vec::new();
    let bytes = match found {
        Ok(bytes) => bytes,
        // Objects without which a servo is fine, and which the sheet leaves out, too.
        Err(Failure::Aborted(_)) if wanted.may_be_absent && entry.is_none() => return all.into_iter(),
        Err(failure) => {
            all.push(Difference::Refused { failure, in_sheet: entry.is_some() });
            return all.into_iter();
        }
    };
    let needed = wanted.bytes.filter(|needed| *needed != bytes.len());
    let sheet = entry.and_then(Entry::bytes).filter(|sheet| *sheet != bytes.len());
    if needed.is_some() || sheet.is_some() {
        all.push(Difference::Bytes { node: bytes.len(), sheet, needed });
    }
    let Some(entry) = entry else {
        all.push(Difference::NotInSheet);
        return all.into_iter();
    };
    if !wanted.written.is_empty() && !entry.is_writable {
        all.push(Difference::ReadOnly);
    }
    let (low, high) = (entry.low.map(|low| low.of(node)), entry.high.map(|high| high.of(node)));
    let sized = |value: u32| value_of(value.to_le_bytes().get(..bytes.len().min(4))?, entry.is_signed());
    let outside = wanted
        .written
        .iter()
        .filter_map(|value| sized(*value))
        .find(|value| low.is_some_and(|low| *value < low) || high.is_some_and(|high| *value > high));
    if let Some(written) = outside {
        all.push(Difference::Limits { written, low, high });
    }
    if wanted.is_mapped && !entry.is_mappable {
        all.push(Difference::NotMappable);
    }
    let held = value_of(&bytes, entry.is_signed()).filter(|_| sheet.is_none());
    if let (Some(held), Some(sheet)) = (held, entry.configured.map(|value| value.of(node)))
        && held != sheet
    {
        all.push(Difference::Value { node: held, sheet });
    }
    all.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::canopen::sdo::AbortCode;

    const NO_OBJECT: Failure = Failure::Aborted(AbortCode::NO_OBJECT);

    fn need(index: u16, bytes: u8, purpose: Use) -> Need {
        Need { object: Object::new(index, 0), bytes, purpose, may_be_absent: index == 0x6091 }
    }

    /// Differences of a sheet with one object beside a node that gives `found` and a controller with one need.
    fn found(sheet: &str, need: Need, found: Result<Vec<u8>, Failure>) -> Vec<Difference> {
        let eds = Eds::read(&format!("[1000]\nDataType=7\nAccessType=ro\n{sheet}")).unwrap();
        let mut read = move |_: Object| Ok::<_, ()>(found.clone());
        let report = compare(&eds, NodeId::new(3).unwrap(), [need].into_iter(), &mut read).unwrap();
        assert!(report.findings.iter().all(|finding| !finding.to_string().is_empty()));
        report.findings.into_iter().map(|finding| finding.difference).collect()
    }

    #[test]
    fn each_kind_of_difference_is_found_and_what_agrees_is_none() {
        let sheet = "[6065]\nDataType=7\nAccessType=rw\nLowLimit=1\nHighLimit=0x1000\nParameterValue=$NODEID+1\nPDOMapping=1\n";
        let read = || need(0x6065, 4, Use::Read);
        let four = || Ok(vec![4, 0, 0, 0]);
        assert_eq!(found(sheet, read(), four()), []);
        assert_eq!(found(sheet, need(0x6065, 4, Use::Written(0x1000)), four()), []);
        assert_eq!(found(sheet, need(0x6065, 4, Use::Mapped), four()), []);
        assert_eq!(found(sheet, read(), Ok(vec![5, 0, 0, 0])), [Difference::Value { node: 5, sheet: 4 }]);
        let written = need(0x6065, 4, Use::Written(0x1001));
        let limits = Difference::Limits { written: 0x1001, low: Some(1), high: Some(0x1000) };
        assert_eq!(found(sheet, written, four()), [limits]);
        let bytes = Difference::Bytes { node: 2, sheet: Some(4), needed: Some(4) };
        assert_eq!(found(sheet, read(), Ok(vec![4, 0])), [bytes]);
        assert_eq!(
            found(sheet, read(), Err(NO_OBJECT)),
            [Difference::Refused { failure: NO_OBJECT, in_sheet: true }]
        );
        let fixed = "[6065]\nDataType=7\nAccessType=ro\n";
        assert_eq!(found(fixed, need(0x6065, 4, Use::Written(4)), four()), [Difference::ReadOnly]);
        assert_eq!(found(fixed, need(0x6065, 4, Use::Mapped), four()), [Difference::NotMappable]);
        assert_eq!(found("", read(), four()), [Difference::NotInSheet]);
        assert_eq!(
            found("", read(), Err(NO_OBJECT)),
            [Difference::Refused { failure: NO_OBJECT, in_sheet: false }]
        );
        assert_eq!(found("", need(0x6091, 4, Use::Read), Err(NO_OBJECT)), [], "a servo without it is fine");
        assert_eq!(
            found("", need(0x6091, 4, Use::Read), Err(Failure::TimeOut)),
            [Difference::Refused { failure: Failure::TimeOut, in_sheet: false }]
        );
    }

    #[test]
    fn a_negative_value_is_compared_by_its_type() {
        let sheet = "[60C2]\nDataType=2\nAccessType=rw\nLowLimit=-6\nHighLimit=0\n";
        assert_eq!(found(sheet, need(0x60C2, 1, Use::Written(0xFD)), Ok(vec![0xFD])), []);
        let limits = Difference::Limits { written: -7, low: Some(-6), high: Some(0) };
        assert_eq!(found(sheet, need(0x60C2, 1, Use::Written(0xF9)), Ok(vec![0xFD])), [limits]);
    }

    #[test]
    fn another_device_is_named_by_what_differs() {
        let eds = Eds::read(
            "[DeviceInfo]\nVendorNumber=1\nProductNumber=2\nRevisionNumber=3\n[1000]\nDataType=7\nAccessType=ro\n",
        );
        let mut read = |object: Object| Ok::<_, ()>(Ok(u32::from(object.sub % 3 + 1).to_le_bytes().to_vec()));
        let report = compare(&eds.unwrap(), NodeId::new(3).unwrap(), [].into_iter(), &mut read).unwrap();
        let what: Vec<String> = report.findings.iter().map(ToString::to_string).collect();
        assert_eq!(
            what,
            [
                "1018:01: the vendor of the node is 0x00000002, that of the sheet 0x00000001",
                "1018:02: the product of the node is 0x00000003, that of the sheet 0x00000002",
                "1018:03: the revision of the node is 0x00000001, that of the sheet 0x00000003",
            ]
        );
    }
}
