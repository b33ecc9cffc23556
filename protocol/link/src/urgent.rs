//! Requests to the operating system for a thread that must not be late: to run before all others, to be woken in
//! time, and to have its memory locked.

use std::fmt;
use std::marker::PhantomData;

/// Real-time priorities (`SCHED_FIFO`, 1 to 99), by which thread waits for which. All are above everything of a
/// desktop and below the kernel's own interrupt threads (50).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Closes a control loop.
    Controller,
    /// Simulates the drives of a controller.
    Plant,
    /// Sends a controller the sign of life of its host.
    Host,
}

impl Role {
    #[must_use]
    pub const fn priority(self) -> u8 {
        match self {
            Self::Controller => 40,
            Self::Plant => 30,
            Self::Host => 20,
        }
    }
}

/// What the operating system granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Granted {
    /// A real-time priority (root, CAP_SYS_NICE, or a limit `rtprio` in limits.conf).
    pub priority: Option<u8>,
    /// The program's memory is locked (root, CAP_IPC_LOCK, or a sufficient limit `memlock`).
    pub memory: bool,
}

/// `real-time priority 40, memory locked`, or what is missing and how to get it.
impl fmt::Display for Granted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.priority {
            Some(priority) => write!(f, "real-time priority {priority}, ")?,
            None => f.write_str(
                "ordinary priority (for a real-time one: root, CAP_SYS_NICE, or `rtprio` in limits.conf), ",
            )?,
        }
        f.write_str(if self.memory {
            "memory locked"
        } else {
            "memory not locked (needs `memlock` in limits.conf)"
        })
    }
}

/// While this value exists, its thread is scheduled before ordinary ones and its sleeps end on time, as far as the
/// system permits. If the system refuses, the thread works as before and [`Urgent::granted`] reports it.
///
/// Memory that is in use at the request is locked once for the whole program and stays so. What is mapped later is
/// not: with a limit on locked memory, allocations would then fail.
pub struct Urgent {
    granted: Granted,
    #[cfg(target_os = "linux")]
    before: linux::Before,
    /// Belongs to its thread.
    _here: PhantomData<*const ()>,
}

impl Urgent {
    /// Requests it for the calling thread.
    #[must_use]
    pub fn request(role: Role) -> Self {
        #[cfg(target_os = "linux")]
        {
            let before = linux::Before::remember();
            let priority = linux::raise(role.priority()).then(|| role.priority());
            let granted = Granted { priority, memory: linux::lock_memory() };
            Self { granted, before, _here: PhantomData }
        }
        #[cfg(not(target_os = "linux"))]
        {
            let _ = role;
            Self { granted: Granted::default(), _here: PhantomData }
        }
    }

    /// Result of the request.
    #[must_use]
    pub const fn granted(&self) -> Granted {
        self.granted
    }
}

#[cfg(target_os = "linux")]
impl Drop for Urgent {
    fn drop(&mut self) {
        self.before.restore(self.granted.priority.is_some());
    }
}

#[cfg(target_os = "linux")]
mod linux {
    use std::num::NonZeroU64;
    use std::sync::OnceLock;

    use rustix::mm::{MlockAllFlags, mlockall};
    use rustix::thread::{current_timer_slack, set_current_timer_slack};
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
        thread_native_id, thread_schedule_policy_param,
    };

    /// How the thread was scheduled, and its timer slack: Linux ends a sleep up to 50 µs late to wake for several
    /// things at once.
    pub(super) struct Before {
        slack_ns: Option<NonZeroU64>,
        scheduling: Option<(ThreadSchedulePolicy, ThreadPriority)>,
    }

    impl Before {
        pub(super) fn remember() -> Self {
            let slack_ns = current_timer_slack().ok().and_then(NonZeroU64::new);
            let _ = set_current_timer_slack(Some(NonZeroU64::MIN));
            let scheduling = thread_schedule_policy_param(thread_native_id()).ok();
            let scheduling = scheduling.map(|(policy, params)| match policy {
                ThreadSchedulePolicy::Realtime(_) => (policy, ThreadPriority::from_posix(params)),
                ThreadSchedulePolicy::Normal(_) => (policy, niceness()),
            });
            Self { slack_ns, scheduling }
        }

        pub(super) fn restore(&self, raised: bool) {
            let _ = set_current_timer_slack(self.slack_ns);
            if let (true, Some((policy, priority))) = (raised, self.scheduling) {
                // A value below the present one is always granted.
                let _ = set_thread_priority_and_policy(thread_native_id(), priority, policy);
            }
        }
    }

    /// The thread's niceness on the scale of `thread_priority`, which has 100 steps for the 40 of the system.
    fn niceness() -> ThreadPriority {
        let nice = rustix::process::getpriority_process(None).unwrap_or(0);
        let step = 99.0 * (1.0 - (f64::from(nice) + 20.5) / 39.0);
        (step.clamp(0.0, 99.0) as u8).try_into().map_or(ThreadPriority::Min, ThreadPriority::Crossplatform)
    }

    /// First in, first out, above all ordinary threads. A higher present priority (`chrt -f 50`) stays.
    pub(super) fn raise(priority: u8) -> bool {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        if let Ok((policy, params)) = thread_schedule_policy_param(thread_native_id())
            && policy == fifo
            && params.sched_priority >= i32::from(priority)
        {
            return true;
        }
        let Ok(value) = priority.try_into() else { return false };
        set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), fifo).is_ok()
    }

    pub(super) fn lock_memory() -> bool {
        static LOCKED: OnceLock<bool> = OnceLock::new();
        *LOCKED.get_or_init(|| mlockall(MlockAllFlags::CURRENT).is_ok())
    }
}

#[cfg(test)]
mod tests {
    #[cfg(target_os = "linux")]
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, thread_native_id, thread_schedule_policy_param,
    };

    use super::*;

    /// Policy and priority of this thread, as the system reports it.
    #[cfg(target_os = "linux")]
    fn in_force() -> (ThreadSchedulePolicy, i32) {
        let (policy, params) = thread_schedule_policy_param(thread_native_id()).unwrap();
        (policy, params.sched_priority)
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_was_granted_is_in_force_until_the_request_is_dropped() {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let before = in_force();
        let reported = |urgent: &Urgent| match urgent.granted().priority {
            Some(priority) => (fifo, i32::from(priority).max(before.1)),
            None => before,
        };
        let outer = Urgent::request(Role::Plant);
        assert_eq!(in_force(), reported(&outer));
        let with_outer = in_force();
        let inner = Urgent::request(Role::Controller);
        assert!(in_force().1 >= with_outer.1, "a nested request never lowers the priority");
        drop(inner);
        assert_eq!(in_force(), with_outer);
        drop(outer);
        assert_eq!(in_force(), before);
    }

    #[test]
    fn what_was_refused_is_said_with_the_way_to_get_it() {
        let text = Granted::default().to_string();
        assert!(text.contains("rtprio") && text.contains("memlock"), "{text}");
        assert_eq!(
            Granted { priority: Some(40), memory: true }.to_string(),
            "real-time priority 40, memory locked"
        );
    }
}
