//! Random throws. `cubelab swarm` runs more of them and looks for the smallest scenario.

use lab::trust::Swarm;
use rayon::prelude::*;

#[test]
fn random_throws_break_no_rule() {
    let swarm = Swarm::new().unwrap();
    let wrong: Vec<String> = (0..40_u64)
        .into_par_iter()
        .filter_map(|seed| {
            let verdict = swarm.run(&swarm.draw(seed).unwrap());
            (!verdict.ok())
                .then(|| format!("seed {seed}: reported {}; {:?}", verdict.reported, verdict.findings))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}
