//! With a key: which orders need an authentication code, and for which order a code counts.

use firmware::authority::{Code, Key, Nonce, Source, code_of};
use sha2::{Digest as _, Sha256};

use super::*;

pub(super) const KEY: [u8; 32] = *b"a key of thirty two bytes:secret";

/// A node with the key, controlled by a test.
pub(super) struct Keyed {
    pub(super) bench: Bench,
    pub(super) name: FileName,
    pub(super) file: Vec<u8>,
}

/// The bytes that the link would pass on for an order.
fn content(order: Order) -> Vec<u8> {
    format!("{order:?}").into_bytes()
}

impl Keyed {
    pub(super) fn new() -> Self {
        let (mut bench, name) = committed();
        let now = bench.instant();
        bench.controller.set_key(now, FIRST.into(), Some(Key::new(KEY))).unwrap();
        Self { bench, name, file: throw_file(3_000, false) }
    }

    pub(super) fn challenge(&mut self, peer: Peer) -> Nonce {
        match self.bench.order_of(peer, Order::Challenge) {
            Ok(Done::Challenge(nonce)) => nonce,
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn give(&mut self, peer: Peer, order: Order) -> Result<Done, Refusal> {
        let (now, content) = (self.bench.instant(), content(order));
        self.bench.controller.order(now, Source { peer, content: &content }, order)
    }

    pub(super) fn authorize(&mut self, peer: Peer, nonce: Nonce, code: Code) -> Result<Done, Refusal> {
        self.bench.order_of(peer, Order::Authorize { nonce, code })
    }

    /// The bytes that a code covers: the order, and the digest of what it refers to.
    pub(super) fn covered(&self, order: Order) -> Vec<u8> {
        let controller = &self.bench.controller;
        let sha256: [u8; 32] = Sha256::digest(&self.file).into();
        let about: Vec<u8> = match order {
            Order::Commit(_) => sha256.to_vec(),
            Order::ArmConfirm { .. } => registers::run_digest(&sha256, controller.settings()).to_vec(),
            _ => Vec::new(),
        };
        [content(order), about].concat()
    }

    /// Challenge, code and order.
    pub(super) fn order(&mut self, peer: Peer, order: Order) -> Result<Done, Refusal> {
        let nonce = self.challenge(peer);
        let code = code_of(&Key::new(KEY), &nonce, peer, &self.covered(order));
        self.authorize(peer, nonce, code)?;
        self.give(peer, order)
    }

    pub(super) fn confirmation(&mut self) -> Order {
        let token = offer(&mut self.bench, FIRST, self.name);
        self.bench.run_for(60_000);
        Order::ArmConfirm { token, valid: VALID }
    }
}

#[test]
fn with_a_key_orders_that_can_move_the_arm_need_a_code() {
    let mut keyed = Keyed::new();
    let name = keyed.name;
    let confirm = keyed.confirmation();
    let robot_crc32 = keyed.bench.controller.settings().limits_robot_crc32;
    let jog = Order::Jog { joint: joint(1), qd_rad_s: 0.1, hold: Duration::from_millis(200) };
    for order in [
        confirm,
        Order::Commit(name),
        Order::Home { mask: 1 },
        jog,
        Order::Gripper { open: true },
        Order::SaveSettings,
        Order::Unlock { robot_crc32, valid: VALID },
    ] {
        assert_eq!(cause(keyed.give(FIRST, order)), Cause::CodeMissing, "{order:?}");
    }
    let slower = [Number::Real32(1.0); 6];
    assert_eq!(cause(write(&mut keyed.bench, FIRST, "joint.v_max_rad_s", &slower)), Cause::CodeMissing);
    assert_eq!(keyed.bench.kind(), StateKind::Ready);
    keyed.order(FIRST, confirm).unwrap();
    assert_eq!(cause(keyed.give(FIRST, Order::Run(name))), Cause::CodeMissing, "a code is for one order");
    keyed.order(FIRST, Order::Run(name)).unwrap();
    assert_eq!(keyed.bench.kind(), StateKind::Running);
    // Any node may stop, without a code.
    keyed.give(SECOND, Order::Stop).unwrap();
    assert_eq!(keyed.bench.kind(), StateKind::Stopping);
}

#[test]
fn a_forged_code_is_refused_and_uses_the_challenge_up() {
    let mut keyed = Keyed::new();
    let confirm = keyed.confirmation();
    let nonce = keyed.challenge(FIRST);
    let good = code_of(&Key::new(KEY), &nonce, FIRST, &keyed.covered(confirm));
    let forged = [
        [0; 16],
        code_of(&Key::new([0; 32]), &nonce, FIRST, &keyed.covered(confirm)),
        code_of(&Key::new(KEY), &[0; 8], FIRST, &keyed.covered(confirm)),
        code_of(&Key::new(KEY), &nonce, SECOND, &keyed.covered(confirm)),
        code_of(&Key::new(KEY), &nonce, FIRST, &content(Order::Run(keyed.name))),
    ];
    for code in forged {
        assert_ne!(code, good);
        let nonce = keyed.challenge(FIRST);
        keyed.authorize(FIRST, nonce, code).unwrap();
        assert_eq!(cause(keyed.give(FIRST, confirm)), Cause::CodeWrong);
        assert_eq!(cause(keyed.give(FIRST, confirm)), Cause::CodeMissing, "used up");
    }
    // One bit.
    for bit in 0..128 {
        let nonce = keyed.challenge(FIRST);
        let mut code = code_of(&Key::new(KEY), &nonce, FIRST, &keyed.covered(confirm));
        code[bit / 8] ^= 1 << (bit % 8);
        keyed.authorize(FIRST, nonce, code).unwrap();
        assert_eq!(cause(keyed.give(FIRST, confirm)), Cause::CodeWrong, "bit {bit}");
    }
    assert_eq!(keyed.bench.kind(), StateKind::Ready);
}

#[test]
fn a_code_does_not_work_for_another_node_another_order_or_a_second_time() {
    let mut keyed = Keyed::new();
    let name = keyed.name;
    let confirm = keyed.confirmation();
    // The second node has overheard the code, but cannot use it under its own number.
    let nonce = keyed.challenge(FIRST);
    let code = code_of(&Key::new(KEY), &nonce, FIRST, &keyed.covered(confirm));
    assert_eq!(cause(keyed.authorize(SECOND, nonce, code)), Cause::CodeWrong, "a challenge of another node");
    let own = keyed.challenge(SECOND);
    keyed.authorize(SECOND, own, code).unwrap();
    assert_eq!(cause(keyed.give(SECOND, confirm)), Cause::OtherHost);
    // An order other than the one that the code was made for.
    keyed.authorize(FIRST, nonce, code).unwrap();
    let longer = Order::ArmConfirm { token: 1, valid: VALID };
    assert_eq!(cause(keyed.give(FIRST, longer)), Cause::CodeWrong);
    // In time; then replayed, as a whole and step by step.
    keyed.order(FIRST, confirm).unwrap();
    keyed.bench.order_of(FIRST, Order::Disarm).unwrap();
    assert_eq!(keyed.give(FIRST, confirm), Ok(Done::Taken), "the answer again");
    assert_eq!(keyed.bench.kind(), StateKind::Ready, "but nothing is done again");
    assert_eq!(cause(keyed.authorize(FIRST, nonce, code)), Cause::CodeWrong);
    keyed.bench.run_for(5_100_000);
    assert_eq!(cause(keyed.give(FIRST, confirm)), Cause::CodeMissing);
    let _ = name;
}

#[test]
fn codes_that_come_in_another_order_than_their_challenges_are_refused() {
    let mut keyed = Keyed::new();
    let confirm = keyed.confirmation();
    let older = keyed.challenge(FIRST);
    let newer = keyed.challenge(FIRST);
    assert_ne!(older, newer);
    let code = code_of(&Key::new(KEY), &older, FIRST, &keyed.covered(confirm));
    assert_eq!(cause(keyed.authorize(FIRST, older, code)), Cause::CodeWrong, "a newer one is out");
    let code = code_of(&Key::new(KEY), &newer, FIRST, &keyed.covered(confirm));
    keyed.authorize(FIRST, newer, code).unwrap();
    keyed.authorize(FIRST, newer, code).unwrap();
    assert_eq!(cause(keyed.authorize(FIRST, newer, [1; 16])), Cause::CodeWrong, "a second code");
    keyed.give(FIRST, confirm).unwrap();
}

#[test]
fn a_challenge_expires() {
    let mut keyed = Keyed::new();
    let home = Order::Home { mask: 1 };
    let nonce = keyed.challenge(FIRST);
    let code = code_of(&Key::new(KEY), &nonce, FIRST, &keyed.covered(home));
    keyed.bench.run_for(5_100_000);
    assert_eq!(cause(keyed.authorize(FIRST, nonce, code)), Cause::CodeWrong);
    let nonce = keyed.challenge(FIRST);
    let code = code_of(&Key::new(KEY), &nonce, FIRST, &keyed.covered(home));
    keyed.authorize(FIRST, nonce, code).unwrap();
    keyed.bench.run_for(5_100_000);
    assert_eq!(cause(keyed.give(FIRST, home)), Cause::CodeMissing);
}

#[test]
fn the_key_changes_and_goes_only_with_a_code_of_the_old_one_and_survives_a_restart() {
    let mut keyed = Keyed::new();
    let set = |keyed: &mut Keyed, key: Option<[u8; 32]>, by: [u8; 32]| {
        let nonce = keyed.challenge(FIRST);
        let content = key.map_or(b"no key".to_vec(), |key| key.to_vec());
        let code = code_of(&Key::new(by), &nonce, FIRST, &content);
        keyed.authorize(FIRST, nonce, code).unwrap();
        let now = keyed.bench.instant();
        keyed.bench.controller.set_key(now, Source { peer: FIRST, content: &content }, key.map(Key::new))
    };
    let now = keyed.bench.instant();
    for key in [None, Some(Key::new([1; 32]))] {
        assert_eq!(cause(keyed.bench.controller.set_key(now, FIRST.into(), key)), Cause::CodeMissing);
    }
    assert_eq!(cause(set(&mut keyed, None, [1; 32])), Cause::CodeWrong);
    set(&mut keyed, Some([2; 32]), KEY).unwrap();
    assert_eq!(cause(keyed.order(FIRST, Order::SaveSettings)), Cause::CodeWrong, "the old key");
    let storage = keyed.bench.controller.storage().clone();
    let again = Controller::<_, _, PowerCubes>::new(storage, &Settings::powercube6(), Seed::FORESEEABLE);
    assert!(again.is_keyed());
    set(&mut keyed, None, [2; 32]).unwrap();
    assert!(!keyed.bench.controller.is_keyed());
    assert_eq!(cause(keyed.bench.order_of(FIRST, Order::Challenge)), Cause::NoKey);
    let storage = keyed.bench.controller.storage().clone();
    assert!(
        !Controller::<_, _, PowerCubes>::new(storage, &Settings::powercube6(), Seed::FORESEEABLE).is_keyed()
    );
}

/// Its first order had a code; other motions need their own.
#[test]
fn jog_goes_on_without_a_code_and_opens_no_way_for_other_orders() {
    let mut keyed = Keyed::new();
    let jog = Order::Jog { joint: joint(1), qd_rad_s: 0.1, hold: Duration::from_millis(200) };
    keyed.order(FIRST, jog).unwrap();
    keyed.bench.run_for(100_000);
    assert_eq!(keyed.give(FIRST, jog), Ok(Done::Taken));
    assert_eq!(cause(keyed.give(FIRST, Order::Gripper { open: true })), Cause::CodeMissing);
    assert_eq!(keyed.bench.kind(), StateKind::Jogging);
    keyed.bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(keyed.give(FIRST, jog), Ok(Done::Taken), "the answer to the first one again");
    assert_eq!(keyed.bench.kind(), StateKind::Ready, "nothing is done twice");
    let back = Order::Jog { joint: joint(1), qd_rad_s: -0.1, hold: Duration::from_millis(200) };
    assert_eq!(cause(keyed.give(FIRST, back)), Cause::CodeMissing, "a new jog");
}
