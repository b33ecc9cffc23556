//! Registers that only one family of drives has: the family brings the list, [`Settings`] holds the numbers.
//!
//! A controller has the registers of [`TABLE`](super::TABLE) and, behind them, those of its group
//! ([`DriveGroup::registers`](crate::group::DriveGroup::registers)). Storage, digest, unlock and host treat both alike.

use core::marker::PhantomData;

use protocol::{JOINTS_MAX, JointIndex};

use super::{Field, Kind, Number, RegisterInfo};
use crate::fault::Refusal;
use crate::joints::PerJoint;
use crate::settings::Settings;

/// Most registers of a family.
pub const FAMILY_MAX: usize = 8;

/// The numbers of a family's registers, as bits; those of the group in the first place.
type Bits = [PerJoint<u32>; FAMILY_MAX];

/// Registers of one family. Two lists are the same if they are the same static variable of `family_registers!`.
#[derive(Debug)]
pub struct FamilyRegisters {
    /// Rows, at most [`FAMILY_MAX`].
    pub table: &'static [RegisterInfo],
    /// What each of them is.
    pub meanings: &'static [&'static str],
    pub(crate) defaults: Bits,
    /// Conditions between these numbers and those of the joints. All of them are in their ranges by then.
    pub(crate) check: fn(&Settings) -> Result<(), Refusal>,
}

/// Of a family without registers.
pub(crate) static NONE: FamilyRegisters =
    FamilyRegisters { table: &[], meanings: &[], defaults: [NOTHING; FAMILY_MAX], check: |_| Ok(()) };

/// Numbers of the registers of one family.
#[derive(Clone, Copy, Debug)]
pub struct FamilySettings {
    list: &'static FamilyRegisters,
    bits: Bits,
}

impl PartialEq for FamilySettings {
    fn eq(&self, other: &Self) -> bool {
        self.is_of(other.list) && self.bits == other.bits
    }
}

impl FamilySettings {
    /// The defaults of a family.
    pub const fn of(list: &'static FamilyRegisters) -> Self {
        Self { list, bits: list.defaults }
    }

    /// The registers it has.
    pub const fn list(&self) -> &'static FamilyRegisters {
        self.list
    }

    /// True for the numbers of this family.
    pub fn is_of(&self, list: &'static FamilyRegisters) -> bool {
        core::ptr::eq(self.list, list)
    }

    /// The numbers of `joints` of another arm, in that order.
    #[must_use]
    pub fn of_joints(&self, joints: &(impl Iterator<Item = JointIndex> + Clone)) -> Self {
        let mut part = *self;
        let rows = part.bits.iter_mut().zip(&self.bits).zip(self.list.table);
        for ((to, from), _) in rows.filter(|(_, info)| info.per_joint) {
            for (place, joint) in JointIndex::first(JOINTS_MAX).zip(joints.clone()) {
                to.set(place, from.get(joint));
            }
        }
        part
    }

    pub(super) fn number(&self, row: usize, kind: Kind, joint: JointIndex) -> Number {
        Number::from_bits(kind, self.bits.get(row).map_or(0, |bits| bits.get(joint)))
    }

    pub(super) fn set_number(
        &mut self,
        row: usize,
        kind: Kind,
        joint: JointIndex,
        number: Number,
    ) -> Option<()> {
        let bits = self.bits.get_mut(row).filter(|_| number.kind() == kind)?;
        bits.set(joint, number.to_bits());
        Some(())
    }
}

/// One register of a family, to read and set it with its type.
#[derive(Clone, Copy, Debug)]
pub struct FamilySetting<T> {
    list: &'static FamilyRegisters,
    row: usize,
    kind: PhantomData<T>,
}

#[allow(private_bounds)]
impl<T: Field> FamilySetting<T> {
    pub(crate) const fn new(list: &'static FamilyRegisters, row: usize) -> Self {
        Self { list, row, kind: PhantomData }
    }

    /// The number of a register for the group. If `settings` belong to another family: the default.
    pub fn get(&self, settings: &Settings) -> T {
        let PerJoint([first, ..]) = self.row_of(settings);
        T::from_bits(*first)
    }

    /// The number of a joint. If `settings` belong to another family: the default.
    pub fn at(&self, settings: &Settings, joint: JointIndex) -> T {
        T::from_bits(self.row_of(settings).get(joint))
    }

    /// Sets the number of the group, without checks. Settings of another family become those of this one.
    pub fn set(&self, settings: &mut Settings, value: T) {
        settings.take_family(self.list);
        if let Some(PerJoint([first, ..])) = settings.family.bits.get_mut(self.row) {
            *first = value.number().to_bits();
        }
    }

    /// Sets the number of a joint, as [`Self::set`].
    pub fn set_at(&self, settings: &mut Settings, joint: JointIndex, value: T) {
        settings.take_family(self.list);
        if let Some(row) = settings.family.bits.get_mut(self.row) {
            row.set(joint, value.number().to_bits());
        }
    }

    fn row_of<'a>(&self, settings: &'a Settings) -> &'a PerJoint<u32> {
        let own = &settings.family;
        let all = if own.is_of(self.list) { &own.bits } else { &self.list.defaults };
        all.get(self.row).unwrap_or(&NOTHING)
    }
}

const NOTHING: PerJoint<u32> = PerJoint([0; JOINTS_MAX]);

/// One register for the group.
pub(crate) const GROUP: bool = false;
/// One number per joint.
pub(crate) const JOINT: bool = true;

/// Default of a u32 register, as bits, the same for all joints.
pub(crate) const fn natural(value: u32) -> PerJoint<u32> {
    PerJoint([value; JOINTS_MAX])
}

/// Default of a bool register, as [`natural`].
pub(crate) const fn bit(value: bool) -> PerJoint<u32> {
    natural(value as u32)
}

/// Default of an f32 register, as [`natural`].
pub(crate) const fn real(value: f32) -> PerJoint<u32> {
    natural(value.to_bits())
}

/// Defaults of an f32 register, one per joint, as bits.
pub(crate) const fn reals([a, b, c, d, e, f, g, h]: [f32; JOINTS_MAX]) -> PerJoint<u32> {
    PerJoint([
        a.to_bits(),
        b.to_bits(),
        c.to_bits(),
        d.to_bits(),
        e.to_bits(),
        f.to_bits(),
        g.to_bits(),
        h.to_bits(),
    ])
}

/// The list of a family, `REGISTERS`, and a [`FamilySetting`] for each row.
macro_rules! family_registers {
    (check $check:path; $($const:ident $name:literal: $type:ty = $default:expr, $per_joint:expr, $min:expr, $max:expr, $when:ident, $wider:ident, $text:literal;)*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Row { $($const,)* }

        /// Registers that only this family has.
        pub static REGISTERS: FamilyRegisters = FamilyRegisters {
            table: &[$(RegisterInfo::of_family::<$type>(
                $name, $per_joint, ($min, $max), (Writable::$when, Wider::$wider), Row::$const as usize,
            ),)*],
            meanings: &[$($text,)*],
            defaults: family::defaults([$($default,)*]),
            check: $check,
        };

        $(#[doc = $text]
        pub const $const: FamilySetting<$type> = FamilySetting::new(&REGISTERS, Row::$const as usize);)*
    };
}
pub(crate) use family_registers;

/// The rows of a list, filled up with zeros.
pub(crate) const fn defaults<const N: usize>(rows: [PerJoint<u32>; N]) -> Bits {
    const { assert!(N <= FAMILY_MAX, "FAMILY_MAX is too small") };
    let mut bits = [NOTHING; FAMILY_MAX];
    let (mut row, mut rest) = (bits.as_mut_slice(), rows.as_slice());
    while let ([place, places @ ..], [value, values @ ..]) = (row, rest) {
        *place = *value;
        (row, rest) = (places, values);
    }
    bits
}
