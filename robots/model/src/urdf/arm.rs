//! Selects the joints of a URDF tree that form the arm. All others are held at zero, and their links belong to the body that
//! carries them.

use super::tree::{Reader, UrdfError, UrdfProblem, UrdfTree};

/// Fewest joints of an arm: fingers come behind them.
const JOINTS_MIN: usize = 4;
/// Most joints of an arm.
const JOINTS_MAX: usize = 7;
/// Parts of names by which the joint of a gripper is known, if nothing else shows it.
const OF_HANDS: [&str; 5] = ["gripper", "finger", "jaw", "thumb", "knuckle"];

/// The joints of the arm, base first.
pub(super) fn joints(
    reader: &Reader<'_>,
    tree: &UrdfTree,
    root: usize,
    end: Option<&str>,
) -> Result<Vec<usize>, UrdfError> {
    let chain = match end {
        Some(name) => up_from(reader, tree, name)?,
        None => down_from(reader, tree, root)?,
    };
    if chain.is_empty() {
        return Err(reader.error(tree.links[root].line, UrdfProblem::NoJoints));
    }
    if let Some(next) = chain.get(JOINTS_MAX) {
        let last = tree.links[tree.joints[chain[JOINTS_MAX - 1]].child].name.clone();
        let problem = UrdfProblem::TooManyJoints { found: chain.len(), max: JOINTS_MAX, last };
        return Err(reader.error(tree.joints[*next].line, problem));
    }
    Ok(chain)
}

/// From the link that ends the arm to the base.
fn up_from(reader: &Reader<'_>, tree: &UrdfTree, name: &str) -> Result<Vec<usize>, UrdfError> {
    let found = tree.links.iter().position(|link| link.name == name);
    let mut link = found.ok_or_else(|| {
        let there = tree.links.iter().map(|link| link.name.clone()).collect();
        reader.error(1, UrdfProblem::NoSuchEndEffector { wanted: name.to_owned(), there })
    })?;
    let mut chain = Vec::new();
    let mut foreign = None;
    while let Some((k, joint)) = tree.joints.iter().enumerate().find(|(_, joint)| joint.child == link) {
        // A lift below the arm and a finger behind it are held where they are; a slide in the arm is refused.
        if joint.turn.is_some() {
            if let Some(refusal) = foreign {
                return Err(refusal);
            }
            chain.push(k);
        } else if !chain.is_empty() {
            foreign = foreign.or_else(|| reader.foreign(joint));
        }
        link = joint.parent;
    }
    chain.reverse();
    Ok(chain)
}

/// Follows the chain from the base. Where several joints continue it, it takes the only one with enough joints behind it.
fn down_from(reader: &Reader<'_>, tree: &UrdfTree, root: usize) -> Result<Vec<usize>, UrdfError> {
    let mut chain = Vec::new();
    let mut link = root;
    loop {
        let mut starts = Vec::new();
        moving_from(tree, link, &mut starts);
        let next = match starts[..] {
            [] => return Ok(chain),
            [only] => {
                let joint = &tree.joints[only];
                let name = joint.name.to_lowercase();
                let of_hand = joint.foreign.is_some() || OF_HANDS.iter().any(|part| name.contains(part));
                if chain.len() >= JOINTS_MIN && of_hand {
                    return Ok(chain);
                }
                if let Some(refusal) = reader.foreign(joint) {
                    return Err(refusal);
                }
                only
            }
            _ if chain.len() >= JOINTS_MIN => return Ok(chain),
            _ => {
                let long = |k: &&usize| chain.len() + longest_from(tree, **k) >= JOINTS_MIN;
                let long: Vec<usize> = starts.iter().filter(long).copied().collect();
                let [only] = long[..] else {
                    let (first, second) = (&tree.joints[starts[0]], &tree.joints[starts[1]]);
                    let joints = vec![first.name.clone(), second.name.clone()];
                    let link = tree.links[link].name.clone();
                    return Err(reader.error(second.line, UrdfProblem::Branch { link, joints }));
                };
                only
            }
        };
        chain.push(next);
        link = tree.joints[next].child;
    }
}

/// Joints that move from a link or from what is fixed to it.
fn moving_from(tree: &UrdfTree, link: usize, found: &mut Vec<usize>) {
    for (k, joint) in tree.joints.iter().enumerate().filter(|(_, joint)| joint.parent == link) {
        if joint.turn.is_some() || joint.foreign.is_some() {
            found.push(k);
        } else {
            moving_from(tree, joint.child, found);
        }
    }
}

/// Most joints of an arm in a row from this one on.
fn longest_from(tree: &UrdfTree, k: usize) -> usize {
    let joint = &tree.joints[k];
    if joint.foreign.is_some() {
        return 0;
    }
    let behind = tree.joints.iter().enumerate().filter(|(_, next)| next.parent == joint.child);
    usize::from(joint.turn.is_some()) + behind.map(|(k, _)| longest_from(tree, k)).max().unwrap_or(0)
}
