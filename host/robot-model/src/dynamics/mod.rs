//! Rigid-body dynamics: `τ = M(q) q̈ + C(q, q̇) q̇ + g(q)`.

mod inverse;
