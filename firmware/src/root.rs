//! Square root in single precision without the standard library.

/// Square root of `x` >= 0 within two units in the last place, 0 for what is smaller than a normal number.
///
/// Newton's method from half the exponent. Flash is scarce: an integer square root costs half a kilobyte, for the
/// only root of this crate, and the processor's own instruction needs unsafe code.
pub(crate) fn square_root(x: f32) -> f32 {
    if x < f32::MIN_POSITIVE {
        return 0.0;
    }
    if x.is_infinite() {
        return x;
    }
    // Within 6 %; so within 2e-3, 2e-6 and the resolution after the three steps.
    let mut root = f32::from_bits((x.to_bits() >> 1) + (127 << 22));
    for _ in 0..3 {
        root = 0.5 * (root + x / root);
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_root_is_within_two_units_in_the_last_place_of_the_exact_one() {
        assert_eq!([0.0, 1e-39, 1.0, 4.0].map(square_root), [0.0, 0.0, 1.0, 2.0]);
        assert_eq!(square_root(f32::INFINITY), f32::INFINITY);
        // Every exponent, and mantissas over the whole range.
        for bits in (f32::MIN_POSITIVE.to_bits()..f32::MAX.to_bits()).step_by(9_973) {
            let x = f32::from_bits(bits);
            let off = square_root(x).to_bits().abs_diff((f64::from(x).sqrt() as f32).to_bits());
            assert!(off <= 2, "{x:e}: off by {off}");
        }
    }
}
