//! Scenarios that once broke a rule, each a test of its own.
//!
//! `cubelab swarm` writes such files; one that is put into `scenarios/` is picked up by the next build. Its name becomes
//! the name of the test and says which behaviour it shows.

use std::sync::LazyLock;

use hil_sim::scenario::Scenario;
use lab::trust::Swarm;

static SWARM: LazyLock<Swarm> = LazyLock::new(|| Swarm::new().unwrap());

fn keeps_every_rule(name: &str, text: &str) {
    let scenario = Scenario::from_toml(name, text).unwrap();
    let verdict = SWARM.run(&scenario);
    assert!(verdict.ok(), "{name}: reported {}; {:#?}", verdict.reported, verdict.findings);
}

include!(concat!(env!("OUT_DIR"), "/scenarios.rs"));
