//! Instants of a nominal run, from its own events.

use operator::job::Step;
use planner::plan::file::PlanFile;
use protocol::Instant;
use protocol::cyphal::cubecell::group_state::State;

use super::evidence::{Evidence, ReportedOutcome};

/// Part of a run in which a fault begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Phase {
    /// The controller looks for its drives and proves their watchdogs.
    Scan,
    /// A joint looks for its zero.
    Home,
    Approach,
    Upload,
    Armed,
    Accelerate,
    Brake,
    /// At rest, after the end of the run.
    After,
}

impl Phase {
    pub const ALL: [Self; 8] = [
        Self::Scan,
        Self::Home,
        Self::Approach,
        Self::Upload,
        Self::Armed,
        Self::Accelerate,
        Self::Brake,
        Self::After,
    ];

    /// The cell must start without its zeros.
    pub const fn needs_homing(self) -> bool {
        matches!(self, Self::Home)
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Home => "home",
            Self::Approach => "approach",
            Self::Upload => "upload",
            Self::Armed => "armed",
            Self::Accelerate => "accelerate",
            Self::Brake => "brake",
            Self::After => "after",
        }
    }
}

/// When each phase is half over in a nominal run.
#[derive(Clone, Debug)]
pub struct Phases {
    at: Vec<(Phase, Instant)>,
}

impl Phases {
    /// From the events of a run that landed.
    pub fn of(run: &Evidence, plan: &PlanFile) -> Result<Self, String> {
        if run.reported != ReportedOutcome::Landed {
            return Err(format!("the nominal run did not land: {:?}", run.reported));
        }
        let between = |(a, b): (Instant, Instant), share: f64| {
            a + protocol::Duration::from_secs_f64(share * b.saturating_since(a).as_secs_f64())
        };
        let step = |step: Step| run.step(step).ok_or_else(|| format!("no step {}", step.name()));
        let throw = step(Step::Throw)?;
        let release = run.ball.released_at.ok_or("the ball was not released")?;
        // The plan begins that long before the ball is free.
        let begun = Instant::from_micros(
            release.as_micros().saturating_sub((1e6 * plan.release_time_s).round() as u64),
        );
        let ended = run.bus.first(release, |state| state == State::Ready).ok_or("never ready again")?;
        let armed = run.bus.first(step(Step::Arm)?.0, |state| state == State::Armed).ok_or("never armed")?;
        let planned_end = begun + protocol::Duration::from_secs_f64(plan.end_time_s);
        let mut at = vec![
            (Phase::Scan, between(step(Step::Drives)?, 0.3)),
            (Phase::Approach, between(step(Step::Approach)?, 0.5)),
            (Phase::Upload, between(step(Step::Upload)?, 0.5)),
            (Phase::Armed, between((armed, throw.0.max(armed)), 0.5)),
            (Phase::Accelerate, between((begun, release), 0.6)),
            (Phase::Brake, between((release, planned_end), 0.4)),
            (Phase::After, ended + protocol::Duration::from_millis(20)),
        ];
        if let Ok(home) = step(Step::Home) {
            at.push((Phase::Home, between(home, 0.4)));
        }
        Ok(Self { at })
    }

    /// The instant in a phase; `None` if the run did not have it.
    pub fn at(&self, wanted: Phase) -> Option<Instant> {
        self.at.iter().find(|(phase, _)| *phase == wanted).map(|(_, at)| *at)
    }
}
