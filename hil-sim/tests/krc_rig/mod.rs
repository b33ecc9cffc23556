//! A controller on the bench, and a client written for these tests only.

use std::sync::LazyLock;

use hil_sim::krc::options::{KrcOptions, Space};
use hil_sim::krc::{
    Bench, Client, DatagramLink, FaultCause, Krc, KrcEvent, LinkFault, LinkOptions, Reply, RobotFault, State,
};
use protocol::{Duration, Instant};
use robot_model::RobotModel;
use rsi_protocol::{Config, Generation};

pub(crate) static ARM: LazyLock<RobotModel> = LazyLock::new(|| RobotModel::load("kr16_2").expect("built in"));

pub(crate) const MS: fn(u64) -> Instant = |ms| Instant::from_micros(ms * 1000);

/// A configuration file with axis or Cartesian corrections.
pub(crate) fn config(protocol: &str, space: Space, hold: bool) -> Config {
    let (name, names) = match space {
        Space::Axes => ("AK", ["A1", "A2", "A3", "A4", "A5", "A6"]),
        Space::Base | Space::Tool => ("RKorr", ["X", "Y", "Z", "A", "B", "C"]),
    };
    let hold = u8::from(hold);
    let corrections: String = (1..)
        .zip(names)
        .map(|(n, axis)| {
            format!("<ELEMENT TAG=\"{name}.{axis}\" TYPE=\"DOUBLE\" INDX=\"{n}\" HOLDON=\"{hold}\"/>")
        })
        .collect();
    let sent: String = ["RIst", "RSol", "AIPos", "ASPos", "Delay"]
        .map(|tag| format!("<ELEMENT TAG=\"DEF_{tag}\" TYPE=\"DOUBLE\" INDX=\"INTERNAL\"/>"))
        .concat();
    let text = format!(
        "<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>49152</PORT><PROTOCOL>{protocol}</PROTOCOL>\
         <SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>\
         <SEND><ELEMENTS>{sent}</ELEMENTS></SEND><RECEIVE><ELEMENTS>\
         <ELEMENT TAG=\"DEF_EStr\" TYPE=\"STRING\" INDX=\"INTERNAL\"/>{corrections}\
         <ELEMENT TAG=\"DiO\" TYPE=\"LONG\" INDX=\"7\" HOLDON=\"1\"/>\
         <ELEMENT TAG=\"Stop\" TYPE=\"BOOL\" INDX=\"8\" HOLDON=\"0\"/></ELEMENTS></RECEIVE></ROOT>"
    );
    Config::parse(&text).expect("valid")
}

/// Options without narrow limits of motion, so that only the limit under test acts.
pub(crate) fn wide(generation: Generation) -> KrcOptions {
    let mut options = KrcOptions::new(generation);
    options.correction.lower = [-300.0; 6];
    options.correction.upper = [300.0; 6];
    options.correction.overall_axis_deg = 1e6;
    options.correction.overall_mm = 1e6;
    options.correction.overall_rotation_deg = 1e6;
    options.cut_out.velocity_deg_s = Some([1e9; 6]);
    options.cut_out.acceleration_deg_s2 = [1e12; 6];
    options.cut_out.jerk_deg_s3 = [1e15; 6];
    options
}

/// Reads a number between two marks.
pub(crate) fn between<'a>(text: &'a str, before: &str, after: &str) -> Option<&'a str> {
    text.split_once(before)?.1.split_once(after).map(|(found, _)| found)
}

/// What the scripted client answers in one cycle.
#[derive(Clone, Debug, Default)]
pub(crate) struct Answer {
    pub(crate) correction: [f64; 6],
    pub(crate) outputs: i32,
    pub(crate) stop: bool,
    pub(crate) after: Duration,
    pub(crate) silent: bool,
    pub(crate) ipoc_off: i64,
    pub(crate) text: Option<&'static str>,
}

/// Answers each telegram with the result of `script` for the number of full telegrams so far (from 0).
pub(crate) struct Scripted<F> {
    pub(crate) element: &'static str,
    pub(crate) names: [&'static str; 6],
    pub(crate) script: F,
    pub(crate) received: Vec<(Instant, String)>,
    pub(crate) full: u64,
    pub(crate) bytes: Vec<u8>,
}

impl<F: FnMut(u64) -> Answer> Client for Scripted<F> {
    fn handle(&mut self, now: Instant, bytes: &[u8]) -> Vec<Reply> {
        self.bytes.extend_from_slice(bytes);
        let text = String::from_utf8_lossy(bytes).into_owned();
        let ipoc = between(&text, "<IPOC>", "</IPOC>").map(str::to_owned);
        let full = text.contains("<AIPos");
        self.received.push((now, text));
        let Some(ipoc) = ipoc.and_then(|digits| digits.parse::<u64>().ok()) else { return Vec::new() };
        if !full {
            return Vec::new();
        }
        let answer = (self.script)(self.full);
        self.full += 1;
        if answer.silent {
            return Vec::new();
        }
        let values: String = self
            .names
            .iter()
            .zip(answer.correction)
            .map(|(name, value)| format!(" {name}=\"{value:.6}\""))
            .collect();
        let text = answer.text.map(|text| format!("<EStr>{text}</EStr>")).unwrap_or_default();
        let bytes = format!(
            "<Sen Type=\"ImFree\">{text}<{}{values}/><DiO>{}</DiO><Stop>{}</Stop><IPOC>{}</IPOC></Sen>",
            self.element,
            answer.outputs,
            u8::from(answer.stop),
            ipoc.wrapping_add_signed(answer.ipoc_off),
        );
        vec![Reply { after: answer.after, bytes: bytes.into_bytes() }]
    }
}

pub(crate) struct Rig {
    pub(crate) options: KrcOptions,
    pub(crate) config: Config,
    pub(crate) link: LinkOptions,
    pub(crate) link_faults: Vec<LinkFault>,
    pub(crate) robot_faults: Vec<RobotFault>,
    pub(crate) seed: u64,
}

impl Rig {
    pub(crate) fn new(options: KrcOptions) -> Self {
        let config = config("UDP", options.correction.space, true);
        Self {
            options,
            config,
            link: LinkOptions::default(),
            link_faults: Vec::new(),
            robot_faults: Vec::new(),
            seed: 1,
        }
    }

    /// On the bench, program started at time zero.
    pub(crate) fn start<F: FnMut(u64) -> Answer>(self, script: F) -> Bench<Scripted<F>> {
        let space = self.options.correction.space;
        let krc = Krc::new(ARM.clone(), self.config, self.options, self.seed).expect("the options fit");
        let (element, names) = match space {
            Space::Axes => ("AK", ["A1", "A2", "A3", "A4", "A5", "A6"]),
            Space::Base | Space::Tool => ("RKorr", ["X", "Y", "Z", "A", "B", "C"]),
        };
        let client = Scripted { element, names, script, received: Vec::new(), full: 0, bytes: Vec::new() };
        let link = DatagramLink::new(self.link, &self.link_faults, self.seed);
        let mut bench = Bench::new(krc, link, &self.robot_faults, client);
        bench.start();
        bench
    }
}

/// The first fault and its time.
pub(crate) fn fault(events: &[KrcEvent]) -> Option<(Instant, FaultCause)> {
    events.iter().find_map(|event| match event {
        KrcEvent::Fault { at, cause } => Some((*at, *cause)),
        _ => None,
    })
}

/// Words of all refused answers, in order.
pub(crate) fn refused(events: &[KrcEvent]) -> Vec<&'static str> {
    let word = |event: &KrcEvent| match event {
        KrcEvent::Refused { why, .. } => Some(why.name()),
        _ => None,
    };
    events.iter().filter_map(word).collect()
}

pub(crate) fn running<C>(bench: &Bench<C>) -> bool
where
    C: Client,
{
    bench.krc.state() == State::Run
}
