//! Values of options: numbers with a range, numbers separated by commas, node-IDs.

use std::ops::RangeInclusive;

use protocol::cyphal::id::NodeId;

fn number(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    value.ok_or_else(|| format!("\"{text}\" is not a number"))
}

/// A number above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    number(text).ok().filter(|value| *value > 0.0).ok_or("must be a number above 0".to_owned())
}

/// A number above zero, at most one.
pub(crate) fn share(text: &str) -> Result<f64, String> {
    positive(text).ok().filter(|value| *value <= 1.0).ok_or("must be above 0 and at most 1".to_owned())
}

/// A parser of numbers in `range`.
pub fn within(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let refused =
            || format!("must be from {} to {} {unit}", range.start(), range.end()).trim_end().to_owned();
        number(text).ok().filter(|value| range.contains(value)).ok_or_else(refused)
    }
}

/// A parser of numbers above zero, at most `most`.
pub(crate) fn at_most(
    most: f64,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let refused = || format!("must be above 0 and at most {most} {unit}");
        positive(text).ok().filter(|value| *value <= most).ok_or_else(refused)
    }
}

/// `N` numbers separated by commas.
///
/// # Errors
/// A part is not a number, or there are not `N`.
pub(crate) fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Vec<f64> = text.split(',').map(number).collect::<Result<_, _>>()?;
    let count = parts.len();
    parts.try_into().map_err(|_| format!("expected {N} numbers separated by commas, got {count}"))
}

pub(crate) fn node_id(text: &str) -> Result<NodeId, String> {
    let id = text.parse::<u8>().ok().and_then(|id| NodeId::new(id).ok());
    id.ok_or("must be a number from 0 to 127".to_owned())
}
