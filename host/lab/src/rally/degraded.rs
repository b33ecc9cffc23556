//! What can go wrong in a throw and its catch, one fault at a time.

use hil_sim::two_arms::TwoArmOptions;
use operator::ball_catch::thrower::ThrowFault;
use operator::ball_catch::trial::{TrialFault, TrialOptions};

/// Options of the trial with this number.
pub type TrialOf = Box<dyn Fn(usize) -> TrialOptions + Sync>;

/// Every fault with its cell and its trials. Catches of either kind, eyes only if nothing else is said.
pub fn degradations(cell: &TwoArmOptions) -> Vec<(&'static str, TwoArmOptions, TrialOf)> {
    let base = TrialOptions::default;
    // Moments spread evenly by the golden ratio: each throw has its own.
    let spread = |k: usize, low: f64, high: f64| low + (high - low) * (k as f64 * 0.618_034).fract();
    let with =
        |fault: TrialFault| -> TrialOf { Box::new(move |_| TrialOptions { faults: vec![fault], ..base() }) };
    let slow = |change: &dyn Fn(&mut TwoArmOptions)| {
        let mut cell = cell.clone();
        change(&mut cell);
        cell
    };
    let plain = || -> TrialOf { Box::new(move |_| base()) };
    let drag =
        |factor: f64| -> TrialOf { Box::new(move |_| TrialOptions { drag: (factor, 0.02), ..base() }) };
    let same = || cell.clone();
    vec![
        ("nothing", same(), plain()),
        ("latency doubled", slow(&|c| c.tracker.latency = c.tracker.latency + c.tracker.latency), plain()),
        ("60 Hz", slow(&|c| c.tracker.period = c.tracker.period + c.tracker.period), plain()),
        ("one frame in ten lost", same(), with(TrialFault::FramesLost { probability: 0.1 })),
        ("bias 2 mm", same(), with(TrialFault::Bias { by_mm: 2.0 })),
        ("three false markers", same(), with(TrialFault::FalseMarkers { count: 3 })),
        ("drag believed 20 % too small", same(), drag(0.8)),
        ("drag believed 20 % too large", same(), drag(1.2)),
        (
            "tracker dead at some moment",
            same(),
            Box::new(move |k| TrialOptions {
                faults: vec![TrialFault::TrackerDead { at_s: spread(k, 0.0, 0.9) }],
                ..base()
            }),
        ),
        (
            "thrower stops before the release, plan known",
            same(),
            Box::new(move |k| TrialOptions {
                faults: vec![TrialFault::Throw(ThrowFault::Stops { before_s: spread(k, 0.02, 0.4) })],
                cooperative: true,
                ..base()
            }),
        ),
        (
            "ball not released, plan known",
            same(),
            Box::new(move |_| TrialOptions {
                faults: vec![TrialFault::Throw(ThrowFault::NotReleased)],
                cooperative: true,
                ..base()
            }),
        ),
        ("ball not released", same(), with(TrialFault::Throw(ThrowFault::NotReleased))),
        (
            "catcher's drive lost at some moment",
            same(),
            Box::new(move |k| TrialOptions {
                faults: vec![TrialFault::DriveLost { at_s: spread(k, -0.2, 0.9) }],
                ..base()
            }),
        ),
    ]
}
