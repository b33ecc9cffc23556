//! Values of options that are several numbers.

use planner::plan::problem::short;

use crate::error::ExpectedError;

/// `N` numbers separated by commas.
pub(super) fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Vec<f64> = text
        .split(',')
        .map(|p| p.trim().parse::<f64>().map_err(|_| format!("\"{p}\" is not a number")))
        .collect::<Result<_, _>>()?;
    let count = parts.len();
    parts.try_into().map_err(|_| format!("expected {N} numbers separated by commas, got {count}"))
}

/// Two numbers given as `a,b`.
///
/// # Errors
/// If there are not two numbers.
pub fn two_numbers(text: &str) -> Result<[f64; 2], String> {
    numbers(text)
}

/// Six numbers separated by commas.
pub(in crate::cmd) fn six_numbers(text: &str) -> Result<[f64; 6], String> {
    numbers(text)
}

/// A point given as `x,y,z` in m.
///
/// # Errors
/// If there are not three numbers.
pub fn point(text: &str) -> Result<[f64; 3], String> {
    numbers(text)
}

/// No ball is thrown farther than this, m.
const TARGET_MAX_M: f64 = 100.0;

/// Refuses a target that lies so far away that its numbers must be millimetres.
pub(super) fn require_metres(target_m: [f64; 3]) -> Result<(), ExpectedError> {
    let far = target_m.iter().any(|x| x.is_finite() && x.abs() > TARGET_MAX_M);
    if !far {
        return Ok(());
    }
    let ([x, y, z], [a, b, c]) = (target_m.map(short), target_m.map(|mm| short(1e-3 * mm)));
    Err(ExpectedError::bad_input(&format!(
        "target {x},{y},{z} m lies more than {TARGET_MAX_M} m away: metres?"
    ))
    .next(format!("targets are in m; if these are millimetres, --target {a},{b},{c}")))
}
