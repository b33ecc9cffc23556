//! The terminal: its size, its keys, and a screen of its own that is given back at the end.

use std::io::{IsTerminal, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};

use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    /// End the program.
    Quit,
    /// Halt all drives.
    Stop,
    /// Hold the picture, or go on.
    Pause,
    /// Show events, or not.
    Events,
    /// Twice the period, or half of it.
    Slower,
    Faster,
}

impl Key {
    fn of(byte: u8) -> Option<Self> {
        Some(match byte {
            b'q' | b'Q' => Self::Quit,
            b's' | b'S' => Self::Stop,
            b' ' | b'p' => Self::Pause,
            b'e' => Self::Events,
            b'-' => Self::Slower,
            b'+' | b'=' => Self::Faster,
            _ => return None,
        })
    }
}

/// The keys, told on the last line; the first text that is as narrow as the terminal.
pub(super) const HINTS: [&str; 3] = [
    "q end   s STOP all drives   space hold   e events   + - faster, slower   Ctrl-C end",
    "q end  s STOP  space hold  e events  + - faster, slower",
    "q end  s STOP  space hold",
];

/// Keys from the bytes of a terminal. Those of arrows and function keys are told apart: F4 ends with the letter of the stop.
#[derive(Debug, Default)]
struct Bytes {
    sequence: Sequence,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Sequence {
    #[default]
    None,
    /// After ESC.
    Escape,
    /// After `ESC O`: one byte follows.
    Single,
    /// After `ESC [`: bytes follow up to a letter or `~`.
    Control,
}

impl Bytes {
    fn take(&mut self, byte: u8) -> Option<Key> {
        let before = std::mem::take(&mut self.sequence);
        match (before, byte) {
            (_, 0x1b) => self.sequence = Sequence::Escape,
            (Sequence::Escape, b'O') => self.sequence = Sequence::Single,
            (Sequence::Escape, b'[') => self.sequence = Sequence::Control,
            (Sequence::Single, _) => {}
            // F1 to F4 of a Linux console: `ESC [ [ A`.
            (Sequence::Control, b'[') => self.sequence = Sequence::Single,
            (Sequence::Control, byte) if !(0x40..=0x7e).contains(&byte) => self.sequence = Sequence::Control,
            (Sequence::Control, _) => {}
            // After a lone ESC too: a stop is never lost.
            (Sequence::None | Sequence::Escape, byte) => return Key::of(byte),
        }
        None
    }
}

/// A terminal in use: keys come at once and are not shown; the picture has a screen of its own. Dropping it gives back what was.
pub(super) struct Terminal {
    before: Option<Termios>,
    keys: Option<Receiver<Key>>,
}

impl Terminal {
    /// Takes the terminal over. `stop` and `quit` are set as soon as their keys are pressed, `pressed` with every key.
    pub(super) fn take(stop: &Arc<AtomicBool>, quit: &Arc<AtomicBool>, pressed: &Arc<AtomicBool>) -> Self {
        let stdin = std::io::stdin();
        let before = if stdin.is_terminal() { tcgetattr(&stdin).ok() } else { None };
        let keys = before.as_ref().and_then(|before| {
            let mut modes = before.clone();
            // Ctrl-C stays a signal.
            modes.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
            tcsetattr(&stdin, OptionalActions::Now, &modes).ok()?;
            let (told, keys) = channel();
            let (stop, quit, pressed) = (Arc::clone(stop), Arc::clone(quit), Arc::clone(pressed));
            // It waits for a key and ends with the program.
            std::thread::spawn(move || {
                let mut bytes = Bytes::default();
                for byte in std::io::stdin().lock().bytes().map_while(Result::ok) {
                    let Some(key) = bytes.take(byte) else { continue };
                    match key {
                        Key::Quit => quit.store(true, Ordering::Relaxed),
                        Key::Stop => stop.store(true, Ordering::Relaxed),
                        _ => {}
                    }
                    if told.send(key).is_err() {
                        break;
                    }
                    pressed.store(true, Ordering::Relaxed);
                }
            });
            Some(keys)
        });
        console::text!("\x1b[?1049h\x1b[?25l");
        Self { before, keys }
    }

    /// Keys pressed since.
    pub(super) fn keys(&self) -> Vec<Key> {
        self.keys.as_ref().map(|keys| keys.try_iter().collect()).unwrap_or_default()
    }

    /// Whether keys can be pressed.
    pub(super) const fn has_keys(&self) -> bool {
        self.keys.is_some()
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        console::text!("\x1b[?25h\x1b[?1049l");
        if let Some(before) = &self.before {
            let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, before);
        }
    }
}

/// Columns and rows; 80 × 24 where the terminal does not tell.
pub(super) fn size() -> (usize, usize) {
    match tcgetwinsize(std::io::stdout()) {
        Ok(size) if size.ws_col > 0 && size.ws_row > 0 => (size.ws_col.into(), size.ws_row.into()),
        _ => (80, 24),
    }
}

/// Colours are wanted: the terminal has them, and nobody has asked for none (`NO_COLOR`).
pub(super) fn has_colours() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !set("NO_COLOR") && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Writes a picture over the one before.
///
/// # Errors
/// Standard output's.
pub(super) fn show(lines: &[String]) -> std::io::Result<()> {
    // Each line ends with "clear to the end of the line", the last one without a line feed, which would scroll.
    let text = lines.join("\x1b[K\r\n");
    let mut out = std::io::stdout().lock();
    write!(out, "\x1b[H{text}\x1b[K\x1b[J")?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(bytes: &[u8]) -> Vec<Key> {
        let mut reader = Bytes::default();
        bytes.iter().filter_map(|byte| reader.take(*byte)).collect()
    }

    #[test]
    fn arrows_and_function_keys_are_no_letters() {
        // Up, F2, F4, F4 of a Linux console, F5, Ctrl-arrow: none ends the program or stops a drive.
        let sequences: [&[u8]; 6] = [b"\x1b[A", b"\x1bOQ", b"\x1bOS", b"\x1b[[D", b"\x1b[15~", b"\x1b[1;5D"];
        for sequence in sequences {
            assert_eq!(keys(sequence), [], "{sequence:?}");
            assert_eq!(keys(&[sequence, b"s"].concat()), [Key::Stop], "{sequence:?}");
        }
    }

    #[test]
    fn a_stop_behind_a_lone_escape_is_a_stop() {
        assert_eq!(keys(b"\x1bs"), [Key::Stop]);
        assert_eq!(keys(b"\x1b\x1bq e+-"), [Key::Quit, Key::Pause, Key::Events, Key::Faster, Key::Slower]);
    }
}
