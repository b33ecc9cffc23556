//! `cubelab place`

use std::path::PathBuf;

use hil_sim::two_arms::TwoArmOptions;
use hil_sim::two_arms::scenario::TWO_ARMS;
use host::cmd::catch::catching::Catching;
use host::cmd::print_json;
use host::cmd::progress::while_working;
use host::cmd::values::within;
use host::error::ExpectedError;
use host::exit;
use serde_json::json;

use crate::rally::placing::{Judged, Placement, Search, find_place, judge};
use crate::rally::study::{NoStudy, Share, at_distance};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubelab place --distance-m 3 --hand matched --out placed.toml\n  cubelab rally --cell placed.toml --throws 20\n  cubelab place --one-way --yaw-deg 0 --height-m 0.2      # the first arm throws only, nothing turns\n\nTurns the bases of both arms and raises or lowers the second, at the given distance, until a place to catch exists for most of the\nballs that they throw to each other: a catch inside all limits for an arm that knows the flight for long. The partners cooperate.\nBefore and after are then judged with other throws than those of the search, with 95 % intervals of Wilson. If the placement\nthat was found is not better there, the cell stays as it is. Shifting a base sideways is the same as turning both: the arms\nstand on a line whose direction does not matter."
)]
pub struct Args {
    /// How the ball is caught.
    #[command(flatten)]
    catching: Catching,
    /// Distance of the bases, m; that of the cell otherwise.
    #[arg(long, value_name = "M", value_parser = within(0.5..=20.0, "m"))]
    distance_m: Option<f64>,
    /// Each base is turned by at most this much about its vertical axis, deg.
    #[arg(long, value_name = "DEG", default_value = "45", value_parser = within(0.0..=90.0, "deg"))]
    yaw_deg: f64,
    /// The second base is raised or lowered by at most this much, m.
    #[arg(long, value_name = "M", default_value = "0.2", value_parser = within(0.0..=0.5, "m"))]
    height_m: f64,
    /// The first arm throws only; the second one does not throw back.
    #[arg(long)]
    one_way: bool,
    /// Balls in each direction, for the search and for each judgement.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    throws: u32,
    /// Placements that are tried.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    tries: u32,
    /// Write the cell with the bases that were found, for `--cell`.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let cell = args.catching.cell()?;
    let cell = args.distance_m.map_or_else(|| cell.clone(), |distance_m| at_distance(&cell, distance_m));
    let mut options = args.catching.trial();
    options.cooperative = true;
    let seed = args.catching.seed;
    let search = Search {
        throws: args.throws as usize,
        tries: args.tries as usize,
        yaw_deg: args.yaw_deg,
        height_m: args.height_m,
        one_way: args.one_way,
        // The search must not use the throws that judge its result.
        seed: seed ^ (1 << 62),
    };
    let (found, files, judged) = while_working("place", "some minutes", |bar| {
        let say = |text: String| bar.suspend(|| console::note!("{text}"));
        say(format!("draws {} throws in each direction", args.throws));
        let found = find_place(&cell, &options, &search, |tried, placement, value| {
            let percent = 100.0 * value;
            say(format!(
                "{tried:3} of {} tried: at least {percent:.1} % with a place, {}",
                search.tries,
                text(placement)
            ));
        })
        .map_err(|why| refused(&why))?;
        // The judged cell is read from the text of the file.
        let mut files = Vec::new();
        let mut judged = Vec::new();
        for (name, placement) in [("before", Placement::default()), ("after", found)] {
            if name == "after" && placement == Placement::default() {
                break;
            }
            say(format!("judges {name} with other throws"));
            let (file, cell) = written(args, &placement.of(&cell))?;
            judged.push(judge(&cell, &options, &search, seed).map_err(|why| refused(&why))?);
            files.push(file);
        }
        Ok::<_, ExpectedError>((found, files, judged))
    })?;
    let better = judged.len() == 2 && all(&judged[1]).value() > all(&judged[0]).value();
    let kept = usize::from(better);
    if let Some(file) = &args.out {
        std::fs::write(file, &files[kept]).map_err(|e| ExpectedError::output(file, &e))?;
    }
    if args.json {
        let judged: Vec<_> = judged.iter().zip(["before", "after"]).collect();
        let judged = judged.iter().map(|(directions, name)| json!({"name": name, "directions": directions}));
        print_json(&json!({"found": found, "better": better, "judged": judged.collect::<Vec<_>>()}));
    } else {
        console::text!("{}", table(&judged));
        console::line!("found: {}", text(&found));
        if !better {
            console::line!("not better with other throws: the bases are not changed");
        }
        if let Some(file) = &args.out {
            console::line!("cell: {}", file.display());
        }
    }
    let wrong: usize = judged.iter().flatten().map(|judged| judged.wrong).sum();
    if wrong > 0 {
        let what = format!("{wrong} trials passed a limit or reported what did not happen");
        return Err(ExpectedError::new(exit::FINDINGS, what)
            .next("`cubelab rally --study 100 --cell FILE` shows in which setting"));
    }
    Ok(())
}

fn refused(why: &NoStudy) -> ExpectedError {
    ExpectedError::new(exit::NO_THROW, why.to_string()).next("set the arms nearer, with `--distance-m`")
}

/// Balls of all directions.
fn all(judged: &[Judged]) -> Share {
    judged.iter().fold(Share::default(), |Share { hits, of }, Judged { with_place, .. }| Share {
        hits: hits + with_place.hits,
        of: of + with_place.of,
    })
}

fn text(placement: &Placement) -> String {
    let Placement { yaw_deg: [first, second], height_m } = placement;
    format!("first base turned by {first} deg, second by {second} deg and raised by {height_m:.3} m")
}

fn table(judged: &[Vec<Judged>]) -> String {
    let share = |share: &Share| {
        let (low, high) = share.wilson();
        let percent = 100.0 * share.value();
        format!("{percent:5.1} % [{:.1}, {:.1}] of {}", 100.0 * low, 100.0 * high, share.of)
    };
    let mut out = String::new();
    for (name, directions) in ["before", "after"].into_iter().zip(judged) {
        for (k, judged) in directions.iter().enumerate() {
            let (from, to) = (k + 1, 2 - k);
            let Judged { with_place, caught, reasons, .. } = judged;
            out += &format!(
                "{name:6} arm {from} to arm {to}: with a place {}, caught {}\n",
                share(with_place),
                share(caught)
            );
            for (why, count) in reasons {
                out += &format!("         {count:4} without: {why}\n");
            }
        }
    }
    if let [before, after] = judged {
        let (before, after) = (all(before), all(after));
        let (low, high) = after.gain(&before);
        let by_chance = if low > 0.0 { "" } else { ": may be chance" };
        out += &format!(
            "in all: with a place {} before, {} after; a gain of {:.1} to {:.1} points{by_chance}\n",
            share(&before),
            share(&after),
            100.0 * low,
            100.0 * high
        );
    }
    out
}

/// Writes the bases of this cell into the text of the cell file. Returns the text, and the cell that a program reads from it.
fn written(args: &Args, cell: &TwoArmOptions) -> Result<(String, TwoArmOptions), ExpectedError> {
    let read = args.catching.cell.as_ref().map_or_else(
        || Ok(TWO_ARMS.to_owned()),
        |file| std::fs::read_to_string(file).map_err(|error| ExpectedError::bad_input(&error)),
    )?;
    let mut file: toml::Table =
        read.parse().map_err(|error: toml::de::Error| ExpectedError::bad_input(&error.to_string()))?;
    let arms = file.get_mut("arm").and_then(toml::Value::as_array_mut);
    for (table, arm) in arms.into_iter().flatten().zip(&cell.arms) {
        let Some(table) = table.as_table_mut() else { continue };
        let rounded = |value: f64| (1e6 * value).round() * 1e-6 + 0.0;
        let numbers = |values: [f64; 3]| toml::Value::from(values.map(rounded).to_vec());
        table.insert("base_m".to_owned(), numbers(arm.x_wb.pos.into()));
        table.insert("base_rpy_deg".to_owned(), numbers(arm.x_wb.rpy_rad().map(f64::to_degrees)));
    }
    let text = toml::to_string(&file).map_err(|error| ExpectedError::bad_input(&error))?;
    let cell =
        TwoArmOptions::from_toml("placed cell", &text).map_err(|error| ExpectedError::bad_input(&error))?;
    Ok((text, cell))
}
