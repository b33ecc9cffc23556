//! Tests of the whole cell: suites in `suites/`, this library of what they share, and clients that are not ours.
//!
//! # Map
//!
//! | place | is |
//! |---|---|
//! | [`published_throw`] | the throw of the paper in closed form, and as a controller's file |
//! | [`page`] | tables of `docs/trust.md`, compared with what the suites find |
//! | `suites/` | test programs: the controller in the simulated cell, whole throws, trust in outcomes |
//! | `interop/` | python-can, pycyphal, yakut and others against our buses and nodes |
//! | `layers/` | a package of its own: arrows between packages and modules |

pub mod page;
pub mod published_throw;
