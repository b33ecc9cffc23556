//! Time from a sample to a motion: estimate, forecast, search, check. Processor time of one thread, so that it may run beside others.
//!
//! `cargo bench -p operator --bench replan`; ends with 1 if the 99 % quantile of a setting passes 1 ms.

use std::cell::RefCell;

use hil_sim::two_arms::TwoArmOptions;
use lab::rally::throws::draw_throws;
use nix::time::{ClockId, clock_gettime};
use operator::ball_catch::trial::{Pair, TrialOptions};
use planner::catch::draw::Window;
use planner::catch::task::{Allowed, Settings};

const THROWS: usize = 60;
const P99_MAX_US: f64 = 1000.0;

fn thread_us() -> f64 {
    let now = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("a clock of Linux");
    now.tv_sec() as f64 * 1e6 + now.tv_nsec() as f64 * 1e-3
}

fn main() {
    let pair = Pair::new(TwoArmOptions::two_arms().expect("built in")).expect("arms that catch");
    let throws = draw_throws(&pair, &Window::default(), THROWS, 3).expect("throws exist");
    let mut slow = false;
    for (name, allowed, cooperative, jerk) in [
        ("uninformed, either", Allowed::Either, false, false),
        ("uninformed, matched", Allowed::Matched, false, false),
        ("cooperative, matched", Allowed::Matched, true, false),
        ("uninformed, either, with jerk limits", Allowed::Either, false, true),
    ] {
        let settings = Settings { allowed, ..Settings::default() };
        let options = TrialOptions { settings, cooperative, jerk, ..TrialOptions::default() };
        let times = RefCell::new(Vec::new());
        let mut judged = 0;
        for (k, aimed) in throws.iter().enumerate() {
            let outcome = pair.run_timed(aimed, &options, k as u64, |observe| {
                let begin = thread_us();
                observe();
                times.borrow_mut().push(thread_us() - begin);
            });
            judged = judged.max(outcome.log.iter().map(|logged| logged.count.judged).max().unwrap_or(0));
        }
        let mut times = times.into_inner();
        times.sort_by(f64::total_cmp);
        let at = |share: f64| times[((share * times.len() as f64) as usize).min(times.len() - 1)];
        println!(
            "{name:40} {} decisions: 50 % {:.0} us, 99 % {:.0} us, most {:.0} us; {judged} candidates at most",
            times.len(),
            at(0.5),
            at(0.99),
            at(1.0)
        );
        slow |= at(0.99) > P99_MAX_US;
    }
    if slow {
        std::process::exit(1);
    }
}
