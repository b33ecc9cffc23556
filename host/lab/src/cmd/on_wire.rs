//! `cubelab rally --bus-thrower --bus-catcher --tracker`: one throw over the wire, in real time or in lock step.

use can_link::BusSpec;
use hil_sim::court::CourtOptions;
use host::cmd::consent::Consent;
use host::error::ExpectedError;
use host::exit;
use operator::ball_catch::trial::{Pair, TrialOptions};
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use planner::catch::draw::Window;
use serde_json::{Value, json};

use crate::rally::on_wire::{WireError, WireOptions, WireOutcome, run};
use crate::rally::throws::{draw_throws, place_exists};

/// Throws that are drawn until one has a place where it can be caught.
const DRAWS: usize = 40;
/// Flight times, s: shorter ones leave too little time in which the tracker sees the ball.
const FLIGHT_S: (f64, f64) = (0.6, 0.9);

/// Where arms and tracker are.
#[derive(Debug, clap::Args)]
pub struct Wire {
    /// Bus of the arm that throws: instead of a rally in virtual time one throw in real time, with a controller in this
    /// program on each bus. Place the arms as the court says.
    #[arg(long, value_parser = can_link::bus_of_option, value_name = "SPEC", requires_all = ["bus_catcher", "tracker"], conflicts_with_all = ["study", "trouble", "report", "throws"], help_heading = "Over the wire")]
    pub bus_thrower: Option<BusSpec>,
    /// Bus of the arm that catches.
    #[arg(long, value_parser = can_link::bus_of_option, value_name = "SPEC", requires = "bus_thrower", help_heading = "Over the wire")]
    pub bus_catcher: Option<BusSpec>,
    /// Address of this machine to which the tracker (DTrack) sends its data. With lockstep:// for both buses: where
    /// `hil-sim serve-court` has them (its --data).
    #[arg(long, value_name = "HOST:PORT", requires = "bus_thrower", help_heading = "Over the wire")]
    pub tracker: Option<String>,
    /// Do not ask before the arms move.
    #[arg(long, requires = "bus_thrower", help_heading = "Over the wire")]
    pub yes: bool,
    /// Control period of both controllers, ms: 3, 5, 10 or 17.
    #[arg(long, value_name = "MS", default_value_t = 5, requires = "bus_thrower", value_parser = clap::value_parser!(u32).range(1..=40), help_heading = "Over the wire")]
    pub period: u32,
}

impl Wire {
    /// Over the wire is meant, not virtual time.
    pub(super) const fn is_meant(&self) -> bool {
        self.bus_thrower.is_some()
    }

    /// Draws a throw, throws and catches.
    pub(super) fn run(
        &self,
        court: CourtOptions,
        options: &TrialOptions,
        seed: u64,
    ) -> Result<WireOutcome, ExpectedError> {
        let (Some(thrower), Some(catcher), Some(tracker)) =
            (&self.bus_thrower, &self.bus_catcher, &self.tracker)
        else {
            return Err(ExpectedError::new(
                exit::USAGE,
                "a throw over the wire needs two buses and a tracker",
            )
            .next("give --bus-thrower, --bus-catcher and --tracker"));
        };
        if thrower == catcher || [thrower, catcher].contains(&&BusSpec::Sim) {
            return Err(ExpectedError::bad_input(
                &"thrower and catcher need a bus of their own each: signs of life to the drives go to \
                     everybody on a bus",
            )
            .next("two places, as `hil-sim serve-court` has them"));
        }
        let is_in_step = |spec: &BusSpec| matches!(spec, BusSpec::Lockstep { .. });
        if is_in_step(thrower) != is_in_step(catcher) {
            return Err(ExpectedError::bad_input(
                &"two buses have one time: lock step or the machine's, not both",
            )
            .next("give lockstep:// for both, or for none"));
        }
        // Both buses are real ones; the question names them together.
        Consent::on(thrower, self.yes)?.require(
            "Both arms home, one throws and the other catches. Ball in the hand, nobody near?",
            &interrupt(),
        )?;
        let robot = court.arms[0].model.name().to_owned();
        let pair = Pair::new(court).map_err(|why| ExpectedError::bad_input(&why))?;
        let window = Window { flight_s: FLIGHT_S, ..Window::default() };
        let throws = draw_throws(&pair, &window, DRAWS, seed).unwrap_or_default();
        let aimed = throws.iter().find(|aimed| place_exists(&pair, aimed, options)).ok_or_else(|| {
            ExpectedError::new(exit::NO_THROW, "no throw was found that the other arm catches")
                .next("set the arms of the court 2 to 3 m apart, or another --seed")
        })?;
        let wire = WireOptions {
            thrower: thrower.clone(),
            catcher: catcher.clone(),
            tracker: tracker.clone(),
            robot,
            period_us: self.period * 1_000,
        };
        run(&pair, aimed, options, &wire).map_err(failed)
    }
}

fn failed(why: WireError) -> ExpectedError {
    match why {
        WireError::Bus(why) => why.into(),
        WireError::Operator(why) => why.into(),
        WireError::Settings(_) | WireError::Period(_) | WireError::Trajectory(_) => {
            ExpectedError::bad_input(&why)
        }
        WireError::Tracker { .. } | WireError::Silent { .. } => ExpectedError::of(exit::BUS, &why),
        WireError::Arm { .. } | WireError::NotReady => ExpectedError::of(exit::DRIVE, &why),
    }
}

/// Why the throw did not run to its end, with the exit code.
pub(super) fn not_thrown(thrown: Result<(), OperatorError>) -> Option<ExpectedError> {
    match thrown {
        Ok(()) => None,
        Err(why @ OperatorError::Stopped { .. }) => {
            Some(ExpectedError::of(exit::STOPPED, &why).at("the thrower"))
        }
        Err(why) => Some(why.into()),
    }
}

/// The outcome as text.
pub(super) fn as_text(outcome: &WireOutcome, reported: &str) -> String {
    let mut out = format!("reported: {reported}\n");
    out += &match &outcome.thrown {
        Ok(()) => "  thrower: the throw ran to its end\n".to_owned(),
        Err(why) => format!("  thrower: {why}\n"),
    };
    if let Some((after_s, probability)) = outcome.choice {
        out += &format!(
            "  catch {after_s:.3} s after the planned release, predicted probability {probability:.2}\n"
        );
    }
    let clocks = &outcome.clocks;
    out += &format!(
        "  end states: {} taken, {} refused; {} decisions, the longest {:.1} ms\n",
        outcome.answered.0,
        outcome.answered.1,
        outcome.decisions,
        outcome.longest_decision_s * 1e3
    );
    out += &format!(
        "  clocks: this machine less the tracker {:.4} s, by the least late of {} datagrams, after the release at most {:.1} ms later than that; controllers known to {:.1} ms (thrower) and {:.1} ms (catcher){}\n",
        clocks.tracker_offset_s,
        clocks.datagrams,
        outcome.latest_datagram_s * 1e3,
        clocks.controllers_off_s[0] * 1e3,
        clocks.controllers_off_s[1] * 1e3,
        match clocks.catcher_held {
            Some(true) => "",
            Some(false) => "; the catcher's clock has jumped",
            None => "; the catcher's clock was not readable at the end",
        }
    );
    out
}

/// The outcome as JSON.
pub(super) fn as_json(outcome: &WireOutcome, reported: &str) -> Value {
    let clocks = &outcome.clocks;
    json!({
        "reported": reported,
        "thrown": outcome.thrown.as_ref().map_or_else(ToString::to_string, |()| "ended".to_owned()),
        "choice": outcome.choice.map(|(after_s, probability)| json!({
            "after_release_s": after_s, "probability": probability,
        })),
        "end_states": {"taken": outcome.answered.0, "refused": outcome.answered.1},
        "refusals": outcome.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "decisions": outcome.decisions,
        "longest_decision_s": outcome.longest_decision_s,
        "clocks": {
            "tracker_offset_s": clocks.tracker_offset_s,
            "datagrams": clocks.datagrams,
            "latest_datagram_s": outcome.latest_datagram_s,
            "thrower_off_s": clocks.controllers_off_s[0],
            "catcher_off_s": clocks.controllers_off_s[1],
            "catcher_held": clocks.catcher_held,
        },
    })
}
