//! `cubelab rally --bus-thrower --bus-catcher --tracker`: a rally over the wire, in real time or in lock step.

use std::path::{Path, PathBuf};

use can_link::BusSpec;
use hil_sim::two_arms::TwoArmOptions;
use host::cmd::catch::on_bus::{as_json as caught_json, clocks_text, failed, path_json};
use host::cmd::catch::outcome::reported_text;
use host::cmd::catch::record;
use host::cmd::consent::Consent;
use host::cmd::tracker::base_in_room;
use host::error::ExpectedError;
use host::exit;
use operator::ball_catch::trial::TrialOptions;
use operator::ball_catch::wire::ArmOnBus;
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use serde_json::{Value, json};

use crate::rally::exchange::{Partners, Rally, RallyEnd};
use crate::rally::on_wire::{Broken, WireExchange, WireOptions, WireRally, play};
use crate::report;

/// Where arms and tracker are.
#[derive(Debug, clap::Args)]
pub struct Wire {
    /// Bus of the arm that throws first: instead of a rally in virtual time one in real time, with a controller in this
    /// program on each bus. Place the arms as the cell says.
    #[arg(long, value_parser = can_link::bus_of_option, value_name = "SPEC", requires_all = ["bus_catcher", "tracker"], conflicts_with_all = ["study", "faults"], help_heading = "Over the wire")]
    pub bus_thrower: Option<BusSpec>,
    /// Bus of the arm that catches first.
    #[arg(long, value_parser = can_link::bus_of_option, value_name = "SPEC", requires = "bus_thrower", help_heading = "Over the wire")]
    pub bus_catcher: Option<BusSpec>,
    /// Address of this machine to which the tracker (DTrack) sends its data. With lockstep:// for both buses: where
    /// `hil-sim serve-two-arms` has them (its --data).
    #[arg(long, value_name = "HOST:PORT", requires = "bus_thrower", help_heading = "Over the wire")]
    pub tracker: Option<String>,
    /// Where the first arm stands in the tracker's room, by a file of `cubectl tracker calibrate` [default: as the cell says].
    #[arg(long, value_name = "FILE", requires_all = ["bus_thrower", "calibration_catcher"], help_heading = "Over the wire")]
    pub calibration_thrower: Option<PathBuf>,
    /// Where the second arm stands there.
    #[arg(long, value_name = "FILE", requires_all = ["bus_thrower", "calibration_thrower"], help_heading = "Over the wire")]
    pub calibration_catcher: Option<PathBuf>,
    /// Do not ask before the arms move.
    #[arg(long, requires = "bus_thrower", help_heading = "Over the wire")]
    pub yes: bool,
    /// Control period of both controllers, ms: 3, 5, 10 or 17.
    #[arg(long, value_name = "MS", default_value_t = 5, requires = "bus_thrower", value_parser = clap::value_parser!(u32).range(1..=40), help_heading = "Over the wire")]
    pub period: u32,
    /// Record into this folder: in virtual time joints of thrower and catcher and the ball of each throw; over the wire both buses
    /// (arm-1.log and arm-1.mcap, arm-2.log and arm-2.mcap) and ball.mcap, what the tracker shows.
    #[arg(long, value_name = "FOLDER")]
    pub record: Option<PathBuf>,
}

impl Wire {
    /// Over the wire is meant, not virtual time.
    pub(super) const fn is_meant(&self) -> bool {
        self.bus_thrower.is_some()
    }

    /// The arms of the cell on their buses.
    fn options(&self, cell: &TwoArmOptions) -> Result<WireOptions, ExpectedError> {
        let (Some(first), Some(second), Some(tracker)) =
            (&self.bus_thrower, &self.bus_catcher, &self.tracker)
        else {
            return Err(ExpectedError::new(
                exit::USAGE,
                "a throw over the wire needs two buses and a tracker",
            )
            .next("give --bus-thrower, --bus-catcher and --tracker"));
        };
        if first == second || [first, second].contains(&&BusSpec::Sim) {
            return Err(ExpectedError::bad_input(
                &"thrower and catcher need a bus of their own each: signs of life to the drives go to \
                     everybody on a bus",
            )
            .next("two places, as `hil-sim serve-two-arms` has them"));
        }
        let is_in_step = |spec: &BusSpec| matches!(spec, BusSpec::Lockstep { .. });
        if is_in_step(first) != is_in_step(second) {
            return Err(ExpectedError::bad_input(
                &"two buses have one time: lock step or the machine's, not both",
            )
            .next("give lockstep:// for both, or for none"));
        }
        if let Some(folder) = &self.record {
            std::fs::create_dir_all(folder).map_err(|e| ExpectedError::output(folder, &e))?;
        }
        let arm = |k: usize, bus: &BusSpec| ArmOnBus {
            bus: bus.clone(),
            robot: cell.arms[k].model.clone(),
            period_us: self.period * 1_000,
            record: self.record.as_ref().map(|folder| folder.join(format!("arm-{}", k + 1))),
        };
        Ok(WireOptions { arms: [arm(0, first), arm(1, second)], tracker: tracker.clone() })
    }

    /// Throws to and fro.
    pub(super) fn run(
        &self,
        mut cell: TwoArmOptions,
        throws: usize,
        options: &TrialOptions,
        seed: u64,
        report: Option<&Path>,
        observe: impl FnMut(usize, &WireExchange),
    ) -> Result<WireRally, ExpectedError> {
        let wire = self.options(&cell)?;
        for (arm, file) in cell.arms.iter_mut().zip([&self.calibration_thrower, &self.calibration_catcher]) {
            if let Some(file) = file {
                arm.x_wb = base_in_room(file, arm.model.name())?;
            }
        }
        // Both buses are real ones; the question names them together.
        Consent::on(&wire.arms[0].bus, self.yes)?.require(
            "Both arms home and throw to each other. Ball in the hand of the first one, nobody near?",
            &interrupt(),
        )?;
        let ball_radius_m = cell.ball.radius_m;
        let partners = Partners::new(cell).map_err(|why| ExpectedError::bad_input(&why))?;
        let rally = play(&partners, throws, options, &wire, seed, observe);
        if let Some(folder) = &self.record {
            let file = folder.join("ball.mcap");
            record::markers(&file, ball_radius_m, rally.exchanges.iter().map(|exchange| &exchange.caught))?;
        }
        if let (Some(file), Some(last)) = (report, rally.exchanges.last()) {
            let shown = Rally {
                exchanges: rally.exchanges.iter().map(WireExchange::as_shown).collect(),
                end: rally.end.as_ref().map_or_else(Broken::as_end, RallyEnd::clone),
            };
            if let Some(exchange) = shown.exchanges.last() {
                let page = report::rally(&shown, &last.planned.pair, exchange, options.jerk);
                std::fs::write(file, page).map_err(|e| ExpectedError::output(file, &e))?;
            }
        }
        Ok(rally)
    }
}

/// How the rally ended, with its exit code.
pub(super) fn ended(rally: WireRally) -> Result<(), ExpectedError> {
    let end = match rally.end {
        Ok(end) => end,
        Err(Broken { arm, why }) => {
            let error = failed(*why);
            return Err(match arm {
                Some(arm) if error.code != exit::INTERRUPTED => error.at(format!("arm {}", arm + 1)),
                _ => error,
            });
        }
    };
    if let Some([why, next]) = end.not_thrown() {
        return Err(ExpectedError::new(exit::NO_THROW, why).next(next));
    }
    let Some(last) = rally.exchanges.into_iter().last().filter(|_| end == RallyEnd::NotCaught) else {
        return Ok(());
    };
    match last.thrown.ended {
        Ok(()) => Err(host::cmd::catch::outcome::why_not_caught(last.caught.reported)),
        Err(why @ OperatorError::Stopped { .. }) => {
            Err(ExpectedError::of(exit::STOPPED, &why).at("the thrower"))
        }
        Err(why) => Err(why.into()),
    }
}

/// An exchange as text.
pub(super) fn exchange_text(k: usize, exchange: &WireExchange) -> String {
    let caught = &exchange.caught;
    let [x, y, _] = exchange.gripped_e_m.into();
    let mut out = format!(
        "{:2}: arm {} throws from {:.0} mm beside the axis of its cup, flight {:.2} s: {}\n",
        k + 1,
        exchange.thrower + 1,
        f64::hypot(x, y) * 1e3,
        exchange.planned.aimed.flight_s,
        reported_text(caught.reported)
    );
    if let Err(why) = &exchange.thrown.ended {
        out += &format!("  thrower: {why}\n");
    }
    out += &clocks_text(caught, exchange.release_s, "the release");
    out += &format!("  thrower's controller known to {:.1} ms\n", exchange.thrown.clock_off_s * 1e3);
    out
}

/// The rally as JSON; times of an exchange count from its planned release. `broken`: why an arm broke off.
pub(super) fn as_json(rally: &WireRally) -> Value {
    json!({
        "length": rally.length(),
        "complete": matches!(rally.end, Ok(RallyEnd::Complete)),
        "broken": rally.end.as_ref().err().map(ToString::to_string),
        "exchanges": rally.exchanges.iter().map(exchange_json).collect::<Vec<_>>(),
    })
}

fn exchange_json(exchange: &WireExchange) -> Value {
    let mut json = caught_json(&exchange.caught, exchange.release_s);
    json["thrower"] = json!(exchange.thrower + 1);
    json["flight_s"] = json!(exchange.planned.aimed.flight_s);
    json["transit_s"] = json!(exchange.planned.transit_s());
    json["planned_gripped_e_m"] = json!(exchange.gripped_e_m.as_slice());
    json["thrown"] =
        json!(exchange.thrown.ended.as_ref().map_or_else(ToString::to_string, |()| "ended".to_owned()));
    json["clocks"]["thrower_off_s"] = json!(exchange.thrown.clock_off_s);
    json["trace"]["thrower"] = path_json(&exchange.thrown.joints, exchange.release_s, "q_rad", |q| &q[..]);
    json
}
