//! The tests of this package as one program: it is linked once.

mod advice;
mod arrival_attitude;
mod ball_mass;
mod bus_common;
mod bus_live;
mod bus_verbs;
mod doctor;
mod home_verify;
mod identify_report;
mod lock_step;
mod output;
mod plan_follow;
mod plan_lists;
mod plan_shards;
mod program;
mod rally_verbs;
mod recordings;
mod registers;
mod robot_link;
mod robot_throw;
mod robot_verbs;
mod robots_and_gains;
mod swarm;
mod throw_failures;
mod throw_job;
mod throw_outcome;
