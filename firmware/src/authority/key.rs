//! Keyed orders: a controller with a key takes orders that can move the arm only with a code of that key.
//!
//! ```text
//! node                          controller
//!  │ challenge ────────────────▶ │
//!  │ ◀──────────────── nonce ─── │   8 bytes, once, for this node, for 5 s
//!  │ authorize(nonce, code) ───▶ │   code = HMAC-SHA-256(key, context ‖ nonce ‖ node ‖ content), first 16 bytes
//!  │ the order itself ─────────▶ │   its bytes are the content; carried out if the code covers them
//! ```
//!
//! A commit and the confirmation of an arming name things that others can change. The code therefore also covers a
//! digest: for a commit of the file, for an arming of the file and the settings
//! ([`run_digest`](crate::registers::run_digest)).
//!
//! A code covers one order of one node. If the answer to the order is lost, the node sends the same order again: it
//! gets the same answer, and nothing is done twice.

use hmac::{Hmac, KeyInit, Mac};
use protocol::cyphal::cubecell::authorization::CONTEXT;
use protocol::{Duration, Instant};
use sha2::Sha256;

use crate::credentials::{CODE_LEN, Code, Digest, Key, Nonce, Peer};
use crate::fault::{Cause, Refusal};
use crate::orders::Done;

/// How long a challenge holds.
pub const CHALLENGE_VALID: Duration = Duration::from_secs(5);
/// Nodes that may hold a challenge at the same time; one more takes the place of the oldest.
const NODES_MAX: usize = 4;

fn mac(key: &Key, nonce: &Nonce, peer: Peer, content: &[u8]) -> Option<Hmac<Sha256>> {
    let mut mac = <Hmac<Sha256> as KeyInit>::new_from_slice(key.bytes()).ok()?;
    mac.update(CONTEXT);
    mac.update(nonce);
    mac.update(&[peer.number()]);
    mac.update(content);
    Some(mac)
}

/// SHA-256 of a file.
pub fn sha256(data: &[u8]) -> Digest {
    <Sha256 as sha2::Digest>::digest(data).into()
}

/// The code of an order.
pub fn code_of(key: &Key, nonce: &Nonce, peer: Peer, content: &[u8]) -> Code {
    let mut code = [0; CODE_LEN];
    if let Some(mac) = mac(key, nonce, peer, content) {
        for (to, from) in code.iter_mut().zip(mac.finalize().into_bytes()) {
            *to = from;
        }
    }
    code
}

/// A challenge that was sent and is still valid.
#[derive(Clone, Copy)]
struct Challenge {
    peer: Peer,
    nonce: Nonce,
    until: Instant,
    /// Received from the node; not compared with anything yet.
    code: Option<Code>,
    /// Outcome of the order, once the order has been carried out.
    outcome: Option<Result<Done, Refusal>>,
}

/// Result of the comparison of a code with an order.
pub(crate) enum Verdict {
    /// Carry it out.
    Carry,
    /// The order was carried out before: send this answer again.
    Repeat(Result<Done, Refusal>),
}

/// The key, and the challenges that are still valid.
#[derive(Default)]
pub(crate) struct Keyring {
    key: Option<Key>,
    challenges: [Option<Challenge>; NODES_MAX],
}

impl Keyring {
    /// True if a key is set.
    pub(crate) const fn is_keyed(&self) -> bool {
        self.key.is_some()
    }

    /// Sets or removes the key; challenges of the old one are void.
    pub(crate) fn set(&mut self, key: Option<Key>) {
        *self = Self { key, challenges: Default::default() };
    }

    fn slot(&mut self, now: Instant, peer: Peer) -> Option<&mut Challenge> {
        self.challenges.iter_mut().flatten().find(|challenge| challenge.peer == peer && challenge.until > now)
    }

    /// A new challenge for `peer`; its old one is void.
    pub(crate) fn challenge(&mut self, now: Instant, peer: Peer, nonce: Nonce) {
        let new = Challenge { peer, nonce, until: now + CHALLENGE_VALID, code: None, outcome: None };
        let place = self.challenges.iter_mut().min_by_key(|place| match place {
            Some(old) if old.peer == peer => (0, Instant::ZERO),
            None => (1, Instant::ZERO),
            Some(old) => (2, old.until),
        });
        if let Some(place) = place {
            *place = Some(new);
        }
    }

    /// Keeps the code for the next order of `peer`.
    pub(crate) fn authorize(
        &mut self,
        now: Instant,
        peer: Peer,
        nonce: Nonce,
        code: Code,
    ) -> Result<(), Refusal> {
        let challenge = self.slot(now, peer).filter(|challenge| challenge.nonce == nonce);
        let Some(challenge) = challenge else { return Err(Refusal::of(Cause::CodeWrong)) };
        match challenge.code {
            // The same code again: the answer to the first one was lost.
            Some(old) if old == code => Ok(()),
            // A challenge takes one code.
            Some(_) => Err(Refusal::of(Cause::CodeWrong)),
            None => {
                challenge.code = Some(code);
                Ok(())
            }
        }
    }

    /// Compares the code of `peer` with `content` (the bytes of the order) and with the digest of what the order
    /// refers to. A code that does not fit cannot be used again.
    pub(crate) fn judge(
        &mut self,
        now: Instant,
        peer: Peer,
        content: &[u8],
        about: Option<Digest>,
    ) -> Result<Verdict, Refusal> {
        let Some(key) = self.key.clone() else { return Ok(Verdict::Carry) };
        let given = self.slot(now, peer).and_then(|challenge| {
            let code = challenge.code?;
            Some((challenge, code))
        });
        let Some((challenge, code)) = given else { return Err(Refusal::of(Cause::CodeMissing)) };
        // Compared in constant time.
        let about = about.as_ref().map_or(&[][..], |digest| digest);
        let fits = mac(&key, &challenge.nonce, peer, content)
            .is_some_and(|mac| mac.chain_update(about).verify_truncated_left(&code).is_ok());
        match (fits, challenge.outcome) {
            (true, None) => Ok(Verdict::Carry),
            (true, Some(outcome)) => Ok(Verdict::Repeat(outcome)),
            // The code was for an order that has been carried out: this order has no code.
            (false, Some(_)) => Err(Refusal::of(Cause::CodeMissing)),
            (false, None) => {
                challenge.until = now;
                Err(Refusal::of(Cause::CodeWrong))
            }
        }
    }

    /// The order of `peer` was carried out: its code cannot be used again.
    pub(crate) fn close(&mut self, now: Instant, peer: Peer, outcome: Result<Done, Refusal>) {
        if let Some(challenge) = self.slot(now, peer) {
            challenge.outcome = Some(outcome);
        }
    }
}
