//! What a call of the controller costs on this machine: `cargo bench -p firmware`.
//!
//! A whole throw over the host link (start-up, upload, arming, run; the emulated board plays the same script) is
//! recorded once and played many times; each call's time is the median over the plays. To take the frames that a
//! call sends is part of its time. Nothing is asserted.

#[path = "../tests/bench/mod.rs"]
#[allow(dead_code, unused_imports, reason = "made for the tests")]
mod bench;

use std::hint::black_box;
use std::time::Instant as Clock;

use bench::Options;
use bench::host::{Call, Host};
use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::groups::powercube::PowerCubes;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use protocol::cyphal::cubecell::command;
use protocol::{Instant, Node};

const PLAYS: usize = 41;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Step,
    RunningFrame,
    Other,
}

fn node() -> ControllerNode<RamStorage, Spline, PowerCubes> {
    ControllerNode::new(
        Instant::ZERO,
        RamStorage::new(),
        &Options::default().settings,
        Default::default(),
        Seed::FORESEEABLE,
    )
}

/// Time of each call, ns, and of which kind it is.
fn play(calls: &[Call]) -> Vec<(Kind, f64)> {
    let mut node = node();
    calls
        .iter()
        .map(|call| {
            let cycles = node.controller().counters().cycles;
            let start = Clock::now();
            match &call.input {
                Some(frame) => node.handle_frame(call.at, black_box(frame)),
                None => node.handle_timeout(call.at),
            }
            while let Some(frame) = node.poll_frame() {
                black_box(frame);
            }
            let ns = start.elapsed().as_secs_f64() * 1e9;
            let running = node.controller().state().kind() == StateKind::Running;
            let kind = match (&call.input, node.controller().counters().cycles != cycles) {
                (None, true) => Kind::Step,
                (Some(_), _) if running => Kind::RunningFrame,
                _ => Kind::Other,
            };
            (kind, ns)
        })
        .collect()
}

fn main() {
    let mut host = Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.run(1_600_000, |_, _| {});
    let calls = host.bench.controller.calls;
    let plays: Vec<Vec<(Kind, f64)>> = (0..PLAYS).map(|_| play(&calls)).collect();
    let median = |index: usize| {
        let mut ns: Vec<f64> = plays.iter().map(|play| play[index].1).collect();
        ns.sort_by(f64::total_cmp);
        ns[PLAYS / 2]
    };
    for (kind, what) in [
        (Kind::Step, "control step of six joints"),
        (Kind::RunningFrame, "frame while running"),
        (Kind::Other, "any other call"),
    ] {
        let mut ns: Vec<f64> =
            (0..calls.len()).filter(|&index| plays[0][index].0 == kind).map(median).collect();
        ns.sort_by(f64::total_cmp);
        println!(
            "{what:<28} {:5} calls   median {:7.0} ns   99 % {:7.0} ns   longest {:7.0} ns",
            ns.len(),
            ns[ns.len() / 2],
            ns[ns.len() * 99 / 100],
            ns[ns.len() - 1]
        );
    }
}
