//! Events on a bus, for people: repeated events are one line with a count, and they do not push away events that
//! stopped something.

use std::collections::VecDeque;

use protocol::{Duration, Instant};
use serde::Serialize;

use crate::log::watch::{LogEvent, Severity};

const KEPT: usize = 200;
/// The same within this time is a repetition. A jog is ordered twenty times a second.
const REPEATS_WITHIN: Duration = Duration::from_secs(1);

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventView {
    /// Number of the event, from 1.
    pub number: u64,
    /// Time of the session, s.
    pub t_s: f64,
    /// `info`, `warning` or `error`.
    pub severity: Severity,
    pub source: String,
    pub text: String,
}

/// An event that comes again.
struct Series {
    first: LogEvent,
    last_at: Instant,
    more: u32,
}

impl Series {
    fn has(&self, event: &LogEvent) -> bool {
        (&self.first.source, &self.first.text) == (&event.source, &event.text)
    }

    fn is_over(&self, now: Instant) -> bool {
        now.saturating_since(self.last_at) >= REPEATS_WITHIN
    }
}

/// The events, oldest first.
#[derive(Default)]
pub(super) struct Events {
    kept: VecDeque<EventView>,
    number: u64,
    series: Vec<Series>,
}

impl Events {
    /// Takes an event; a repetition is counted only.
    pub(super) fn add(&mut self, event: LogEvent) {
        self.advance_to(event.at);
        if let Some(series) = self.series.iter_mut().find(|series| series.has(&event)) {
            (series.last_at, series.more) = (event.at, series.more + 1);
            return;
        }
        self.put(event.clone());
        self.series.push(Series { last_at: event.at, first: event, more: 0 });
    }

    /// Time passes: reports the count of a series that has ended.
    pub(super) fn advance_to(&mut self, now: Instant) {
        while let Some(over) = self.series.iter().position(|series| series.is_over(now)) {
            let Series { first, last_at, more } = self.series.remove(over);
            if more > 0 {
                let span_s = last_at.saturating_since(first.at).as_secs_f64();
                let text = format!("{}: {more} more in {span_s:.1} s", first.text);
                self.put(LogEvent { at: last_at, text, ..first });
            }
        }
    }

    fn put(&mut self, event: LogEvent) {
        self.number += 1;
        if self.kept.len() == KEPT {
            let least = self.kept.iter().position(|event| event.severity == Severity::Info);
            self.kept.remove(least.unwrap_or_default());
        }
        let LogEvent { at, severity, source, text } = event;
        let (number, t_s) = (self.number, at.as_secs_f64());
        self.kept.push_back(EventView { number, t_s, severity, source, text });
    }

    /// Those with a number above `number`.
    pub(super) fn after(&self, number: u64) -> Vec<EventView> {
        self.kept.iter().filter(|event| event.number > number).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repetitions_are_counted_and_a_stop_outlasts_a_flood() {
        let event = |at_ms: u64, severity, text: &str| LogEvent {
            at: Instant::from_micros(1_000 * at_ms),
            severity,
            source: "host 126".to_owned(),
            text: text.to_owned(),
        };
        let mut events = Events::default();
        events.add(event(0, Severity::Warning, "stop message"));
        for k in 0..41 {
            events.add(event(10 + 50 * k, Severity::Info, "orders: jog"));
        }
        events.advance_to(Instant::from_micros(10_000_000));
        let texts = |events: &Events| events.after(0).into_iter().map(|event| event.text).collect::<Vec<_>>();
        assert_eq!(texts(&events), ["stop message", "orders: jog", "orders: jog: 40 more in 2.0 s"]);
        for k in 0..2 * KEPT as u64 {
            events.add(event(20_000 + k, Severity::Info, &format!("note {k}")));
        }
        let texts = texts(&events);
        assert_eq!((texts.len(), texts[0].as_str()), (KEPT, "stop message"));
        assert_eq!(texts.last().unwrap(), &format!("note {}", 2 * KEPT - 1));
    }
}
