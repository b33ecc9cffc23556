//! Rigid-body dynamics: `τ = M(q) q̈ + C(q, q̇) q̇ + g(q)`.

mod forward;
mod gradient;
mod inverse;
mod spatial;

pub use gradient::InverseDynamicsGradient;
