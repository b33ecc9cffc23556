//! How a thing that is no ball arrives, in words and numbers.

use std::fmt::Write as _;

use nalgebra::Vector3;
use planner::plan::file::{AttitudeInfo, DirectionInfo};

use super::page::Tone;

/// Angle of a direction to the wanted one, if one is.
fn angle_deg(wanted: Option<&DirectionInfo>, direction: [f64; 3]) -> Option<f64> {
    Some(wanted?.angle_rad(&Vector3::from(direction)).to_degrees())
}

/// Lines for the terminal.
pub(super) fn summary(thing: &AttitudeInfo) -> String {
    let a = &thing.arrival;
    let mut out = String::new();
    let asked = |wanted: Option<&DirectionInfo>, direction| {
        let angle = angle_deg(wanted, direction)?;
        Some(format!(", {angle:.1} of {:.1} deg off", wanted?.angle_max_rad.to_degrees()))
    };
    let sigma = |rad: Option<f64>| {
        rad.map_or_else(String::new, |rad| format!(", varies by {:.1} deg (1σ)", rad.to_degrees()))
    };
    let [x, y, z] = a.axis_w;
    let off = asked(thing.axis.as_ref(), a.axis_w).unwrap_or_default();
    let _ = writeln!(
        out,
        "  arrives with its axis along ({x:.3}, {y:.3}, {z:.3}){off}{}",
        sigma(a.axis_sigma_rad)
    );
    let momentum = Vector3::from(a.momentum_rad_s);
    if let Some(unit) = momentum.try_normalize(1e-9) {
        let off = asked(thing.spin.as_ref(), unit.into()).unwrap_or_default();
        let _ = writeln!(
            out,
            "  rotates about ({:.3}, {:.3}, {:.3}){off}{}; the axis turns about it at {:.2} rad/s",
            unit.x,
            unit.y,
            unit.z,
            sigma(a.spin_sigma_rad),
            momentum.norm()
        );
    }
    for turn in &a.delay_turns {
        if let Some(axis_rad) = turn.axis_rad {
            let spin = turn.spin_rad.map_or_else(String::new, |rad| {
                format!(", its axis of rotation by {:.1} deg", rad.to_degrees())
            });
            let _ = writeln!(
                out,
                "  a release {:.0} ms late or early turns the axis by {:.1} deg{spin}",
                turn.delay_s * 1e3,
                axis_rad.to_degrees()
            );
        }
    }
    out
}

/// Numbers for the report.
pub(super) fn tiles(thing: &AttitudeInfo) -> Vec<(String, &'static str, String, Tone)> {
    let a = &thing.arrival;
    let mut tiles = Vec::new();
    let mut tile = |deg: Option<f64>, text: String| {
        tiles.extend(deg.map(|deg| (format!("{deg:.1}"), "deg", text, Tone::Plain)));
    };
    tile(angle_deg(thing.axis.as_ref(), a.axis_w), "arrival axis off its direction".to_owned());
    tile(angle_deg(thing.spin.as_ref(), a.momentum_rad_s), "spin axis off its direction".to_owned());
    tile(a.axis_sigma_rad.map(f64::to_degrees), "spread of the arrival axis (1σ)".to_owned());
    for turn in &a.delay_turns {
        let late = format!("turn of the axis, {:.0} ms late or early", turn.delay_s * 1e3);
        tile(turn.axis_rad.map(f64::to_degrees), late);
    }
    tiles
}
