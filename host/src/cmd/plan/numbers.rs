//! Values of options that are several numbers.

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
