//! The native half of the Python package `cubecell`.
//!
//! Arrays are passed as bytes of little-endian doubles, structures as JSON or TOML text. The Python half
//! (`python/cubecell/__init__.py`) makes numpy arrays and dictionaries of them and has the documentation for users. Plans and
//! gains come from the code of `cubectl plan throw` and `cubectl tune`, from requests of the same types.
//!
//! ```text
//! arrays  errors      doubles and bytes; refusals as Python exceptions
//!    \     /
//!     calls           long calls: without the lock of the interpreter, ended by Ctrl-C
//!       |
//! catch  flight  logs  plans  robot  sweep
//!                 |     |      |
//!                bus  simulate  ways
//!                 |
//!                arm
//!                 |
//!               servo
//! ```

mod arm;
mod arrays;
mod bus;
mod calls;
mod catch;
mod errors;
mod flight;
mod logs;
mod plans;
mod robot;
mod servo;
mod simulate;
mod sweep;
mod ways;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::arm::Arm;
    #[pymodule_export]
    use super::bus::{bus_modules, bus_record};
    #[pymodule_export]
    use super::catch::{catch_ball, catch_disc};
    #[pymodule_export]
    use super::errors::CubecellError;
    #[pymodule_export]
    use super::flight::{flight, landing};
    #[pymodule_export]
    use super::logs::read_log;
    #[pymodule_export]
    use super::plans::{check, plan, plan_follow, sample, tune};
    #[pymodule_export]
    use super::robot::Robot;
    #[pymodule_export]
    use super::servo::{Stream, servo};
    #[pymodule_export]
    use super::simulate::{simulate, simulate_follow};
    #[pymodule_export]
    use super::sweep::{sweep, sweep_summary};
    #[pymodule_export]
    use super::ways::{Surroundings, along};
}
