//! `cubectl controller key make|set|remove`

use std::path::PathBuf;

use protocol::cyphal::cubecell::command::{UNLOCK, Unlock};
use protocol::cyphal::id::NodeId;

use crate::cmd::target::Target;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::entropy;
use operator::bus::key_file::{make, read_bytes};
use operator::bus::{BusFailure, Session};

/// What to do with the key of a controller.
#[derive(Debug, clap::Subcommand)]
pub enum KeyVerb {
    /// Make a file with a new random key, for its owner only.
    Make(MakeArgs),
    /// Give a controller a key. From then on it wants a code of it for every order that can move the arm.
    Set(SetArgs),
    /// Take the key away. Needs the key.
    Remove(RemoveArgs),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl controller key make arm.key")]
pub struct MakeArgs {
    /// Where to. A file that exists is not overwritten.
    pub file: PathBuf,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller key set arm.key --bus can0\n  cubectl controller key set new.key --key-file arm.key --bus can0\n\nThe key goes over the bus as it is: set it on a bus with nobody else on it. SECURITY.md says what a key protects\nagainst."
)]
pub struct SetArgs {
    /// File with the new key.
    pub file: PathBuf,
    #[command(flatten)]
    pub target: Target,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl controller key remove --key-file arm.key --bus can0\n\nA lost key: delete the storage file of a controller that runs as a program; the STM32 board forgets its key when\nit is switched off."
)]
pub struct RemoveArgs {
    #[command(flatten)]
    pub target: Target,
}

pub fn run(verb: &KeyVerb) -> Result<(), ExpectedError> {
    match verb {
        KeyVerb::Make(args) => {
            make(&args.file, &entropy::bytes()?)?;
            console::line!("{}: a new key, for its owner only", args.file.display());
            Ok(())
        }
        KeyVerb::Set(args) => {
            let bytes = read_bytes(&args.file).map_err(BusFailure::from)?;
            let (mut session, node) = args.target.open()?;
            session.write_key(node, &bytes)?;
            session.set_key(Some(firmware::authority::Key::new(bytes)));
            let fits = session.is_keyed(node)? && proves(&mut session, node).is_ok();
            session.finish()?;
            if !fits {
                return Err(refused("the controller did not take the key; it has the one it had"));
            }
            console::line!("controller {}: the key of {} is set", node.get(), args.file.display());
            Ok(())
        }
        KeyVerb::Remove(args) => {
            let (mut session, node) = args.target.open()?;
            session.write_key(node, &[])?;
            let keyed = session.is_keyed(node)?;
            session.finish()?;
            if keyed {
                return Err(refused("the controller kept its key"));
            }
            console::line!("controller {}: has no key; any node may give it orders", node.get());
            Ok(())
        }
    }
}

fn refused(what: &str) -> ExpectedError {
    ExpectedError::new(exit::DRIVE, what.to_string()).next(
        "name the key it has with --key-file; nothing may be armed or move, and no other node may \
             hold an offer to arm",
    )
}

/// An order that changes nothing, with a code of the session's key: the controller takes it only if it has that key.
fn proves(session: &mut Session, node: NodeId) -> Result<(), ExpectedError> {
    let robot_crc32 = session.natural(node, "limits.robot_crc32")?;
    let unlock = Unlock { robot_crc32: robot_crc32 as u32, valid_s: 0 };
    session.order(node, "the key", UNLOCK, &unlock)?;
    Ok(())
}
