//! The rules by name, what breaks them, and how much happened.

use protocol::Instant;

/// What must hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Rule {
    /// A joint moves only as the last order says, and comes to rest when that ends.
    Motion,
    /// A joint outside its limits moves inwards only; no target lies further out.
    Limits,
    /// A stop halts in time, and nothing is armed or runs after it without a new offer.
    Stop,
    /// A deadline that was served lies in the future.
    Deadline,
    /// A run with a start time begins at that time or never; its gripper switches in time.
    Start,
    /// Fault is left by a clear with the right number at rest, and by nothing else.
    Fault,
    /// While armed or running each drive holds what the settings say.
    Held,
    /// No limit widens without an unlock, and a changed one voids the commit.
    Settings,
    /// The controller panics, floods the bus or asks for a deadline in the past for ever.
    Contract,
}

#[derive(Clone, Debug)]
pub(crate) struct Violation {
    pub(crate) rule: Rule,
    pub(crate) at: Instant,
    pub(crate) what: String,
}

/// How much happened: a sequence in which nothing is taken breaks no rule.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Taken {
    pub(crate) homings: u32,
    pub(crate) jogs: u32,
    pub(crate) commits: u32,
    pub(crate) armings: u32,
    pub(crate) runs: u32,
    pub(crate) clears: u32,
    pub(crate) stops_in_motion: u32,
}

impl std::ops::AddAssign for Taken {
    fn add_assign(&mut self, other: Self) {
        self.homings += other.homings;
        self.jogs += other.jogs;
        self.commits += other.commits;
        self.armings += other.armings;
        self.runs += other.runs;
        self.clears += other.clears;
        self.stops_in_motion += other.stops_in_motion;
    }
}
