//! The pose that every tracker is turned into.

use protocol::{Duration, Instant};

/// Largest deviation of a received matrix from a rotation: from six decimals on the wire, with a margin for other senders.
const ROTATION_TOLERANCE: f64 = 1e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPose {
    /// When the cameras saw it, on the tracker's clock.
    pub stamp: Instant,
    /// Number of the body, from 0.
    pub body: u32,
    /// Origin of the body in the room, m.
    pub position_m: [f64; 3],
    /// Rotation body to room as a unit quaternion, w first, w not negative.
    pub rotation_wxyz: [f64; 4],
    /// Whether the body was seen. If not, position and rotation are the last that were seen.
    pub tracked: bool,
    /// Time since the cameras saw it, as far as the sender reports it.
    pub age: Duration,
}

/// Nine numbers are not a rotation matrix.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the matrix is not a rotation: deviation {deviation:.4}")]
pub struct NotARotation {
    /// Largest entry of `RᵀR - I`, or deviation of the determinant from 1.
    pub deviation: f64,
}

/// Unit quaternion (w first, w not negative) of a rotation matrix given column by column.
///
/// # Errors
/// The matrix deviates from a rotation by more than 0.001.
pub fn quaternion_of_columns(b: &[f64; 9]) -> Result<[f64; 4], NotARotation> {
    let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = *b;
    let columns = [[xx, yx, zx], [xy, yy, zy], [xz, yz, zz]];
    let dot = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(p, q)| p * q).sum::<f64>();
    let mut deviation = 0.0_f64;
    for (i, a) in columns.iter().enumerate() {
        for (j, b) in columns.iter().enumerate() {
            deviation = worst(deviation, dot(a, b) - f64::from(u8::from(i == j)));
        }
    }
    let determinant = xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx);
    deviation = worst(deviation, determinant - 1.0);
    // NaN is refused too.
    if deviation.is_nan() || deviation > ROTATION_TOLERANCE {
        return Err(NotARotation { deviation });
    }
    // Shepperd: divide by the largest of the four.
    let trace = xx + yy + zz;
    let q = if trace >= xx && trace >= yy && trace >= zz {
        [1.0 + trace, zy - yz, xz - zx, yx - xy]
    } else if xx >= yy && xx >= zz {
        [zy - yz, 1.0 + xx - yy - zz, yx + xy, xz + zx]
    } else if yy >= zz {
        [xz - zx, yx + xy, 1.0 + yy - xx - zz, zy + yz]
    } else {
        [yx - xy, xz + zx, zy + yz, 1.0 + zz - xx - yy]
    };
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    Ok(q.map(|x| sign * x / norm))
}

/// Rotation matrix, column by column, of a unit quaternion.
#[must_use]
pub fn columns_of_quaternion([w, x, y, z]: [f64; 4]) -> [f64; 9] {
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y + w * z),
        2.0 * (x * z - w * y),
        2.0 * (x * y - w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z + w * x),
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        1.0 - 2.0 * (x * x + y * y),
    ]
}

/// The larger magnitude; NaN if either is.
fn worst(so_far: f64, x: f64) -> f64 {
    if so_far.is_nan() || x.is_nan() { f64::NAN } else { so_far.max(x.abs()) }
}
