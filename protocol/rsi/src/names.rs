//! Names of attributes.

/// Attributes of Cartesian elements: mm and degrees, `R = Rz(A) Ry(B) Rx(C)`.
pub const CARTESIAN_NAMES: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];
/// Attributes of axis elements, degrees.
pub const AXIS_NAMES: [&str; 6] = ["A1", "A2", "A3", "A4", "A5", "A6"];
/// Attributes of external axes.
pub const EXTERNAL_NAMES: [&str; 6] = ["E1", "E2", "E3", "E4", "E5", "E6"];
