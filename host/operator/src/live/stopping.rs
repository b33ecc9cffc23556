//! Who obeys a stop: joints are seen to stand by their angles, not by what was ordered.

use std::collections::BTreeMap;

use protocol::{Duration, Instant};
use serde::Serialize;

use super::age::Tone;

/// An angle that changes by more is a motion, rad.
const MOVES_RAD: f64 = 1e-3;
/// A joint whose angle has not changed for this long stands.
const STANDS_AFTER: Duration = Duration::from_millis(100);
/// An arm that obeys stands by then.
const OBEYED_WITHIN: Duration = Duration::from_secs(1);
/// A joint that still moves by then does not obey.
pub const JUDGED_AFTER: Duration = Duration::from_secs(3);
/// A stop that is sent several times is one.
const ONE_STOP: Duration = Duration::from_secs(1);

/// A stop and who obeys it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StopView {
    /// Time of the stop in the session, s.
    pub t_s: f64,
    /// Which joints stand since when, which move, which are not heard.
    pub text: String,
    /// How it is shown.
    pub tone: Tone,
    /// Numbers of the joints that move.
    pub moving: Vec<u8>,
    /// All joints stand, or those that move have had their time.
    pub settled: bool,
}

/// Since when the angle of a joint has been the same.
#[derive(Clone, Copy, Debug)]
struct Angle {
    heard: Instant,
    q_rad: f64,
    since: Instant,
}

/// The last stop, and the angles of the joints by their numbers.
#[derive(Debug, Default)]
pub(super) struct Stopping {
    angles: BTreeMap<u8, Angle>,
    stop: Option<(Instant, String)>,
    /// The controller, or without one a drive, has reported that it is stopped.
    took: bool,
}

impl Stopping {
    pub(super) fn angle(&mut self, number: u8, at: Instant, q_rad: f64) {
        let angle = self.angles.entry(number).or_insert(Angle { heard: at, q_rad, since: at });
        angle.heard = at;
        if (angle.q_rad - q_rad).abs() > MOVES_RAD {
            (angle.q_rad, angle.since) = (q_rad, at);
        }
    }

    /// A stop was sent by `by`; a halt of the drives has no sender.
    pub(super) fn stop(&mut self, at: Instant, by: Option<&str>) {
        let again = self.stop.as_ref().is_some_and(|(first, _)| at.saturating_since(*first) < ONE_STOP);
        match (&mut self.stop, by) {
            (Some((_, known)), Some(by)) if again => by.clone_into(known),
            (Some(_), None) if again => {}
            _ => {
                (self.stop, self.took) = (Some((at, by.unwrap_or("a halt of the drives").to_owned())), false);
            }
        }
    }

    /// Something is stopped, or is so no more: then there is nothing to be shown.
    pub(super) fn report(&mut self, is_stopped: bool) {
        self.took |= is_stopped;
        if self.took && !is_stopped {
            self.stop = None;
        }
    }

    pub(super) fn view(&self, now: Instant) -> Option<StopView> {
        let (at, by) = self.stop.as_ref()?;
        let (mut stand, mut moving, mut silent, mut after) =
            (Vec::new(), Vec::new(), Vec::new(), Duration::ZERO);
        for (number, angle) in &self.angles {
            if angle.heard <= *at {
                silent.push(*number);
            } else if angle.heard.saturating_since(angle.since.max(*at)) >= STANDS_AFTER {
                stand.push(*number);
                after = after.max(angle.since.saturating_since(*at));
            } else {
                moving.push(*number);
            }
        }
        let age = now.saturating_since(*at);
        let all_stand = !stand.is_empty() && moving.is_empty() && silent.is_empty();
        let mut parts = Vec::new();
        if !stand.is_empty() {
            parts.push(format!("{} after {:.2} s", joints(&stand, "stands", "stand"), after.as_secs_f64()));
        }
        if !moving.is_empty() {
            let next = if age > OBEYED_WITHIN { ": switch the motor supply off" } else { "" };
            parts.push(format!(
                "{} after {:.1} s{next}",
                joints(&moving, "moves", "move"),
                age.as_secs_f64()
            ));
        }
        if !silent.is_empty() {
            parts.push(format!(
                "{} since the stop: look at the arm",
                joints(&silent, "is not heard", "are not heard")
            ));
        }
        if parts.is_empty() {
            parts.push("no joint is heard: look at the arm".to_owned());
        }
        let tone = match age {
            _ if all_stand => Tone::Good,
            age if age < OBEYED_WITHIN => Tone::Warn,
            _ => Tone::Bad,
        };
        let text = format!("stopped by {by}: {}", parts.join("; "));
        let settled = all_stand || age >= JUDGED_AFTER;
        Some(StopView { t_s: at.as_secs_f64(), text, tone, moving, settled })
    }
}

fn joints(numbers: &[u8], one: &str, several: &str) -> String {
    let list: Vec<String> = numbers.iter().map(u8::to_string).collect();
    match numbers {
        [_] => format!("joint {} {one}", list.join(", ")),
        _ => format!("joints {} {several}", list.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stands_who_moves_and_who_is_not_heard_is_said_until_the_stop_is_over() {
        let ms = |ms: u64| Instant::from_micros(1_000 * ms);
        let mut stopping = Stopping::default();
        for joint in 1..=3 {
            stopping.angle(joint, ms(0), 0.0);
        }
        assert_eq!(stopping.view(ms(5)), None);
        stopping.stop(ms(10), None);
        stopping.stop(ms(12), Some("this program"));
        stopping.stop(ms(15), None);
        for k in 0..60 {
            stopping.angle(1, ms(20 + 20 * k), if k < 8 { 0.01 * k as f64 } else { 0.07 });
            stopping.angle(2, ms(20 + 20 * k), 0.01 * k as f64);
        }
        let view = stopping.view(ms(1_220)).unwrap();
        assert_eq!(
            view.text,
            "stopped by this program: joint 1 stands after 0.15 s; joint 2 moves after 1.2 s: switch the motor supply off; joint 3 \
             is not heard since the stop: look at the arm"
        );
        assert_eq!((view.tone, view.settled), (Tone::Bad, false));
        for joint in 1..=3 {
            stopping.angle(joint, ms(1_300), 1.0);
            stopping.angle(joint, ms(1_500), 1.0);
        }
        let view = stopping.view(ms(1_500)).unwrap();
        assert_eq!(
            (view.text.as_str(), view.tone),
            ("stopped by this program: joints 1, 2, 3 stand after 1.29 s", Tone::Good)
        );
        stopping.report(false);
        assert!(stopping.view(ms(1_600)).is_some(), "a report from before the stop is taken");
        stopping.report(true);
        stopping.report(false);
        assert_eq!(stopping.view(ms(1_700)), None, "the fault was cleared");
    }
}
