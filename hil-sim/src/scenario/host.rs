//! A host that only does what the scenario lists.

use std::collections::VecDeque;

use protocol::{Frame, Instant, Node};

use super::Action;

/// Sends scripted frames at scripted times and ignores received frames.
#[derive(Clone, Debug)]
pub struct ScriptedHost {
    /// Next time of each action, with what is left of it.
    entries: Vec<(Option<Instant>, u64, Action)>,
    out: VecDeque<Frame>,
}

impl ScriptedHost {
    /// A host with this script. Actions of the same time are done in the order of the list.
    pub fn new(actions: &[Action]) -> Self {
        let entries = actions
            .iter()
            .map(|action| {
                let count = match action.every {
                    Some(_) => action.count.unwrap_or(u64::MAX),
                    None => 1,
                };
                (Some(action.at), count, action.clone())
            })
            .collect();
        Self { entries, out: VecDeque::new() }
    }
}

impl Node for ScriptedHost {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}

    fn handle_timeout(&mut self, now: Instant) {
        for (next, left, action) in &mut self.entries {
            // One round per call: a caller that comes late catches up call by call.
            if let Some(due) = *next
                && due <= now
            {
                self.out.extend(&action.frames);
                *left -= 1;
                *next = match action.every {
                    Some(every) if *left > 0 => Some(due + every),
                    _ => None,
                };
            }
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.entries.iter().filter_map(|(next, ..)| *next).min()
    }
}
