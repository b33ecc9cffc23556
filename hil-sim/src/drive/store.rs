//! The parameters of a module: working copy and permanent storage.
//!
//! One table of typed values, indexed by the parameter's number; measured or computed values are in `measure`. The
//! "Inc" twin of a parameter is the same value in ticks and is not stored separately.
//!
//! Choices where the sources have gaps: a write acts on the working copy and is lost at power-off unless SAVE
//! PARAMETERS was sent; writes of defaults (firmware 4601 on) act at the next power-on after SAVE.

use protocol::powercube::{BaudRate, Config, Parameter, Setup, Value};

use super::options::{BeyondMaximum, DriveOptions, Nameplate};

const LEN: usize = Parameter::MaxPwmOutput as usize + 1;

/// One copy of all stored parameters.
#[derive(Clone, Debug, PartialEq)]
struct Table([Option<Value>; LEN]);

/// What a write did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SetOutcome {
    /// Taken as sent.
    Taken,
    /// The nearest allowed value was taken.
    Clipped,
    /// Nothing changed.
    Refused,
}

/// Working copy, permanent copy and the count of writes to the latter.
#[derive(Clone, Debug)]
pub(super) struct Store {
    working: Table,
    permanent: Table,
    burn_count: u8,
    ticks_per_rad: f64,
}

impl Store {
    /// As it leaves the factory.
    pub(super) fn factory(plate: &Nameplate, options: &DriveOptions) -> Self {
        let table = factory_table(plate, options);
        Self { working: table.clone(), permanent: table, burn_count: 0, ticks_per_rad: plate.ticks_per_rad() }
    }

    /// Copies the working copy to permanent storage; the count stops at 255.
    pub(super) fn save(&mut self) {
        self.permanent = self.working.clone();
        self.burn_count = self.burn_count.saturating_add(1);
    }

    /// Power-on: what was not saved is lost; the home offset, limits and the like come from storage.
    pub(super) fn reload(&mut self) {
        self.working = self.permanent.clone();
    }

    pub(super) fn burn_count(&self) -> u8 {
        self.burn_count
    }

    /// The stored value, or the value in ticks of an "Inc" twin; `None` if the parameter is not stored.
    pub(super) fn get(&self, parameter: Parameter) -> Option<Value> {
        match ticks_twin(parameter) {
            Some(of) => Some(Value::I32((self.number(of) * self.ticks_per_rad).round() as i32)),
            None => self.working.0[usize::from(parameter.code())],
        }
    }

    /// A stored number as double.
    ///
    /// # Panics
    /// The parameter is not a stored number.
    pub(super) fn number(&self, parameter: Parameter) -> f64 {
        let value = self.working.0[usize::from(parameter.code())].and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("{parameter} is not a stored number"))
    }

    pub(super) fn config(&self) -> Config {
        match self.working.0[usize::from(Parameter::Config.code())] {
            Some(Value::U32(bits)) => Config::from_bits(bits),
            _ => Config::EMPTY,
        }
    }

    pub(super) fn setup(&self) -> Setup {
        match self.working.0[usize::from(Parameter::DefSetup.code())] {
            Some(Value::U32(bits)) => Setup::from_bits(bits),
            _ => Setup::EMPTY,
        }
    }

    /// Writes a stored parameter or its "Inc" twin; values that are not numbers are always refused.
    pub(super) fn set(&mut self, parameter: Parameter, value: Value, beyond: BeyondMaximum) -> SetOutcome {
        let Some(asked) = value.as_f64().filter(|v| v.is_finite()) else { return SetOutcome::Refused };
        let (parameter, asked) = match ticks_twin(parameter) {
            Some(of) => (of, asked / self.ticks_per_rad),
            None => (parameter, asked),
        };
        let Some(present) = self.working.0[usize::from(parameter.code())] else { return SetOutcome::Refused };
        let asked = if takes_magnitude(parameter) { asked.abs() } else { asked };
        let (low, high) = self.range(parameter);
        // Written this way so that reversed bounds cannot panic.
        let taken = asked.min(high).max(low);
        // Slack for numbers that went through single precision.
        let within = (taken - asked).abs() <= 1e-6 * asked.abs().max(1e-6);
        if !within && beyond == BeyondMaximum::Refuse {
            return SetOutcome::Refused;
        }
        self.working.0[usize::from(parameter.code())] = Some(of_kind(present, taken));
        if within { SetOutcome::Taken } else { SetOutcome::Clipped }
    }

    /// Allowed values. Lower and upper limits of one pair bound each other, so they never cross.
    fn range(&self, parameter: Parameter) -> (f64, f64) {
        use Parameter as P;
        let n = |p| self.number(p);
        match parameter {
            P::MinPos => (n(P::DefMinPos), n(P::MaxPos)),
            P::MaxPos => (n(P::MinPos), n(P::DefMaxPos)),
            P::MaxDeltaPos => (0.0, n(P::DefMaxDeltaPos)),
            P::MaxVel => (n(P::DefMinVel), n(P::DefMaxVel)),
            P::MaxAcc => (n(P::DefMinAcc), n(P::DefMaxAcc)),
            P::MaxCur => (n(P::DefMinCur), n(P::DefMaxCur)),
            P::TargetVel => (n(P::DefMinVel), n(P::MaxVel)),
            P::TargetAcc => (n(P::DefMinAcc), n(P::MaxAcc)),
            P::HomeVel => (-n(P::MaxVel), n(P::MaxVel)),
            P::HomeOffset => (-1e3, 1e3),
            P::ActC0 | P::ActA0 | P::DefC0 | P::DefA0 => (1.0, 100.0),
            P::ActDamp | P::DefDamp => (0.0, 25.0),
            P::DefGearRatio | P::DefLinRatio | P::DefCurRatio => (1e-6, 1e6),
            P::DefHomeAcc => (n(P::DefMinAcc), n(P::DefMaxAcc)),
            P::DefAddress => (1.0, 31.0),
            P::DefCanBaud => (0.0, 3.0),
            P::DefRsBaud => (0.0, 7.0),
            P::DefIncPerTurn => (1.0, 1e6),
            P::NominalMotorCurrent => (0.0, n(P::MaximumMotorCurrent)),
            P::MaximumMotorCurrent | P::CurrentLimit => (0.0, n(P::DefMaxCur)),
            P::MinLogicVoltage | P::MaxLogicVoltage | P::MinMotorVoltage | P::MaxMotorVoltage => (0.0, 60.0),
            P::LogicUndershootTime
            | P::LogicOvershootTime
            | P::MotorUndershootTime
            | P::MotorOvershootTime
            | P::NominalCurrentTime
            | P::MaximumCurrentTime => (0.0, 1e9),
            _ => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }
}

/// The parameter that an "Inc" parameter shows in ticks, if it is a stored one.
pub(super) const fn ticks_twin(parameter: Parameter) -> Option<Parameter> {
    use Parameter as P;
    match parameter {
        P::TargetVelInc => Some(P::TargetVel),
        P::TargetAccInc => Some(P::TargetAcc),
        P::HomeOffsetInc => Some(P::HomeOffset),
        P::MaxDeltaPosInc => Some(P::MaxDeltaPos),
        P::MinPosInc => Some(P::MinPos),
        P::MaxPosInc => Some(P::MaxPos),
        P::MaxVelInc => Some(P::MaxVel),
        P::MaxAccInc => Some(P::MaxAcc),
        P::HomeVelInc => Some(P::HomeVel),
        _ => None,
    }
}

/// Maxima of ramps have no sign; some hosts send one.
const fn takes_magnitude(parameter: Parameter) -> bool {
    use Parameter as P;
    matches!(parameter, P::TargetVel | P::TargetAcc | P::MaxVel | P::MaxAcc | P::MaxCur | P::MaxDeltaPos)
}

/// `number` in the type of `like`; casts saturate.
fn of_kind(like: Value, number: f64) -> Value {
    match like {
        Value::F32(_) | Value::PosStateDio(_) => Value::F32(number as f32),
        Value::I32(_) => Value::I32(number as i32),
        Value::U32(_) => Value::U32(number as u32),
        Value::I16(_) => Value::I16(number as i16),
        Value::U16(_) => Value::U16(number as u16),
        Value::U8(_) => Value::U8(number as u8),
    }
}

fn factory_table(plate: &Nameplate, options: &DriveOptions) -> Table {
    use Parameter as P;
    let mut table = Table([None; LEN]);
    let mut put = |parameter: P, value: Value| {
        assert_eq!(parameter.kind(), value.kind(), "{parameter}");
        table.0[usize::from(parameter.code())] = Some(value);
    };
    let f = |v: f64| Value::F32(v as f32);

    // Position loop in the module's own units; `servo` gives them their meaning.
    let (c0, damp, a0) = super::servo::default_gains(plate);
    // Slow and sure: a tenth of the largest velocity, homing downwards.
    let (home_vel, home_acc) = (-0.1 * plate.v_max_rad_s, 0.25 * plate.a_max_rad_s2);
    let config = options
        .config
        .with(Config::BRAKE_PRESENT, options.brake)
        .with(Config::SWR_WITH_ENCODERZERO, true)
        .with(Config::SWR_ENABLED, true)
        .with(Config::SW1_ENABLED, true)
        .with(Config::SW2_ENABLED, true);
    let feedback = if options.absolute_encoder { Setup::ABSOLUTE_FEEDBACK } else { Setup::ENCODER_FEEDBACK };
    let setup = feedback.union(Setup::IO_4IN_4OUT).union(Setup::CAN).union(Setup::USE_M4ID);

    for (default, actual, value) in [
        (P::DefHomeOffset, Some(P::HomeOffset), f(plate.home_edge_rad)),
        (P::DefMinPos, Some(P::MinPos), f(plate.q_min_rad)),
        (P::DefMaxPos, Some(P::MaxPos), f(plate.q_max_rad)),
        // At the highest speed of the throwing arm, 5.6 rad/s, the loop is 28 mrad behind.
        (P::DefMaxDeltaPos, Some(P::MaxDeltaPos), f(0.1)),
        (P::DefMaxVel, Some(P::MaxVel), f(plate.v_max_rad_s)),
        (P::DefMaxAcc, Some(P::MaxAcc), f(plate.a_max_rad_s2)),
        (P::DefMaxCur, Some(P::MaxCur), f(plate.current_max_a)),
        (P::DefHomeVel, Some(P::HomeVel), f(home_vel)),
        (P::DefHomeAcc, None, f(home_acc)),
        (P::DefConfig, Some(P::Config), Value::U32(config.bits())),
        (P::DefC0, Some(P::ActC0), Value::I16(c0)),
        (P::DefDamp, Some(P::ActDamp), Value::I16(damp)),
        (P::DefA0, Some(P::ActA0), Value::I16(a0)),
        (P::DefGearRatio, None, f(plate.gear_ratio)),
        (P::DefLinRatio, None, f(1.0)),
        (P::DefMaxDeltaVel, None, f(plate.v_max_rad_s)),
        (P::DefTorqueRatioOrCurOffset, None, f(plate.k_m_a_nm)),
        // Digits of the commanded current are 1/500 of the largest current.
        (P::DefCurRatio, None, f(plate.current_max_a / 500.0)),
        (P::DefMinVel, None, f(1e-4)),
        (P::DefMinAcc, None, f(1e-3)),
        (P::DefMinCur, None, f(0.0)),
        (P::DefDioData, None, Value::U32(0)),
        (P::DefSerialNo, None, Value::U32(plate.serial)),
        (P::DefIncPerTurn, None, Value::U32(plate.ticks_per_turn)),
        (P::DefVersion, None, Value::U16(plate.firmware)),
        (P::DefServiceInterval, None, Value::U16(0)),
        (P::DefBrakeTimeOut, None, Value::U16(100)),
        (P::DefAddress, None, Value::U8(plate.address.get())),
        (P::DefCanBaud, None, Value::U8(BaudRate::Kbit1000.code())),
        (P::DefRsBaud, None, Value::U8(3)),
        (P::DefSetup, None, Value::U32(setup.bits())),
        // Ramps start at half of the module's maxima until a host writes others.
        (P::TargetVel, None, f(0.5 * plate.v_max_rad_s)),
        (P::TargetAcc, None, f(0.5 * plate.a_max_rad_s2)),
        (P::SyncTime, None, Value::I16(0)),
        (P::LoadLimit, None, Value::I32(0)),
        (P::MaxLoadGradient, None, Value::I32(0)),
        (P::LoadDeltaTime, None, Value::U16(0)),
        // 18 V to 32 V for a module of 24 V; the cell gives logic and motor the same voltage.
        (P::MinLogicVoltage, None, f(0.75 * plate.supply_v)),
        (P::MaxLogicVoltage, None, f(4.0 / 3.0 * plate.supply_v)),
        (P::MinMotorVoltage, None, f(0.75 * plate.supply_v)),
        (P::MaxMotorVoltage, None, f(4.0 / 3.0 * plate.supply_v)),
        (P::NominalMotorCurrent, None, f(0.5 * plate.current_max_a)),
        (P::MaximumMotorCurrent, None, f(plate.current_max_a)),
        // Tolerated times; unit not stated, taken as ms.
        (P::LogicUndershootTime, None, Value::I32(20)),
        (P::LogicOvershootTime, None, Value::I32(20)),
        (P::MotorUndershootTime, None, Value::I32(20)),
        (P::MotorOvershootTime, None, Value::I32(20)),
        (P::NominalCurrentTime, None, Value::I32(20_000)),
        (P::MaximumCurrentTime, None, Value::I32(1_000)),
        (P::KpPwmLimit, None, Value::I32(100)),
        (P::CurrentLimit, None, f(plate.current_max_a)),
        (P::MaxPwmOutput, None, Value::I32(1_000)),
    ] {
        put(default, value);
        if let Some(actual) = actual {
            put(actual, value);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::ModuleId;

    fn store() -> Store {
        Store::factory(&Nameplate::bench(ModuleId::MIN, 0x4614), &DriveOptions::default())
    }

    #[test]
    fn what_is_not_saved_is_lost_at_power_on() {
        let mut store = store();
        assert_eq!(store.set(Parameter::MaxVel, Value::F32(1.0), BeyondMaximum::Clip), SetOutcome::Taken);
        store.reload();
        assert!(store.number(Parameter::MaxVel) > 2.0);
        store.set(Parameter::MaxVel, Value::F32(1.0), BeyondMaximum::Clip);
        store.save();
        store.set(Parameter::MaxVel, Value::F32(0.5), BeyondMaximum::Clip);
        store.reload();
        assert_eq!((store.number(Parameter::MaxVel), store.burn_count()), (1.0, 1));
    }

    #[test]
    fn beyond_the_maximum_is_clipped_or_refused_by_option_and_no_number_is_refused_always() {
        let mut store = store();
        let top = store.number(Parameter::DefMaxVel);
        assert_eq!(store.set(Parameter::MaxVel, Value::F32(9.0), BeyondMaximum::Refuse), SetOutcome::Refused);
        assert_eq!(store.set(Parameter::MaxVel, Value::F32(9.0), BeyondMaximum::Clip), SetOutcome::Clipped);
        assert_eq!(store.number(Parameter::MaxVel), top);
        for bad in [f32::NAN, f32::INFINITY] {
            assert_eq!(
                store.set(Parameter::MaxVel, Value::F32(bad), BeyondMaximum::Clip),
                SetOutcome::Refused
            );
        }
    }

    #[test]
    fn soft_limits_never_cross() {
        let mut store = store();
        store.set(Parameter::MaxPos, Value::F32(0.5), BeyondMaximum::Clip);
        store.set(Parameter::MinPos, Value::F32(0.8), BeyondMaximum::Clip);
        assert_eq!(store.number(Parameter::MinPos), 0.5);
        store.set(Parameter::MaxPos, Value::F32(-9.0), BeyondMaximum::Clip);
        assert_eq!(store.number(Parameter::MaxPos), 0.5);
    }

    #[test]
    fn twin_in_ticks_is_the_same_value() {
        let mut store = store();
        // 2000 ticks, gear 161: 51247.9 ticks per rad.
        store.set(Parameter::MaxPosInc, Value::I32(51_248), BeyondMaximum::Clip);
        assert!((store.number(Parameter::MaxPos) - 1.0).abs() < 1e-5);
        assert_eq!(store.get(Parameter::MaxPosInc), Some(Value::I32(51_248)));
    }
}
