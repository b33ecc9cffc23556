//! DC supply of several drives: voltage drop, cut-out on overload over time, restoration.
//!
//! ```text
//! U = U0 r - R I                 U0 nominal voltage V, r share left by a fault, R inner resistance Ω, I load A
//! dQ/dt = I - I_max, Q >= 0      excess charge, A·s; the supply cuts out at Q = Q_trip
//! ```
//!
//! So a constant load I > I_max is carried for Q_trip / (I - I_max) seconds. After a cut-out the supply is off for
//! `restore_s`, then tries again.

/// Figures of a supply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupplyOptions {
    /// Inner resistance and wiring, Ω.
    pub resistance_ohm: f64,
    /// Excess charge that trips it, A·s: 3 A·s carry twice 30 A for 0.1 s.
    pub trip_charge_as: f64,
    /// Time without output after a trip, s.
    pub restore_s: f64,
}

impl Default for SupplyOptions {
    fn default() -> Self {
        Self { resistance_ohm: 0.02, trip_charge_as: 3.0, restore_s: 1.0 }
    }
}

#[derive(Clone, Debug)]
pub struct Supply {
    nominal_v: f64,
    current_max_a: f64,
    options: SupplyOptions,
    /// Share of the voltage that a fault leaves, 0..=1.
    remaining: f64,
    excess_as: f64,
    off_for_s: Option<f64>,
    voltage_v: f64,
    load_a: f64,
    peak_a: f64,
    trips: u32,
}

impl Supply {
    /// A supply at no load.
    pub fn new(nominal_v: f64, current_max_a: f64, options: SupplyOptions) -> Self {
        Self {
            nominal_v,
            current_max_a,
            options,
            remaining: 1.0,
            excess_as: 0.0,
            off_for_s: None,
            voltage_v: nominal_v,
            load_a: 0.0,
            peak_a: 0.0,
            trips: 0,
        }
    }

    /// Carries `load_a` (A, not negative) for `dt_s`; gives the voltage afterwards, V.
    pub fn step(&mut self, dt_s: f64, load_a: f64) -> f64 {
        self.load_a = load_a;
        self.peak_a = self.peak_a.max(load_a);
        if let Some(off_for_s) = self.off_for_s {
            let off_for_s = off_for_s + dt_s;
            // A step that ends a rounding error early would cost a whole further step.
            let over = off_for_s >= self.options.restore_s - 1e-9;
            self.off_for_s = (!over).then_some(off_for_s);
            if over {
                self.excess_as = 0.0;
            }
        } else {
            self.excess_as = (self.excess_as + (load_a - self.current_max_a) * dt_s).max(0.0);
            if self.excess_as > self.options.trip_charge_as * (1.0 + 1e-9) {
                self.off_for_s = Some(0.0);
                self.trips += 1;
            }
        }
        self.voltage_v = match self.off_for_s {
            Some(_) => 0.0,
            None => (self.nominal_v * self.remaining - self.options.resistance_ohm * load_a).max(0.0),
        };
        self.voltage_v
    }

    /// Share of the nominal voltage that is left, clamped to 0..=1; NaN counts as 0.
    pub fn set_remaining(&mut self, share: f64) {
        self.remaining = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
    }

    /// Voltage after the last step, V.
    pub fn voltage_v(&self) -> f64 {
        self.voltage_v
    }

    /// Load in the last step and the largest so far, A.
    pub fn load_a(&self) -> (f64, f64) {
        (self.load_a, self.peak_a)
    }

    /// Times it has cut out.
    pub fn trips(&self) -> u32 {
        self.trips
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_to_trip(load_a: f64) -> Option<f64> {
        let mut supply = Supply::new(24.0, 30.0, SupplyOptions::default());
        (1..20_000).find(|_| supply.step(1e-3, load_a) == 0.0).map(|k| f64::from(k) * 1e-3)
    }

    #[test]
    fn overload_is_carried_for_the_trip_charge_and_no_longer() {
        for (load_a, expected_s) in [(60.0, 0.1), (40.0, 0.3), (33.0, 1.0), (31.0, 3.0)] {
            let tripped = time_to_trip(load_a).unwrap();
            assert!((tripped - expected_s).abs() <= 1.5e-3, "{load_a} A: {tripped} s");
        }
        assert_eq!(time_to_trip(30.0), None);
    }

    #[test]
    fn it_comes_back_after_its_rest_and_counts_the_trip() {
        let mut supply = Supply::new(24.0, 30.0, SupplyOptions::default());
        while supply.step(1e-3, 60.0) > 0.0 {}
        let off = (1..5_000).find(|_| supply.step(1e-3, 0.0) > 0.0).unwrap();
        assert!((999..=1001).contains(&off), "{off} ms");
        assert_eq!((supply.trips(), supply.voltage_v()), (1, 24.0));
    }

    #[test]
    fn voltage_drops_with_load_and_with_a_fault_and_never_below_zero() {
        let mut supply = Supply::new(24.0, 30.0, SupplyOptions::default());
        assert!((supply.step(1e-3, 30.0) - 23.4).abs() < 1e-12);
        supply.set_remaining(0.5);
        assert!((supply.step(1e-3, 0.0) - 12.0).abs() < 1e-12);
        for bad in [-1.0, f64::NAN] {
            supply.set_remaining(bad);
            assert_eq!(supply.step(1e-3, 10.0), 0.0);
        }
    }

    #[test]
    fn a_pause_below_the_limit_pays_the_excess_back() {
        let mut supply = Supply::new(24.0, 30.0, SupplyOptions::default());
        for _ in 0..50 {
            for _ in 0..90 {
                assert!(supply.step(1e-3, 60.0) > 0.0);
            }
            for _ in 0..90 {
                supply.step(1e-3, 0.0);
            }
        }
        assert_eq!(supply.trips(), 0);
    }
}
