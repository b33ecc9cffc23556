//! Actions on outputs during a motion, each at a time that need not be a sample.

/// Most events of a plan, and of one new end state.
pub const EVENTS_MAX: usize = 8;

/// What happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Action {
    /// What the gripper holds is free at the time of the event: the output is switched `gripper.opening_us` before.
    #[default]
    Open,
    /// The output of the gripper is switched to closed at the time of the event.
    Close,
}

impl Action {
    /// Number in files and messages.
    pub const fn number(self) -> u8 {
        match self {
            Self::Open => 0,
            Self::Close => 1,
        }
    }

    /// The action with this number; `None` if the controller does not know the number.
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Open),
            1 => Some(Self::Close),
            _ => None,
        }
    }
}

/// An action at a time since the start of the plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanEvent {
    /// Time, µs.
    pub t_us: u32,
    /// What happens.
    pub action: Action,
}

/// Up to [`EVENTS_MAX`] events of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanEvents {
    list: [PlanEvent; EVENTS_MAX],
    count: u8,
}

impl PlanEvents {
    /// No events.
    pub const NONE: Self = Self { list: [PlanEvent { t_us: 0, action: Action::Open }; EVENTS_MAX], count: 0 };

    /// The ball is released at this time, or never.
    pub const fn release(t_us: Option<u32>) -> Self {
        let mut events = Self::NONE;
        if let (Some(t_us), [first, ..]) = (t_us, &mut events.list) {
            *first = PlanEvent { t_us, action: Action::Open };
            events.count = 1;
        }
        events
    }

    /// Appends an event; false (and nothing changed) if the list is full.
    #[must_use]
    pub fn push(&mut self, event: PlanEvent) -> bool {
        let Some(place) = self.list.get_mut(usize::from(self.count)) else { return false };
        *place = event;
        self.count += 1;
        true
    }

    /// The events, in the order of the file.
    pub fn as_slice(&self) -> &[PlanEvent] {
        self.list.get(..usize::from(self.count)).unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_bounded_and_numbers_round_trip() {
        let mut events = PlanEvents::release(Some(7));
        let close = PlanEvent { t_us: 9, action: Action::Close };
        for _ in 1..EVENTS_MAX {
            assert!(events.push(close));
        }
        assert!(!events.push(close));
        assert_eq!((events.as_slice().len(), events.as_slice()[0].t_us), (EVENTS_MAX, 7));
        assert!(PlanEvents::release(None).as_slice().is_empty());
        for number in 0..=255 {
            assert!(Action::from_number(number).is_none_or(|action| action.number() == number));
        }
        assert_eq!(Action::from_number(2), None);
    }
}
