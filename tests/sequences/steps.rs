//! What can happen to a controller, and how a sequence of it is drawn.

use hil_sim::rng::Rng;

/// One step: wait so many milliseconds, then this happens.
pub(crate) type Step = (u16, Act);

/// Node that sends an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Who {
    /// The host that gives all other orders.
    Host,
    /// Another node.
    Other,
}

/// What is written to a register; one of each class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Register {
    /// `watchdog.prove`.
    Prove(bool),
    /// `watchdog.enable`.
    Watchdog(bool),
    /// `cycle.monitor_us`.
    MonitorUs(u32),
    /// `telemetry.period_us`.
    TelemetryUs(u32),
    /// `estimator.alpha`.
    Alpha(f32),
    /// `joint.q_max_rad` of both joints.
    QMax(f32),
    /// `joint.v_max_rad_s` of both joints.
    VMax(f32),
    /// `joint.current_max_a` of both joints.
    Current(f32),
}

/// What happens to the gripper in a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hand {
    Nothing,
    /// It opens at this time, ms.
    Open(u16),
    /// It closes at this time, ms, and opens so much later that both switchings are due at once.
    CloseAndOpen(u16),
}

/// What happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Act {
    /// Homes the joints of a mask.
    Home(u8),
    /// Jogs joint `joint` at `mrad_s` for `hold_ms`, or goes on with it.
    Jog {
        joint: u8,
        mrad_s: i16,
        hold_ms: u16,
    },
    /// Lets a jogged joint go.
    LetGo(u8),
    Stop(Who),
    StopMessage(Who),
    EmergencyStop(Who),
    Disarm(Who),
    /// Clears the fault that was seen, or another one.
    Clear {
        right: bool,
    },
    Write(Register),
    /// Uploads a plan that begins where the joints are and ends at `mrad` after `ms`.
    Upload {
        mrad: [i16; 2],
        ms: u16,
        hand: Hand,
    },
    Commit,
    Prepare,
    Confirm,
    Run,
    /// Runs the plan `ms` from now.
    RunIn {
        ms: u16,
    },
    Gripper(bool),
    /// A drive loses its power and gets it back.
    Restart(u8),
    /// A drive hears nothing for so many milliseconds.
    Deaf {
        drive: u8,
        ms: u16,
    },
    /// The host asks for so many long answers at once.
    Questions(u8),
    /// Another node sends so many urgent frames at once.
    Babble(u8),
    /// The controller is not called for so many milliseconds.
    Late(u16),
    /// The host sends no heartbeat for so many milliseconds.
    Silent(u16),
    /// Nothing.
    Wait,
}

fn wait(rng: &mut Rng) -> u16 {
    (match rng.below(20) {
        0..4 => 0,
        4..11 => rng.within(1, 20),
        11..18 => rng.within(20, 150),
        _ => rng.within(150, 600),
    }) as u16
}

fn who(rng: &mut Rng) -> Who {
    if rng.chance(0.5) { Who::Host } else { Who::Other }
}

fn joint(rng: &mut Rng) -> u8 {
    rng.below(2) as u8
}

fn speed(rng: &mut Rng) -> i16 {
    let speed = [50, 120, 200, 250][rng.below(4) as usize];
    if rng.chance(0.5) { speed } else { -speed }
}

fn register(rng: &mut Rng) -> Register {
    match rng.below(12) {
        0 | 1 => Register::Prove(rng.chance(0.5)),
        2..5 => Register::Watchdog(rng.chance(0.7)),
        5 => Register::MonitorUs([5_000, 10_000, 20_000][rng.below(3) as usize]),
        6 => Register::TelemetryUs([20_000, 100_000][rng.below(2) as usize]),
        7 if rng.chance(0.2) => Register::Alpha(0.5),
        7 | 8 => Register::QMax([0.3, 0.8, 1.0, 1.5][rng.below(4) as usize]),
        9 | 10 => Register::VMax([1.5, 2.6, 5.0][rng.below(3) as usize]),
        _ => Register::Current([20.0, 30.0, 50.0][rng.below(3) as usize]),
    }
}

fn hand(rng: &mut Rng) -> Hand {
    match rng.below(4) {
        0 | 1 => Hand::Nothing,
        2 => Hand::Open(rng.within(10, 500) as u16),
        _ => Hand::CloseAndOpen(rng.within(50, 400) as u16),
    }
}

/// One act on its own.
fn single(rng: &mut Rng) -> Act {
    match rng.below(60) {
        0..3 => Act::Home(rng.within(1, 3) as u8),
        3..8 => Act::Jog { joint: joint(rng), mrad_s: speed(rng), hold_ms: rng.within(20, 300) as u16 },
        8..10 => Act::LetGo(joint(rng)),
        10..14 => Act::Stop(who(rng)),
        14..18 => Act::StopMessage(who(rng)),
        18..20 => Act::EmergencyStop(who(rng)),
        20..22 => Act::Disarm(who(rng)),
        22..30 => Act::Clear { right: rng.chance(0.8) },
        30..35 => Act::Write(register(rng)),
        35 => Act::Commit,
        36..38 => Act::Prepare,
        38..41 => Act::Confirm,
        41..43 => Act::Run,
        43..45 => Act::RunIn { ms: rng.within(10, 400) as u16 },
        45..47 => Act::Gripper(rng.chance(0.5)),
        47 => Act::Restart(joint(rng)),
        48..50 => Act::Deaf { drive: joint(rng), ms: rng.within(1, 30) as u16 },
        50..54 => Act::Questions(rng.within(3, 14) as u8),
        54..56 => Act::Babble(rng.within(10, 60) as u8),
        56..58 => Act::Late(rng.within(5, 80) as u16),
        58 => Act::Silent(rng.within(50, 200) as u16),
        _ => Act::Wait,
    }
}

/// What comes between two acts that belong together.
fn interruption(rng: &mut Rng) -> Act {
    match rng.below(8) {
        0 => Act::Stop(who(rng)),
        1 | 2 => Act::StopMessage(who(rng)),
        3 => Act::EmergencyStop(who(rng)),
        4 => Act::Questions(rng.within(3, 14) as u8),
        5 => Act::Late(rng.within(5, 80) as u16),
        _ => single(rng),
    }
}

/// Clears what may be latched, and waits for the drives to be found.
fn recover(rng: &mut Rng, steps: &mut Vec<Step>) {
    steps.push((wait(rng), Act::Clear { right: true }));
    steps.push((rng.within(100, 400) as u16, Act::Wait));
}

/// Acts that belong together: an arming with a run, a jog by repetition, a homing that gets its time.
fn phrase(rng: &mut Rng, steps: &mut Vec<Step>) {
    match rng.below(10) {
        0..5 => {
            let mrad = std::array::from_fn(|_| rng.within(0, 1_200) as i16 - 450);
            let ms = rng.within(900, 2_000) as u16;
            let start_ms = rng.chance(0.5).then(|| rng.within(30, 200) as u16);
            match rng.below(10) {
                0..3 => steps.push((wait(rng), Act::Stop(who(rng)))),
                3..8 => recover(rng, steps),
                _ => {}
            }
            steps.push((wait(rng), Act::Upload { mrad, ms, hand: hand(rng) }));
            let run = start_ms.map_or(Act::Run, |ms| Act::RunIn { ms });
            for act in [Act::Commit, Act::Prepare, Act::Confirm, Act::Confirm, run] {
                if rng.chance(0.09) {
                    steps.push((rng.within(0, 30) as u16, interruption(rng)));
                }
                let pause = if act == Act::Confirm && rng.chance(0.15) {
                    // A stop takes an offer back, also where nothing moves. The drives have shown that they are ready, and have
                    // not yet shown that they are halted again.
                    steps.push((rng.within(60, 250) as u16, Act::StopMessage(who(rng))));
                    rng.within(0, 60)
                } else if act == Act::Confirm {
                    rng.within(50, 250)
                } else {
                    rng.within(5, 60)
                };
                steps.push((pause as u16, act));
            }
            if let Some(start_ms) = start_ms.filter(|_| rng.chance(0.3)) {
                // Not called from shortly before the start on.
                steps.push((
                    start_ms.saturating_sub(rng.within(25, 70) as u16),
                    Act::Late(rng.within(40, 90) as u16),
                ));
            } else if rng.chance(0.3) {
                steps.push((rng.within(0, u64::from(ms)) as u16, interruption(rng)));
            } else if rng.chance(0.4) {
                // A stop behind questions whose answers fill the queue.
                steps.push((
                    rng.within(50, u64::from(ms) / 2) as u16,
                    Act::Questions(rng.within(6, 14) as u8),
                ));
                steps.push((rng.within(0, 3) as u16, Act::Stop(who(rng))));
                steps.push((ms, Act::Wait));
            } else if rng.chance(0.5) {
                steps.push((ms + start_ms.unwrap_or(0), Act::Wait));
            }
        }
        5..9 => {
            let (joint, mrad_s, hold_ms) = (joint(rng), speed(rng), rng.within(60, 200) as u16);
            if rng.chance(0.4) {
                recover(rng, steps);
            }
            for _ in 0..rng.within(2, 8) {
                steps.push((rng.within(20, 60) as u16, Act::Jog { joint, mrad_s, hold_ms }));
            }
            match rng.below(4) {
                0 | 1 => steps.push((rng.within(0, 60) as u16, Act::LetGo(joint))),
                2 => steps.push((rng.within(0, 60) as u16, interruption(rng))),
                _ => {}
            }
            if rng.chance(0.5) {
                steps.push((rng.within(300, 600) as u16, Act::Wait));
            }
        }
        _ => {
            recover(rng, steps);
            steps.push((wait(rng), Act::Home(3)));
            steps.push((rng.within(500, 4_000) as u16, Act::Wait));
        }
    }
}

/// Angles at which the joints begin, mrad; and `steps` steps, a few more at most.
pub(crate) fn draw(seed: u64, count: usize) -> ([i16; 2], Vec<Step>) {
    let mut rng = Rng::stream(seed, "sequence");
    let start = std::array::from_fn(|_| match rng.below(4) {
        0 if rng.chance(0.5) => rng.within(1_000, 1_250) as i16,
        1 if rng.chance(0.5) => -(rng.within(400, 750) as i16),
        _ => rng.within(50, 900) as i16,
    });
    let mut steps = Vec::new();
    while steps.len() < count {
        if rng.chance(0.3) {
            phrase(&mut rng, &mut steps);
        } else {
            steps.push((wait(&mut rng), single(&mut rng)));
        }
    }
    (start, steps)
}
