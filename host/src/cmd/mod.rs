//! One verb of `cubectl` per file: arguments and `run`.

pub mod config;
pub mod doctor;
pub mod explain;
pub mod home;
pub mod jog;
pub mod monitor;
pub mod record;
pub mod replay;
pub mod run;
pub mod scan;
pub mod sim;
pub mod status;
pub mod stop;
pub mod tune;
pub mod upload;

mod bus_errors;
