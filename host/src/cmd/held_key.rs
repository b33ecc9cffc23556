//! A motion that goes on while a key is held.
//!
//! A terminal does not report that a key is let go. It repeats a held key after a pause, and then quickly: a key that has not come
//! again in time was let go.

use std::io::IsTerminal;
use std::time::{Duration as WallSpan, Instant as WallTime};

use console::{Fetched, TypedInput};
use operator::bus::Session;
use operator::bus::failure::BusFailure;
use protocol::Duration;

/// A key repeats after this at the latest: the usual pause before the first repetition.
const FIRST_REPEAT: WallSpan = WallSpan::from_millis(600);
/// And then at least this often.
const REPEAT: WallSpan = WallSpan::from_millis(150);

/// Which way a key means; `None` for a key that moves nothing.
const fn direction(key: u8) -> Option<f64> {
    match key {
        b'+' | b'=' | b'l' | b'k' => Some(1.0),
        b'-' | b'_' | b'h' | b'j' => Some(-1.0),
        _ => None,
    }
}

/// The key that is held, and until when it counts as held.
#[derive(Clone, Copy, Debug, Default)]
struct HeldKey(Option<(f64, WallTime)>);

impl HeldKey {
    /// Takes a key that came at `now`; one that moves nothing lets go and is handed back.
    fn press(&mut self, key: u8, now: WallTime) -> Option<u8> {
        let sign = direction(key);
        let pause = if sign.is_some() && sign == self.sign(now) { REPEAT } else { FIRST_REPEAT };
        self.0 = sign.map(|sign| (sign, now + pause));
        sign.is_none().then_some(key)
    }

    /// The direction that is held at `now`.
    fn sign(&self, now: WallTime) -> Option<f64> {
        self.0.filter(|(_, until)| now < *until).map(|(sign, _)| sign)
    }
}

/// Keys such as the arrows send several bytes, which are no keys of their own.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Sequence {
    #[default]
    Outside,
    /// After the escape that begins it, or is a key.
    Begun,
    Inside,
}

impl Sequence {
    /// Whether the byte belongs to a key that was handed out with the escape.
    const fn takes(&mut self, byte: u8) -> bool {
        let takes = matches!((*self, byte), (Self::Begun, b'[' | b'O') | (Self::Inside, _));
        *self = match (*self, byte) {
            (_, 0x1b) => Self::Begun,
            (Self::Begun, b'[' | b'O') | (Self::Inside, ..=0x3f) => Self::Inside,
            _ => Self::Outside,
        };
        takes && byte != 0x1b
    }
}

/// What the keys ask for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pressed {
    /// To move, up or down: 1 or -1.
    Held(f64),
    /// Another key; nothing is held any more.
    Other(u8),
    Nothing,
    /// There is no input any more.
    Ended,
}

/// The keys of the terminal, one by one.
pub(super) struct Keys {
    typed: TypedInput<u8>,
    held: HeldKey,
    sequence: Sequence,
    /// The terminal is as it was again when this is dropped.
    _raw: RawTerminal,
}

impl Keys {
    pub(super) fn of_terminal() -> Self {
        let raw = RawTerminal::enter();
        let (held, sequence) = (HeldKey::default(), Sequence::default());
        Self { typed: console::typed_bytes(), held, sequence, _raw: raw }
    }

    /// What is held counts as let go.
    pub(super) fn let_go(&mut self) {
        self.held = HeldKey::default();
    }

    /// What the keys ask for at `now`. Each other key is given once.
    pub(super) fn fetch(&mut self, now: WallTime) -> Pressed {
        loop {
            match self.typed.fetch() {
                Fetched::Item(key) if self.sequence.takes(key) => {}
                Fetched::Item(key) => {
                    if let Some(other) = self.held.press(key, now) {
                        return Pressed::Other(other);
                    }
                }
                Fetched::Ended => return Pressed::Ended,
                Fetched::Nothing => return self.held.sign(now).map_or(Pressed::Nothing, Pressed::Held),
            }
        }
    }
}

/// A key is held by the clock of the person; a simulated cell, which would be faster, waits for it.
#[derive(Debug, Default)]
pub(super) struct Pace(Option<(WallTime, f64)>);

impl Pace {
    /// Returns when as much time has passed by the wall as in the cell, where it is `now_s`, since the first call.
    pub(super) fn keep(&mut self, now_s: f64) {
        let (begun, begun_s) = *self.0.get_or_insert((WallTime::now(), now_s));
        let due = begun + WallSpan::from_secs_f64((now_s - begun_s).max(0.0));
        std::thread::sleep(due.saturating_duration_since(WallTime::now()));
    }
}

/// Lets the session listen for a moment while nothing is held, so that it sees Ctrl-C, stops and the bus.
pub(super) fn wait(session: &mut Session) -> Result<(), BusFailure> {
    std::thread::sleep(WallSpan::from_millis(5));
    let until = session.now() + Duration::from_millis(5);
    session.run(until, &mut |_| false).map(drop)
}

/// A terminal that gives each key at once and does not show it. Drop puts the old mode back. Ctrl-C is still a signal.
struct RawTerminal(Option<rustix::termios::Termios>);

impl RawTerminal {
    fn enter() -> Self {
        use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
        let stdin = std::io::stdin();
        if !stdin.is_terminal() {
            return Self(None);
        }
        let Ok(before) = tcgetattr(&stdin) else { return Self(None) };
        let mut raw = before.clone();
        raw.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        match tcsetattr(&stdin, OptionalActions::Now, &raw) {
            Ok(()) => Self(Some(before)),
            Err(_) => Self(None),
        }
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        use rustix::termios::{OptionalActions, tcsetattr};
        if let Some(before) = &self.0 {
            // Nothing is left to do if the terminal is gone.
            let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, before);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: WallSpan = WallSpan::from_millis(1);

    /// A key that was pressed at the returned time.
    fn pressed(key: u8) -> (HeldKey, WallTime) {
        let (mut held, now) = (HeldKey::default(), WallTime::now());
        assert_eq!(held.press(key, now), None);
        (held, now)
    }

    #[test]
    fn key_is_held_through_the_pause_before_it_repeats_and_from_then_on_while_it_repeats() {
        let (mut held, mut now) = pressed(b'+');
        now += FIRST_REPEAT - MS;
        assert_eq!(held.sign(now), Some(1.0));
        for _ in 0..5 {
            assert_eq!(held.press(b'+', now), None);
            now += REPEAT - MS;
            assert_eq!(held.sign(now), Some(1.0));
        }
        assert_eq!(held.sign(now + MS), None);
    }

    #[test]
    fn key_that_does_not_repeat_is_let_go_after_the_first_pause() {
        let (held, now) = pressed(b'-');
        assert_eq!((held.sign(now), held.sign(now + FIRST_REPEAT)), (Some(-1.0), None));
    }

    #[test]
    fn other_key_lets_go_at_once_and_is_handed_back() {
        let (mut held, now) = pressed(b'l');
        assert_eq!(held.press(b's', now + MS), Some(b's'));
        assert_eq!(held.sign(now + MS), None);
    }

    #[test]
    fn opposite_key_turns_the_direction_and_has_a_first_pause_of_its_own() {
        let (mut held, mut now) = pressed(b'l');
        held.press(b'l', now);
        assert_eq!(held.press(b'h', now + MS), None);
        now += REPEAT + MS + MS;
        assert_eq!(held.sign(now), Some(-1.0));
    }

    #[test]
    fn bytes_behind_an_escape_are_no_keys_unless_the_escape_is_a_key_itself() {
        let kept = |bytes: &[u8]| {
            let mut sequence = Sequence::default();
            bytes.iter().copied().filter(|byte| !sequence.takes(*byte)).collect::<Vec<u8>>()
        };
        // Arrow up, delete, F5, F1.
        assert_eq!(kept(b"1\x1b[A2\x1b[3~3\x1b[15~4\x1bOP5"), b"1\x1b2\x1b3\x1b4\x1b5");
        assert_eq!(kept(b"\x1b+\x1b\x1b[As"), b"\x1b+\x1b\x1bs");
    }
}
