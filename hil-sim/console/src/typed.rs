//! Input that a thread of its own reads, so that whoever moves something never waits for a person.

use std::io::Read;
use std::time::Duration;

use rtrb::{Consumer, PushError, RingBuffer};

/// Items that wait to be fetched. A person types fewer; a file at standard input waits.
const WAITING_MAX: usize = 256;
/// Pause before a full queue is tried again.
const FULL_PAUSE: Duration = Duration::from_millis(5);

/// What was read and not fetched yet.
///
/// The queue is wait-free. The reader of a channel of the standard library spins while the writer is in the middle of a
/// write. If it has a real-time priority and has interrupted the writer on the same core, it spins until the system takes
/// the core away, on Linux after 0.95 s.
pub struct TypedInput<T>(Consumer<T>);

impl<T: Send + 'static> TypedInput<T> {
    /// Opens `source` and reads all of it in a thread of its own.
    fn new<S: Iterator<Item = T>>(source: impl FnOnce() -> S + Send + 'static) -> Self {
        let (mut producer, consumer) = RingBuffer::new(WAITING_MAX);
        std::thread::spawn(move || {
            for mut item in source() {
                while let Err(PushError::Full(again)) = producer.push(item) {
                    if producer.is_abandoned() {
                        return;
                    }
                    std::thread::sleep(FULL_PAUSE);
                    item = again;
                }
            }
        });
        Self(consumer)
    }

    /// The next item, if there is one now.
    pub fn fetch(&mut self) -> Fetched<T> {
        // Asked first: what the thread pushed before it ended is in the queue then.
        let ended = self.0.is_abandoned();
        match self.0.pop() {
            Ok(item) => Fetched::Item(item),
            Err(_) if ended => Fetched::Ended,
            Err(_) => Fetched::Nothing,
        }
    }
}

/// Result of [`TypedInput::fetch`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fetched<T> {
    /// The next one.
    Item(T),
    /// None now.
    Nothing,
    /// None any more.
    Ended,
}

/// The bytes of standard input. They end with it, or with its first error.
#[must_use]
pub fn typed_bytes() -> TypedInput<u8> {
    TypedInput::new(|| std::io::stdin().lock().bytes().map_while(Result::ok))
}

/// The lines of standard input without their ends. They end with it, or with its first error.
#[must_use]
pub fn typed_lines() -> TypedInput<String> {
    TypedInput::new(|| std::io::stdin().lines().map_while(Result::ok))
}

/// Lines of a source that is read to its end, such as a file.
pub fn lines_of<R: std::io::BufRead + Send + 'static>(source: R) -> TypedInput<String> {
    TypedInput::new(|| source.lines().map_while(Result::ok))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_items_than_fit_arrive_in_order_and_then_the_end() {
        let count = 3 * WAITING_MAX;
        let mut input = TypedInput::new(move || 0..count);
        let mut seen = Vec::new();
        loop {
            match input.fetch() {
                Fetched::Item(item) => seen.push(item),
                Fetched::Nothing => std::thread::yield_now(),
                Fetched::Ended => break,
            }
        }
        assert_eq!(seen, (0..count).collect::<Vec<_>>());
        assert_eq!(input.fetch(), Fetched::Ended);
    }

    #[test]
    fn the_thread_ends_when_nobody_fetches_any_more() {
        struct Told(std::sync::mpsc::Sender<()>);
        impl Drop for Told {
            fn drop(&mut self) {
                let _ = self.0.send(());
            }
        }
        let (sender, ended) = std::sync::mpsc::channel();
        let reported = Told(sender);
        drop(TypedInput::new(move || {
            std::iter::repeat_with(move || {
                let _ = &reported;
            })
        }));
        assert_eq!(ended.recv(), Ok(()));
    }
}
