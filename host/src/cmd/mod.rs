//! One verb of `cubectl` per file: arguments and `run`.

pub mod config;
pub mod doctor;
pub mod explain;
pub mod home;
pub mod jog;
pub mod monitor;
pub mod record;
pub mod replay;
pub mod scan;
pub mod status;
pub mod stop;
pub mod tune;

mod bus_errors;
