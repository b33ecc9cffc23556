//! Which options mean nothing in what a verb is asked to do: one table, for every verb, robot and bus. What is given and means
//! nothing is refused by name.

use std::collections::BTreeSet;

use can_link::BusSpec;
use clap::parser::ValueSource;
use clap::{ArgMatches, Command, FromArgMatches};

use crate::error::ExpectedError;

/// The ids of the options that stand on the command line. It is the first field of the arguments of a verb: the fields behind it
/// take their values away.
#[derive(Debug, Clone, Default, serde::Deserialize)]
pub struct Given(BTreeSet<String>);

/// What is asked of a verb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Deed {
    PlanOfFile,
    /// Lead a robot that closes its loops itself, over RSI.
    Led,
    /// Run the controller of this project on a CAN bus.
    OnCan,
    ControllerOnBus,
    TargetGiven,
    /// Measure all axes of such a robot together.
    AllAxes,
    /// Use a bus outside this program: nothing is simulated.
    Live,
    /// The same by a verb that draws nothing but the simulated cell.
    LiveUndrawn,
    NotRsi,
    /// Use RSI: there are no nodes and no drives.
    OnRsi,
    /// Plan a throw whose hand follows the flight.
    Following,
    /// The same, by the grid of the paper.
    PaperGrid,
    /// The same, by starts.
    Starts,
    /// Plan a throw with the release at one instant.
    Ordinary,
    NoOpening,
    NoNormal,
    NoRadius,
    /// Fly a disc on a parabola.
    NoAir,
    NoBall,
    /// Read what a sweep has made.
    Summary,
}

const ONE_TARGET: &str = "opening_normal opening_radius_m incidence_max_deg target_velocity target_course";
const TO_CHANCE: &str = "time_budget_s hit_radius_m hit_box jitter_s release_delays objective";
/// Of throws with the release at one instant.
const DRIVES: &str = "speed_use acceleration_use free_spin null_delay delay_window clean_release clearance_m range_margin_rad \
    drag_per_m magnus_rad_s finger_release weights obstacle arrival_speed_m_s arrival_descent_deg radius_m elevation_deg flight_s \
    duration_s braking_ratio thorough";
const TRACKER: &str = "tracker tracker_body tracker_offset tracker_frames calibration";

/// What is asked, the options that mean nothing then (after `!`: all but these), and why.
const TABLE: &[(Deed, &[&str], &str)] = &[
    (
        Deed::PlanOfFile,
        &["obstacle starts thorough"],
        "is for making a plan; the one of --plan says what is thrown",
    ),
    (
        Deed::Led,
        &["controller gains period_ms web back key_file"],
        "has no meaning for a robot with a controller of its own",
    ),
    (
        Deed::AllAxes,
        &["joint home level speed_share current_share bit_rate sim_noise_a report"],
        "has no meaning for a robot with a controller of its own: all its axes are measured together",
    ),
    (Deed::OnCan, &["rsi"], "is for a robot that is led over RSI; this one has drives on a CAN bus"),
    (
        Deed::ControllerOnBus,
        &["period_ms"],
        "is for a controller in this program; set register cycle.period_us of the one on the bus",
    ),
    (Deed::TargetGiven, &[TRACKER], "is for --target tracker"),
    (Deed::Live, &["scenario"], "is for what is simulated inside this program"),
    (Deed::LiveUndrawn, &["scenario seed"], "is for the cell inside this program"),
    (Deed::NotRsi, &["rsi"], "is for --bus rsi:..."),
    (Deed::OnRsi, &["controller key_file beside record"], "is for a CAN bus"),
    (Deed::Following, &[DRIVES, ONE_TARGET, TO_CHANCE], "has no meaning for a throw that follows the flight"),
    (Deed::Following, &["fast"], "needs stored throws; none are kept of throws that follow the flight"),
    (Deed::PaperGrid, &["starts tilt_max_deg"], "is for --form best; the form paper searches a grid"),
    (Deed::Starts, &["resolution refine ramps criterion"], "is for --form paper"),
    (
        Deed::Ordinary,
        &[
            "lag_ms period_ms tilt_max_deg ramps_deg_s2 limits resolution refine ramps criterion weights_w weights_g",
        ],
        "is for throws that follow the flight: add --follow",
    ),
    (Deed::NoOpening, &["incidence_max_deg"], "is for an opening: add --opening-normal"),
    (Deed::NoNormal, &["opening_radius_m"], "needs the direction of the opening: add --opening-normal"),
    (Deed::NoRadius, &["opening_normal"], "needs the size of the opening: add --opening-radius-m"),
    (Deed::NoAir, &["wind spin_rad_s"], "is for a flight in air: add --air"),
    (Deed::NoBall, &["cooperative"], "is for a ball: add --ball"),
    (Deed::Summary, &["! summary json picture"], "is for making a sweep; --summary reads one"),
];

impl Given {
    /// Refuses the first option that means nothing in what is asked.
    ///
    /// # Errors
    /// The option, and why.
    pub(super) fn require_meaning(&self, deeds: &[Deed]) -> Result<(), ExpectedError> {
        let rows = TABLE.iter().filter(|(deed, ..)| deeds.contains(deed));
        let refused = rows.flat_map(|(_, ids, why)| {
            let all_but = ids.iter().any(|ids| ids.starts_with('!'));
            let named = |id: &str| ids.iter().flat_map(|ids| ids.split(' ')).any(|known| known == id);
            self.0.iter().filter(move |id| named(id) != all_but).map(move |id| (id, *why))
        });
        match refused.into_iter().next() {
            None => Ok(()),
            Some((id, why)) => {
                let option = format!("--{}", id.replace('_', "-"));
                Err(ExpectedError::bad_input(&format!("{option} {why}")).next(format!("leave {option} out")))
            }
        }
    }
}

/// Refuses options of the common group of a bus that mean nothing on the bus that is named.
///
/// # Errors
/// The option, and why.
pub fn require_on_bus(program: &Command, matches: &ArgMatches) -> Result<(), ExpectedError> {
    let (mut command, mut matches) = (program, matches);
    while let Some((name, inner)) = matches.subcommand() {
        let Some(verb) = command.find_subcommand(name) else { return Ok(()) };
        (command, matches) = (verb, inner);
    }
    // The group has this option, verbs with a bus of their own do not. `matches` knows only in debug builds which options there are.
    if !command.get_arguments().any(|arg| arg.get_id() == "beside") {
        return Ok(());
    }
    let Ok(Some(bus)) = matches.try_get_one::<BusSpec>("bus") else { return Ok(()) };
    let given = Given::from_arg_matches(matches).unwrap_or_default();
    let deeds = match bus {
        BusSpec::Sim => &[Deed::NotRsi][..],
        BusSpec::Rsi(_) => &[Deed::LiveUndrawn, Deed::OnRsi],
        _ => &[Deed::LiveUndrawn, Deed::NotRsi],
    };
    given.require_meaning(deeds)
}

impl FromArgMatches for Given {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let written = |id: &&clap::Id| matches.value_source(id.as_str()) == Some(ValueSource::CommandLine);
        // Groups are named as types are.
        let option = |id: &&clap::Id| id.as_str().starts_with(|c: char| c.is_ascii_lowercase());
        Ok(Self(matches.ids().filter(option).filter(written).map(ToString::to_string).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl clap::Args for Given {
    fn augment_args(command: Command) -> Command {
        command
    }

    fn augment_args_for_update(command: Command) -> Command {
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory;

    #[test]
    fn every_word_of_the_table_is_an_option_of_some_verb() {
        fn ids(command: &Command, found: &mut Vec<String>) {
            found.extend(command.get_arguments().map(|arg| arg.get_id().to_string()));
            command.get_subcommands().for_each(|verb| ids(verb, found));
        }
        let mut known = Vec::new();
        ids(&Cli::command(), &mut known);
        for word in TABLE.iter().flat_map(|(_, ids, _)| ids.iter()).flat_map(|ids| ids.split_whitespace()) {
            assert!(word == "!" || known.iter().any(|id| id == word), "{word}");
        }
    }
}
