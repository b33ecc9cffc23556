//! The tests of this package as one program: it is linked once.

mod arming;
mod authority;
mod bench;
mod causes;
mod fault_table;
mod faults;
mod host_authority;
mod host_history;
mod host_link;
mod hostile;
mod lost_answers;
mod new_end_states;
mod ports;
mod residual;
mod rest;
mod retarget;
mod rsi_group;
mod runner;
mod samples;
mod second_group;
mod slow_moves;
mod standing;
mod start_time;
mod stops;
mod tracking;
mod watchdog;
