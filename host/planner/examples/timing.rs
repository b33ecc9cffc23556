//! Durations of motions along random paths and between random poses, one JSON object a line, for `oracle/timing.py`.
//!
//! ```sh
//! cargo run --release -p planner --example timing -- 200 1000 > timing.jsonl
//! ```

use std::time::Instant;

use planner::motion::Motion;
use planner::plan::rng::SplitMix64;
use planner::timing::{Limits, Path, along, straight};
use serde_json::json;

const JOINTS: usize = 6;
/// Places at which the geometry of a path is given.
const PLACES: usize = 600;

fn main() {
    let mut counts = std::env::args().skip(1).map(|count| count.parse::<usize>().unwrap_or(0));
    let (paths, lines) = (counts.next().unwrap_or(200), counts.next().unwrap_or(1000));
    let mut rng = SplitMix64::new(1);
    let (v, a, j) = ([2.6; JOINTS], [10.4; JOINTS], [104.0; JOINTS]);
    let free = Limits::new(&v, &a, &[f64::INFINITY; JOINTS]).expect("positive");
    let smooth = Limits::new(&v, &a, &j).expect("positive");
    let pose = |rng: &mut SplitMix64| -> Vec<f64> { (0..JOINTS).map(|_| 4.0 * rng.unit() - 2.0).collect() };
    for k in 0..paths {
        let points: Vec<Vec<f64>> = (0..2 + k % 7).map(|_| pose(&mut rng)).collect();
        let path = Path::through(&points, 0.3).expect("a path");
        let timed = |limits: &Limits| {
            let begun = Instant::now();
            let motion: Option<Motion> = along(&path, limits);
            (motion.map(|motion| (motion.duration_s(), motion.knots.len())), begun.elapsed().as_secs_f64())
        };
        let (no_jerk, took_s) = timed(&free);
        let (with_jerk, took_jerk_s) = timed(&smooth);
        let s: Vec<f64> = (0..=PLACES).map(|i| path.length() * i as f64 / PLACES as f64).collect();
        let q: Vec<Vec<f64>> = s.iter().map(|s| path.angles(*s)).collect();
        println!(
            "{}",
            json!({ "kind": "path", "v": v, "a": a, "j": j, "s": s, "q": q, "without_jerk": no_jerk, "took_s": took_s,
                    "with_jerk": with_jerk, "took_jerk_s": took_jerk_s })
        );
    }
    for _ in 0..lines {
        let (from, to) = (pose(&mut rng), pose(&mut rng));
        let begun = Instant::now();
        let motion: Option<Motion> = straight(&from, &to, &smooth);
        let took_s = begun.elapsed().as_secs_f64();
        let duration_s = motion.map(|motion| motion.duration_s());
        println!(
            "{}",
            json!({ "kind": "line", "v": v, "a": a, "j": j, "from": from, "to": to, "duration_s": duration_s, "took_s": took_s })
        );
    }
}
