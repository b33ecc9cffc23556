//! The tests of this package as one program: it is linked once.

mod best_form;
mod best_known;
mod catch_rates;
mod catch_rig;
mod catch_search;
mod default_throw;
mod disc_flight;
mod disc_limits;
mod disc_oracle;
mod disc_paper;
mod drag_spread;
mod finger_release;
mod follow_arms;
mod follow_best;
mod follow_paper;
mod follow_verify;
mod general_arms;
mod ladder;
mod paper_form;
mod plan_file;
mod plan_limits;
mod plan_spread;
mod prepare;
mod stored_throws;
mod targets;
mod timing;
