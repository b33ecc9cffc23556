//! Values of scenario files that are more than numbers and words.

use protocol::text::candump::Record;
use protocol::{Duration, Frame};
use toml_reader::Value;

use super::{Problem, ScenarioError};

/// A span in seconds, 0 to `max_s`, rounded to a microsecond.
pub(crate) fn seconds(value: &Value<'_>, max_s: f64) -> Result<Duration, ScenarioError> {
    value.number_in(0.0, max_s).map(Duration::from_secs_f64)
}

/// A period in seconds: as [`seconds`], but above zero.
pub(crate) fn period(value: &Value<'_>, max_s: f64) -> Result<Duration, ScenarioError> {
    let span = seconds(value, max_s)?;
    if span.is_zero() {
        return Err(value.error(Problem::Invalid("a period is above zero".to_owned())));
    }
    Ok(span)
}

/// An angle in degrees, 0 to `max_deg`; gives radians.
pub(super) fn degrees(value: &Value<'_>, max_deg: f64) -> Result<f64, ScenarioError> {
    value.number_in(0.0, max_deg).map(f64::to_radians)
}

/// Frames in the form of candump, `0E5#084F0000803E`: a string or a list of strings.
pub(super) fn frames(value: &Value<'_>) -> Result<Vec<Frame>, ScenarioError> {
    let frame = |item: &Value<'_>| parse_frame(item.text()?).map_err(|problem| item.error(problem));
    value.one_or_more().iter().map(frame).collect()
}

/// Reads `0E5#084F0000803E`, the frame field of a candump line.
pub fn parse_frame(text: &str) -> Result<Frame, Problem> {
    let line = format!("(0.0) can0 {text}");
    match Record::parse(line.as_bytes()) {
        Ok(record) => Ok(record.frame),
        Err(_) => Err(Problem::Invalid(format!("'{text}' is no frame; write it as 0E5#084F0000803E"))),
    }
}
