//! The tests of this package as one program: it is linked once.

mod arming;
mod authority;
mod bench;
mod causes;

mod deadlines;
mod families_hostile;
mod fault_clearing;
mod fault_table;
mod faults;
mod gripper_lost;
mod held;
mod host_authority;
mod host_history;
mod host_link;
mod hostile;
mod lost_answers;
mod new_end_states;
mod ports;
mod reach;
mod residual;
mod rest;
mod retarget;
mod rsi_group;
mod rsi_link_faults;
mod rsi_orders;
mod runner;
mod samples;
mod segments;
mod slow_moves;
mod standing;
mod start_time;
mod stops;
mod tracking;
mod watchdog;
