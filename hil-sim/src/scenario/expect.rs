//! `[expect]`: what must hold in a run, seen from the bus.

use toml_reader::Value;

use super::values::seconds;
use super::{ScenarioError, Section};
use crate::checker::expect::{CHECKS, Expect};

pub(super) fn expect(table: &Section<'_>) -> Result<Expect, ScenarioError> {
    let span = |value: &Value<'_>| seconds(value, 1e6);
    let expect = Expect {
        answers_within: table.optional("answers_within_s", span)?,
        limits: table.or("limits", false, Value::boolean)?,
        homing: table.or("no_motion_before_reference", false, Value::boolean)?,
        stop_within: table.optional("stop_within_s", span)?,
        frames_min: table.optional("frames_min", Value::count)?,
        utilisation_max: table.optional("utilisation_max", |v| v.number_in(0.0, 1.0))?,
        trips: table.or("trips", Vec::new(), |value| {
            value.one_or_more().iter().map(|item| item.word(&CHECKS)).collect()
        })?,
    };
    table.finish()?;
    Ok(expect)
}
