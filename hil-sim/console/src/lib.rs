//! Output lines that never end a program, input that nobody waits for, and signals that ask a program to end in order.
//!
//! The standard library's `println!` panics when the reader leaves (`cubectl … | head`) or the disk is full. A program
//! that moves an arm must not end that way. In this package
//!
//! * a closed reader is not an error: its output is dropped;
//! * any other failure to write standard output is remembered. The program asks for it with [`lost`] at its end and exits with
//!   an error, so that a truncated file is not taken for a complete one;
//! * failures to write standard error are ignored.
//!
//! # Map
//!
//! | item | writes to |
//! |---|---|
//! | [`line!`], [`text!`] | standard output, with and without an end of line |
//! | [`note!`] | standard error, a line |
//! | [`has_begun`] | nothing: whether standard output holds anything |
//! | [`lost`] | nothing: reports why standard output is incomplete |
//! | [`mod@interrupt`] | nothing: reports that Ctrl-C or another request to end has come |
//! | [`typed_bytes`], [`typed_lines`], [`lines_of`] | nothing: standard input or a file, without waiting for it |

pub mod interrupt;
mod typed;

use std::fmt::Arguments;
use std::io::{self, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

pub use typed::{Fetched, TypedInput, lines_of, typed_bytes, typed_lines};

static BEGUN: AtomicBool = AtomicBool::new(false);
static LOST: Mutex<Option<String>> = Mutex::new(None);

/// Writes a line to standard output; arguments as those of `println!`.
#[macro_export]
macro_rules! line {
    () => { $crate::output(::std::format_args!("\n")) };
    ($($text:tt)*) => { $crate::output(::std::format_args!("{}\n", ::std::format_args!($($text)*))) };
}

/// Writes to standard output without ending the line; arguments as those of `print!`.
#[macro_export]
macro_rules! text {
    ($($text:tt)*) => { $crate::output(::std::format_args!($($text)*)) };
}

/// Writes a line to standard error; arguments as those of `eprintln!`.
#[macro_export]
macro_rules! note {
    () => { $crate::message(::std::format_args!("\n")) };
    ($($text:tt)*) => { $crate::message(::std::format_args!("{}\n", ::std::format_args!($($text)*))) };
}

/// Writes to standard error without ending the line; arguments as those of `eprint!`.
#[macro_export]
macro_rules! note_text {
    ($($text:tt)*) => { $crate::message(::std::format_args!($($text)*)) };
}

/// Writes to standard output: what [`line!`] and [`text!`] do.
pub fn output(text: Arguments<'_>) {
    BEGUN.store(true, Ordering::Relaxed);
    let mut out = io::stdout().lock();
    if let Err(error) = out.write_fmt(text).and_then(|()| out.flush()) {
        keep(&error);
    }
}

/// Writes to standard error: what [`note!`] and [`note_text!`] do.
pub fn message(text: Arguments<'_>) {
    // In one piece, so that lines of several programs do not mix.
    let _ = io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Whether anything was written to standard output.
#[must_use]
pub fn has_begun() -> bool {
    BEGUN.load(Ordering::Relaxed)
}

/// Why standard output is not whole, if it is not: the first error since the program began. A reader that left is none.
#[must_use]
pub fn lost() -> Option<String> {
    LOST.lock().ok()?.clone()
}

fn keep(error: &io::Error) {
    if error.kind() == io::ErrorKind::BrokenPipe {
        return;
    }
    if let Ok(mut lost) = LOST.lock() {
        lost.get_or_insert_with(|| error.to_string());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_error_is_kept_and_a_reader_that_left_is_none() {
        keep(&io::ErrorKind::BrokenPipe.into());
        assert_eq!(lost(), None);
        keep(&io::Error::other("full"));
        keep(&io::Error::other("fuller"));
        assert_eq!(lost().as_deref(), Some("full"));
    }
}
