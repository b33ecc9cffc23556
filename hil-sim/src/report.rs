//! What a run came to, for people and for machines.

use std::fmt;

use protocol::Instant;
use serde::Serialize;

use crate::bus::report::BusReport;
use crate::cell::Cell;
use crate::checker::CheckResult;
use crate::fault::FaultCount;
use crate::world::WorldStats;

#[derive(Clone, Debug, Serialize)]
pub struct RunReport {
    pub name: String,
    pub robot: String,
    /// Seed that repeats the run.
    pub seed: u64,
    /// Simulated time, seconds.
    pub simulated_s: f64,
    /// Wall-clock time, seconds.
    pub wall_s: f64,
    /// What the scheduler did.
    pub world: WorldStats,
    pub bus: BusReport,
    pub drives: Vec<DriveRow>,
    pub throw: ThrowRow,
    /// How often each fault happened.
    pub faults: Vec<FaultCount>,
    /// What the checkers found.
    pub checks: Vec<CheckResult>,
}

#[derive(Clone, Debug, Serialize)]
pub struct DriveRow {
    /// Wire address.
    pub module: u8,
    pub kind: String,
    pub processed: u64,
    /// Requests lost because its queue was full.
    pub overflowed: u64,
    /// Frames it did not understand.
    pub not_understood: u64,
    pub stops: u64,
    /// True position, rad.
    pub q_rad: f64,
    /// True velocity, rad/s.
    pub v_rad_s: f64,
}

/// The ball at the end of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ThrowRow {
    /// When it left the hand, seconds.
    pub released_at_s: Option<f64>,
    pub landing_m: Option<[f64; 3]>,
    /// Part of the arm that it touched first, if any.
    pub touched: Option<String>,
}

impl DriveRow {
    pub fn of(cell: &Cell) -> Vec<Self> {
        let rows = cell.drives().iter().enumerate();
        rows.map(|(index, drive)| {
            let (counters, axis) = (drive.counters(), cell.plant().axis(index));
            Self {
                module: drive.address().get(),
                kind: drive.nameplate().module.clone(),
                processed: counters.processed,
                overflowed: counters.overflowed,
                not_understood: counters.not_understood,
                stops: counters.stops,
                q_rad: axis.q_rad,
                v_rad_s: axis.v_rad_s,
            }
        })
        .collect()
    }
}

impl ThrowRow {
    pub fn of(cell: &Cell) -> Self {
        let throw = cell.throw();
        Self {
            released_at_s: throw.released_at.map(Instant::as_secs_f64),
            landing_m: throw.landing.as_ref().map(|landing| [landing.p_m.x, landing.p_m.y, landing.p_m.z]),
            touched: throw.touch.as_ref().map(|(_, touch)| touch.part.clone()),
        }
    }
}

impl RunReport {
    /// True if every checker ended as the scenario expects.
    pub fn as_expected(&self) -> bool {
        self.checks.iter().all(CheckResult::as_expected)
    }

    /// First number that is not finite, by name.
    pub fn not_finite(&self) -> Option<String> {
        for drive in &self.drives {
            if !(drive.q_rad.is_finite() && drive.v_rad_s.is_finite()) {
                return Some(format!(
                    "module {}: q {} rad, v {} rad/s",
                    drive.module, drive.q_rad, drive.v_rad_s
                ));
            }
        }
        match self.throw.landing_m {
            Some(p) if p.iter().any(|x| !x.is_finite()) => Some(format!("landing {p:?}")),
            _ => None,
        }
    }
}

impl fmt::Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ratio = if self.wall_s > 0.0 { self.simulated_s / self.wall_s } else { 0.0 };
        writeln!(
            f,
            "{}: {} s simulated in {:.3} s ({ratio:.0} x real time), {} frames, seed {}",
            self.name, self.simulated_s, self.wall_s, self.world.frames, self.seed
        )?;
        write!(f, "{}", self.bus)?;
        writeln!(
            f,
            "{:>6} {:>14} {:>9} {:>10} {:>10} {:>6} {:>10} {:>10}",
            "module", "kind", "processed", "overflowed", "unreadable", "stops", "q deg", "v deg/s"
        )?;
        for row in &self.drives {
            writeln!(
                f,
                "{:>6} {:>14} {:>9} {:>10} {:>10} {:>6} {:>10.3} {:>10.3}",
                row.module,
                row.kind,
                row.processed,
                row.overflowed,
                row.not_understood,
                row.stops,
                row.q_rad.to_degrees(),
                row.v_rad_s.to_degrees()
            )?;
        }
        if let (Some(at_s), Some([x, y, z])) = (self.throw.released_at_s, self.throw.landing_m) {
            writeln!(f, "ball: released at {at_s:.4} s, lands at ({x:.3}, {y:.3}, {z:.3}) m")?;
        }
        if let Some(part) = &self.throw.touched {
            writeln!(f, "ball: touched {part} after the release")?;
        }
        for fault in &self.faults {
            writeln!(
                f,
                "fault {}: happened {} times, acted on {} frames",
                fault.label, fault.occurrences, fault.frames
            )?;
        }
        for check in &self.checks {
            let verdict = match (check.as_expected(), check.expected_to_trip) {
                (true, false) => "held",
                (true, true) => "broke, as it must",
                (false, false) => "BROKE",
                (false, true) => "HELD, BUT MUST BREAK",
            };
            writeln!(f, "check {}: {verdict} ({} violations)", check.check.name(), check.violations)?;
            for violation in check.first.iter().take(5) {
                writeln!(f, "  {violation}")?;
            }
        }
        Ok(())
    }
}
