//! Refusals of the search for a catch against an exhaustive slow search, with the whole motion judged.
//!
//! `cargo run --release -p planner --example catch_refusals -- 200 3`: number of refusals, seed.

use std::collections::BTreeMap;

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/catch_rig/mod.rs"]
mod catch_rig;

fn main() {
    let mut words = std::env::args().skip(1);
    let mut number = |standard: u64| {
        words
            .next()
            .map_or(standard, |word| word.parse().expect("a number: catch_refusals [REFUSALS [SEED]]"))
    };
    let (wanted, seed) = (number(200), number(3));
    let (refusals, taken) = catch_rig::refusals(&catch_rig::arm(false), wanted as usize, seed);
    let mut by_reason: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    for refusal in &refusals {
        let (of, wrong) = by_reason.entry(refusal.why.to_string()).or_default();
        *of += 1;
        *wrong += usize::from(refusal.wrong);
        if refusal.wrong {
            println!("{refusal}");
        }
    }
    for (why, (of, wrong)) in &by_reason {
        println!("{wrong:3} of {of:3} wrong: {why}");
    }
    let wrong = refusals.iter().filter(|refusal| refusal.wrong).count();
    println!("{wrong} of {} refusals wrong; {taken} catches found; seed {seed}", refusals.len());
}
