//! The reference of the position loop as closed forms of time (pure).

use protocol::{Duration, Instant};

/// Where the reference goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Path {
    /// It stands, rad.
    Hold(f64),
    /// From set point to set point; then it stands.
    Line { from_rad: f64, to_rad: f64, since: Instant, period: Duration },
    /// To rest.
    Brake { from_rad: f64, v_rad_s: f64, a_rad_s2: f64, since: Instant },
    /// With a constant speed.
    Search { from_rad: f64, v_rad_s: f64, since: Instant },
}

impl Path {
    /// Position and velocity, rad and rad/s.
    pub(super) fn at(&self, now: Instant) -> (f64, f64) {
        let seconds = |since: Instant| now.saturating_since(since).as_secs_f64();
        match *self {
            Self::Hold(q_rad) => (q_rad, 0.0),
            Self::Line { from_rad, to_rad, since, period } => {
                let share = seconds(since) / period.as_secs_f64();
                if share > 1.0 {
                    return (to_rad, 0.0);
                }
                let way_rad = to_rad - from_rad;
                (from_rad + share * way_rad, way_rad / period.as_secs_f64())
            }
            Self::Brake { from_rad, v_rad_s, a_rad_s2, since } => {
                let t_s = seconds(since).min(v_rad_s.abs() / a_rad_s2);
                let a_rad_s2 = a_rad_s2.copysign(v_rad_s);
                (from_rad + v_rad_s * t_s - 0.5 * a_rad_s2 * t_s * t_s, v_rad_s - a_rad_s2 * t_s)
            }
            Self::Search { from_rad, v_rad_s, since } => (from_rad + v_rad_s * seconds(since), v_rad_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_ends_at_its_target_and_a_braking_reference_stands_where_its_speed_is_used_up() {
        let at = Instant::from_micros;
        let line =
            Path::Line { from_rad: 1.0, to_rad: 1.2, since: at(1_000), period: Duration::from_micros(2_000) };
        let near = |(q, v): (f64, f64), (p, w): (f64, f64)| (q - p).abs() < 1e-9 && (v - w).abs() < 1e-9;
        assert!(near(line.at(at(2_000)), (1.1, 100.0)));
        assert!(near(line.at(at(9_000)), (1.2, 0.0)));
        let brake = Path::Brake { from_rad: 1.1, v_rad_s: 100.0, a_rad_s2: 1_000.0, since: at(2_000) };
        assert!(near(brake.at(at(52_000)), (1.1 + 5.0 - 1.25, 50.0)));
        assert!(near(brake.at(at(500_000)), (6.1, 0.0)));
    }
}
